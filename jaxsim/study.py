"""A study: drive, law, scenario, run options and objective, described by one TOML file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.catalog import DRIVES
from jaxsim.components import build, override, read_json, read_toml
from jaxsim.drive import Drive
from jaxsim.errors import InputError, called, inside
from jaxsim.hybrid import Deadzone, Exact, Plain, Smoothed
from jaxsim.law import Control, as_joint_law
from jaxsim.laws.policy import Policy
from jaxsim.loop import ClosedLoop
from jaxsim.objective import Objective, read_objective
from jaxsim.quantity import to_si
from jaxsim.run import Run
from jaxsim.scenario import Scenario, Start
from jaxsim.signal import Signal
from jaxsim.validation import check

SHIPPED = "jaxsim.studies"
# `tune` and what other packages add are read by their owners; `law` may also be given elsewhere.
_OWN = ("name", "about", "drive", "law", "scenario", "scenarios", "run", "objective")
_GUESTS = ("identify", "tune")


class RunOptions(NamedTuple):
    """How a study is simulated: integration step in s, deadzone mode, and 32 or 64 bits."""

    dt: float
    deadzone: Deadzone
    precision: int

    @property
    def dtype(self) -> str:
        return f"float{self.precision}"


class Study(NamedTuple):
    """One study. `table` is the file as it was read, `folder` where its relative paths start.

    scenario: the one that is simulated and certified. scenarios: all that it is tuned for, by
    name; `scenario` is the first of them, or the one chosen by `in_scenario`.
    """

    name: str
    drive: Drive
    law: Any
    scenario: Scenario
    run: RunOptions
    objective: Objective | None
    table: dict[str, Any]
    folder: Path
    scenarios: dict[str, Scenario]

    def section(self, name: str) -> dict[str, Any]:
        """A section that another package reads, e.g. `tune`; empty if the file has none."""
        return self.table.get(name, {})

    def in_scenario(self, name: str | None) -> Study:
        """The study with another of its scenarios to simulate; None leaves it as it is.

        Raises: InputError for an unknown name, with the nearest.
        """
        if name is None:
            return self
        if name not in self.scenarios:
            raise InputError.unknown("scenario", name, self.scenarios)
        return self._replace(scenario=self.scenarios[name])

    def measure(
        self,
        metrics: tuple[str, ...] | None,
        *,
        drive: Any = None,
        law: Any = None,
        scenario: Any = None,
        **options: Any,
    ) -> Run:
        """Metrics of the study's run, or of a batch, with its step, deadzone mode and precision.

        drive, law, scenario: in place of its own. options: of `simulate`, in place of its own. No
        trajectory is kept, and runs that do not complete say so in their status.
        """
        usual = {"dt": self.run.dt, "deadzone": self.run.deadzone, "dtype": self.run.dtype}
        return simulate(
            self.drive if drive is None else drive,
            self.law if law is None else law,
            self.scenario if scenario is None else scenario,
            metrics=metrics,
            store=None,
            throw=False,
            **(usual | options),
        )


class _Run(BaseModel):
    model_config = ConfigDict(extra="forbid")
    dt: float | str = 2e-4
    deadzone: Literal["exact", "plain", "smoothed"] = "exact"
    max_events: int | None = Field(ge=0, default=None)
    width: float | str = 1e-3
    speed_width: float | str = 0.5
    precision: Literal[32, 64] = 64


def shipped() -> list[str]:
    """Names of the studies that come with the project."""
    files = resources.files(SHIPPED).iterdir()
    return sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml"))


def locate(name: str, folder: Path | None = None, field: str = "study") -> Path:
    """The file of a study: a path (relative to `folder`), or the name of a shipped one.

    field: what the person calls it. Raises: InputError where there is neither, with the nearest
    shipped names.
    """
    path = (folder or Path()) / name
    if path.is_file():
        return path
    if name in shipped():
        return Path(str(resources.files(SHIPPED) / f"{name}.toml"))
    if name.endswith(".toml"):
        raise InputError(field, "must be a file or a shipped study", name, "check the path")
    raise InputError.unknown(field, name, shipped())


def load(name: str, *, law: str | None = None) -> Study:
    """The study in a file, or a shipped one by name; `law` takes its law from another file.

    Raises: InputError naming file, key, rule, value and fix.
    """
    path = locate(name)
    table = read_toml(path)
    if law is not None:
        table["law"] = {"file": str(locate(law, field="law").absolute())}
    with inside(path.name):
        return from_table(table, path.parent, path.stem)


def from_table(table: dict[str, Any], folder: Path, name: str) -> Study:
    """The study that nested tables describe; relative paths in it start at `folder`."""
    for key in table:
        if key not in (*_OWN, *_GUESTS):
            raise InputError.unknown(key, key, (*_OWN, *_GUESTS))
    drive = _drive(_need(table, "drive"), folder)
    law = _law(_need(table, "law"), folder, drive)
    scenarios = _scenarios(table, drive)
    run = _run(table.get("run", {}))
    for scenario in scenarios.values():
        scenario.ticks(run.dt)
        ClosedLoop(drive, law, scenario, run.deadzone, run.dt)  # do the parts fit together?
    first = next(iter(scenarios.values()))
    wanted = table.get("objective")
    objective = None if wanted is None else read_objective(wanted)
    _remark(drive, law)
    title = table.get("name", name)
    return Study(title, drive, law, first, run, objective, table, folder, scenarios)


def _remark(drive: Drive, law: Any) -> None:
    """Warn of gains that are allowed but hardly meant, and of a policy of another drive."""
    for words in law.remarks(drive) if isinstance(law, Policy) else ():
        warnings.warn(words, stacklevel=3)
    if drive.command_unit != "V":
        return
    from jaxsim.linear.routh import remarks  # SciPy: 0.2 s that other drives need not pay

    for words in remarks(drive, law):
        warnings.warn(words, stacklevel=3)


def _need(table: Mapping[str, Any], key: str) -> Any:
    if key not in table:
        raise InputError(key, "must be given", "no such section", f"add [{key}]")
    return table[key]


def _drive(given: Any, folder: Path) -> Drive:
    """`preset = NAME`, `file = PATH` or motor, transmission and load, with values to override."""
    if not isinstance(given, Mapping):
        raise InputError("drive", "must be a table", repr(given), 'e.g. preset = "bench_2018"')
    rest = dict(given)
    if "preset" in rest:
        name = _text(rest.pop("preset"), "drive.preset")
        if ":" not in name and name not in DRIVES.names():
            raise InputError.unknown("drive.preset", name, DRIVES.names())
        drive = DRIVES.find(name)()
        return override(drive, rest, "drive")
    if "file" in rest:
        other = _other(rest.pop("file"), "drive", folder)
        return override(_drive(*other), rest, "drive")
    return build(Drive, rest, "drive")


def _law(given: Any, folder: Path, drive: Drive) -> Any:
    """`file = STUDY` (a path or a shipped name) with values to override, or a law in full."""
    if isinstance(given, Mapping) and "file" in given:
        rest = dict(given)
        table, place = _other(rest.pop("file"), "law", folder)
        return override(_law(table, place, drive), rest, "law")
    if isinstance(given, Mapping) and "weights" in given:
        given = _with_weights(dict(given), folder)
    return as_joint_law(build(Control, given, "law", drive), drive.axes)


def _with_weights(law: dict[str, Any], folder: Path) -> dict[str, Any]:
    """`weights = FILE`: thousands of numbers have a JSON file of their own beside the study."""
    stored = read_json(folder / _text(law.pop("weights"), "law.weights"))
    return {**stored, **law}


def _other(name: Any, section: str, folder: Path) -> tuple[Any, Path]:
    """A section of another file, and that file's folder."""
    path = locate(_text(name, f"{section}.file"), folder, f"{section}.file")
    with inside(path.name):
        return _need(read_toml(path), section), path.parent


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise InputError(where, "must be text", repr(value), "put the name in quotes")
    return value


def _scenarios(table: Mapping[str, Any], drive: Drive) -> dict[str, Scenario]:
    """[scenario] alone, or each [scenarios.NAME] with what it leaves out taken from [scenario]."""
    common = table.get("scenario", {})
    if "scenarios" not in table:
        return {"scenario": _scenario(common, drive, "scenario")}
    given = table["scenarios"]
    if not isinstance(given, Mapping) or not given:
        raise InputError("scenarios", "must be tables", repr(given), "write [scenarios.NAME]")
    found = {}
    for name, own in given.items():
        where = f"scenarios.{name}"
        for part, what in (("scenario", common), (where, own)):
            if not isinstance(what, Mapping):
                raise InputError(part, "must be a table", repr(what), f"write [{part}]")
        found[name] = _scenario({**common, **own}, drive, where)
    return found


def _scenario(given: Any, drive: Drive, where: str) -> Scenario:
    known = ("reference", "load_torque", "start", "duration")
    if not isinstance(given, Mapping):
        raise InputError(where, "must be a table", repr(given), f"write [{where}]")
    for key in given:
        if key not in known:
            raise InputError.unknown(f"{where}.{key}", key, known)
    parts: dict[str, Any] = {}
    for key, base in (("reference", Signal), ("load_torque", Signal), ("start", Start)):
        if key in given:
            parts[key] = _per_axis(base, given[key], f"{where}.{key}", drive.axes)
        elif drive.axes > 1:
            parts[key] = _per_axis(base, [_nothing(base)] * drive.axes, key, drive.axes)
    if "duration" in given:
        parts["duration"] = float(to_si(given["duration"], "s", f"{where}.duration"))
    return Scenario(**parts)


def _nothing(base: type) -> dict[str, Any]:
    return {"type": "constant"} if base is Signal else {}


def _per_axis(base: type, given: Any, where: str, axes: int) -> Any:
    """For several axes a list with one entry per axis; an entry may itself be a sum."""
    if axes == 1:
        return build(base, given, where)
    if not isinstance(given, list) or len(given) != axes:
        raise InputError(where, f"must be a list of {axes}, one per axis", given, "add entries")
    return tuple(build(base, item, f"{where}[{i}]") for i, item in enumerate(given))


def _run(given: Any) -> RunOptions:
    options = check(_Run, given, "run")
    dt = float(to_si(options.dt, "s", "run.dt"))
    return RunOptions(dt, _deadzone(options), options.precision)


def _deadzone(options: _Run) -> Deadzone:
    if options.deadzone == "exact":
        return Exact(options.max_events)
    if options.deadzone == "plain":
        return Plain()
    width = to_si(options.width, "rad", "run.width")
    return Smoothed(width, to_si(options.speed_width, "rad/s", "run.speed_width"))


def owner_of(study: Study, name: str) -> tuple[str, str]:
    """("law" or "drive", path): where a parameter is; `law.` or `drive.` may stand before it.

    Raises: InputError for a name that neither has, with the nearest, or that both have.
    """
    head, _, tail = name.partition(".")
    if head in ("law", "drive") and tail:
        return head, tree.resolve(getattr(study, head), tail)
    found = []
    for owner in ("law", "drive"):
        hits = [p for p in tree.paths(getattr(study, owner)) if f".{p}".endswith(f".{name}")]
        found += [(owner, path) for path in hits]
    if len(found) == 1:
        return found[0]
    if found:
        paths = [".".join(hit) for hit in found]
        raise InputError(name, "must name one parameter", f"matches {paths}", "give the full path")
    raise InputError.unknown("parameter", name, names(study))


def names(study: Study) -> list[str]:
    """The shortest name of every single number of law and drive, as `with_values` takes it."""
    parts = {owner: getattr(study, owner) for owner in ("law", "drive")}
    every = [f"{owner}.{path}" for owner, part in parts.items() for path in tree.paths(part)]
    single = {f"{owner}.{path}" for owner, part in parts.items() for path in tree.numbers(part)}
    return [name for path, name in zip(every, tree.shortest(every), strict=True) if path in single]


def with_values(study: Study, values: Mapping[str, Any]) -> Study:
    """The study with parameters of its law and drive replaced; units in text are converted.

    Raises: InputError for unknown or ambiguous names and for values that break a rule.
    """
    for name, value in values.items():
        with called(name):
            owner, path = owner_of(study, name)
            part = override(getattr(study, owner), {path: value}, owner)
        study = study._replace(**{owner: part})
    _remark(study.drive, study.law)
    return study
