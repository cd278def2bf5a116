"""The [tune] section of a study: free parameters with bounds, and the drives to tune for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from jaxsim import tree
from jaxsim.errors import InputError
from jaxsim.objective import Objective
from jaxsim.parameters import Rule, all_parameters
from jaxsim.quantity import to_si
from jaxsim.study import Study
from jaxsim.validation import check
from tuning.drive_set import SETS, Drives, Spread, path_in
from tuning.solver import SOLVERS
from tuning.tie import Tie, read_tie

# Bounds of one sign that span more than this are searched in the logarithm.
_WIDE = 10.0


class Free(NamedTuple):
    """A free parameter between bounds in SI units, and what it sets in the law.

    ties: the parameters that have its value, then those that follow it by a factor and an offset.
    """

    name: str
    ties: tuple[Tie, ...]
    lower: float
    upper: float
    log: bool
    unit: str


class Spec(NamedTuple):
    """What is tuned, for which drives, from where, and how long.

    drives: their values (count, spreads), the study's own first. starts: of the search, the
    study's own law among them. screen: drives on which all starts are tried before the best
    `finalists` see all. iterations: at most so many on all drives, and again whenever others join
    the working set; half as many before. tolerance: a step shorter than this, on the unit cube of
    the bounds, ends a start. seed: of drives and starts. working: the drives that the last stage
    begins with; those that break a limit join them. check: drives drawn afresh on which the tuned
    law is tried at the end. solvers: each goes on from the ends of the one before, the last one
    sees all drives. smoothing: half-widths, rad, of smoothed models that are searched before.
    """

    free: tuple[Free, ...]
    spreads: tuple[Spread, ...]
    drives: np.ndarray
    starts: int
    screen: int
    finalists: int
    iterations: int
    tolerance: float
    seed: int
    objective: Objective
    working: int
    check: int
    solvers: tuple[str, ...]
    smoothing: tuple[float, ...]

    @property
    def count(self) -> int:
        return len(self.drives)


class _Tune(BaseModel):
    model_config = ConfigDict(extra="forbid")
    free: dict[str, Any]
    drives: dict[str, Any] = {}
    starts: int = Field(ge=1, default=8)
    finalists: int = Field(ge=1, default=2)
    iterations: int = Field(ge=1, default=40)
    tolerance: float = Field(gt=0.0, lt=1.0, default=3e-6)
    seed: int = Field(ge=0, default=0)
    solver: str | list[str] = Field(min_length=1, default=["cma", "sqp"])
    smoothing: list[float | str] = []


class _Free(BaseModel):
    model_config = ConfigDict(extra="forbid")
    lower: float | str
    upper: float | str
    scale: Literal["linear", "log"] | None = None
    of: list[str] | None = None


class _Drives(BaseModel):
    model_config = ConfigDict(extra="forbid")
    count: int | None = Field(ge=1, default=None)
    screen: int = Field(ge=1, default=8)
    working: int | None = Field(ge=1, default=None)
    check: int = Field(ge=0, default=0)


def read_spec(study: Study, *, starts: int | None = None, seed: int | None = None) -> Spec:
    """The [tune] section of a study; `starts` and `seed` override it.

    Raises: InputError where the study has no objective, for unknown names, for bounds in the
    wrong order or against a parameter's rule, and for a count without a spread.
    """
    if study.objective is None:
        raise InputError("objective", "must be given to tune", "no such section", "add [objective]")
    if not study.section("tune"):
        raise InputError("tune", "must be given", "no such section", "add [tune.free]")
    given = dict(study.section("tune"))
    given |= {k: v for k, v in (("starts", starts), ("seed", seed)) if v is not None}
    main = check(_Tune, given, "tune")
    if not main.free:
        raise InputError("tune.free", "must name a parameter", "none", "e.g. K_B = { ... }")
    options, drives = _drives(study, main)
    _check_drives(options, drives, study.objective)
    count = len(drives.values)
    return Spec(
        free=_all_free(study.law, main.free),
        spreads=drives.spreads,
        drives=drives.values,
        starts=main.starts,
        screen=min(options.screen, count),
        finalists=main.finalists,
        iterations=main.iterations,
        tolerance=main.tolerance,
        seed=main.seed,
        objective=study.objective,
        working=min(options.working or count, count),
        check=options.check,
        solvers=_solvers(main.solver),
        smoothing=tuple(_width(w) for w in main.smoothing),
    )


def _solvers(given: str | list[str]) -> tuple[str, ...]:
    """Names of solvers, one after the other; an unknown one is told."""
    names = (given,) if isinstance(given, str) else tuple(given)
    for name in names:
        SOLVERS.find(name)
    return names


def _width(given: float | str) -> float:
    width = float(to_si(given, "rad", "tune.smoothing"))
    if not width > 0.0:
        raise InputError("tune.smoothing", "must be > 0", given, 'half-widths, e.g. "1 mrad"')
    return width


def _drives(study: Study, main: _Tune) -> tuple[_Drives, Drives]:
    """The options of [tune.drives], and the drives of the one set that it names."""
    where, sets = "tune.drives", SETS.all()
    named = {key: v for key, v in main.drives.items() if key in sets}
    rest = {key: v for key, v in main.drives.items() if key not in sets}
    for key in rest:
        if key not in _Drives.model_fields:
            raise InputError.unknown(f"{where}.{key}", key, {*_Drives.model_fields, *sets})
    options = check(_Drives, rest, where)
    if len(named) > 1:
        raise InputError(where, "must name one set of drives", list(named), "leave the others out")
    if not named:
        if (options.count or 1) > 1:
            got = f"count = {options.count}, spread = {{}}"
            raise InputError(where, "needs both count > 1 and spread", got, "give both")
        return options, Drives((), np.zeros((1, 0)))
    ((key, given),) = named.items()
    if options.count is not None and not sets[key].counted:
        fix = "leave count out"
        raise InputError(f"{where}.count", f"must follow from {key}", options.count, fix)
    set_ = sets[key]()
    return options, set_.read(study, given, options.count or 1, main.seed, f"{where}.{key}")


def _check_drives(options: _Drives, drives: Drives, objective: Objective) -> None:
    """A working set knows the worst drives, not how many are bad; fresh drives need a spread."""
    if options.check and all(s.lower == s.upper for s in drives.spreads):
        raise InputError("tune.drives.check", "needs a spread", "none", "give spread")
    sampled = [x.metric for x in objective.limits if x.over != "worst"]
    if options.working and sampled:
        fix = 'leave working out, or take over = "worst"'
        raise InputError("tune.drives.working", "needs limits on the worst case", sampled, fix)


def _all_free(law: Any, given: Mapping[str, Any]) -> tuple[Free, ...]:
    """The free parameters, each with what follows it; entries that are text follow another."""
    where = "tune.free"
    free = {n: _free(law, n, v) for n, v in given.items() if not isinstance(v, str)}
    for key, text in given.items():
        if not isinstance(text, str):
            continue
        name, factor, offset = read_tie(text, f"{where}.{key}")
        if name not in free:
            raise InputError.unknown(f"{where}.{key}", name, free)
        tie = Tie(path_in(law, key, f"{where}.{key}"), factor, offset)
        _check_ends(law, tie, free[name], f"{where}.{key}")
        free[name] = free[name]._replace(ties=(*free[name].ties, tie))
    paths = [t.path for f in free.values() for t in f.ties]
    for path in paths:
        if paths.count(path) > 1:
            raise InputError(where, "must set each parameter once", path, "leave one out")
    return tuple(free.values())


def _free(law: Any, name: str, given: Any) -> Free:
    where = f"tune.free.{name}"
    item = check(_Free, given, where)
    ties = tuple(Tie(path_in(law, path, where)) for path in item.of or [name])
    unit = tree.unit(law, ties[0].path)
    lower, upper = (
        float(to_si(getattr(item, k), unit, f"{where}.{k}")) for k in ("lower", "upper")
    )
    if not lower < upper:
        raise InputError(where, "must have lower < upper", [lower, upper], "swap or widen them")
    if item.scale == "log" and lower * upper <= 0.0:
        raise InputError(
            where, "must have bounds of one sign for scale = 'log'", [lower, upper], "use 'linear'"
        )
    found = Free(name, ties, lower, upper, _is_log(item.scale, lower, upper), unit)
    for tie in ties:
        _check_ends(law, tie, found, where)
    return found


def _check_ends(law: Any, tie: Tie, free: Free, where: str) -> None:
    """Neither bound may break the rule of a parameter that it sets."""
    rule = _rule(law, tie.path, where)
    own = tie.factor == 1.0 and tie.offset == 0.0
    for key in ("lower", "upper"):
        value = tie.value(getattr(free, key))
        if broken := rule.broken(value):
            field = f"{where}.{key}" if own else f"{where} at {free.name}.{key}"
            raise InputError(field, broken.text, value, broken.fix)


def _is_log(scale: str | None, lower: float, upper: float) -> bool:
    wide = lower * upper > 0.0 and max(lower / upper, upper / lower) >= _WIDE
    return scale == "log" or (scale is None and wide)


def _rule(owner: Any, path: str, where: str) -> Rule:
    item = next(i for i in all_parameters(owner) if i.path.lstrip(".") == path)
    if np.ndim(item.value) != 0:
        raise InputError(
            where, "must be a single number", f"{np.shape(item.value)}", "name another"
        )
    return item.rule


def describe(spec: Spec) -> Mapping[str, Any]:
    """The specification as plain tables: what a result file says of it."""
    return {
        "free": {f.name: _described(f) for f in spec.free},
        "spread": {s.name: [s.lower, s.upper] for s in spec.spreads},
        "count": spec.count,
        "starts": spec.starts,
        "screen": spec.screen,
        "finalists": spec.finalists,
        "iterations": spec.iterations,
        "tolerance": spec.tolerance,
        "seed": spec.seed,
        "working": spec.working,
        "check": spec.check,
        "solver": list(spec.solvers),
        "smoothing": list(spec.smoothing),
        "objective": [list(map(list, part)) for part in spec.objective],
    }


def _described(f: Free) -> dict[str, Any]:
    sets = {t.path: [t.factor, t.offset] for t in f.ties}
    return {"lower": f.lower, "upper": f.upper, "log": f.log, "sets": sets}
