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

# Bounds of one sign that span more than this are searched in the logarithm.
_WIDE = 10.0


class Free(NamedTuple):
    """A free parameter: one value for all `paths` in the law, between bounds in SI units."""

    name: str
    paths: tuple[str, ...]
    lower: float
    upper: float
    log: bool
    unit: str


class Spread(NamedTuple):
    """A parameter of the drive (by path) that is uncertain between two values in SI units."""

    name: str
    path: str
    lower: float
    upper: float


class Spec(NamedTuple):
    """What is tuned, for which drives, from where, and how long.

    count: drives, the study's own among them. starts: of the search, the study's own law among
    them. screen: drives on which all starts are tried before the best `finalists` see all.
    iterations: at most so many on all drives, half as many before. tolerance: a step shorter than
    this, on the unit cube of the bounds, ends a start. seed: of drives and starts. working: the
    drives that the last stage begins with; those that break a limit join them. check: drives
    drawn afresh on which the tuned law is tried at the end.
    """

    free: tuple[Free, ...]
    spreads: tuple[Spread, ...]
    count: int
    starts: int
    screen: int
    finalists: int
    iterations: int
    tolerance: float
    seed: int
    objective: Objective
    working: int
    check: int


class _Tune(BaseModel):
    model_config = ConfigDict(extra="forbid")
    free: dict[str, Any]
    drives: dict[str, Any] = {}
    starts: int = Field(ge=1, default=8)
    finalists: int = Field(ge=1, default=2)
    iterations: int = Field(ge=1, default=40)
    tolerance: float = Field(gt=0.0, lt=1.0, default=3e-6)
    seed: int = Field(ge=0, default=0)


class _Free(BaseModel):
    model_config = ConfigDict(extra="forbid")
    lower: float | str
    upper: float | str
    scale: Literal["linear", "log"] | None = None
    of: list[str] | None = None


class _Drives(BaseModel):
    model_config = ConfigDict(extra="forbid")
    count: int = Field(ge=1, default=1)
    screen: int = Field(ge=1, default=8)
    working: int | None = Field(ge=1, default=None)
    check: int = Field(ge=0, default=0)
    spread: dict[str, Any] = {}


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
    drives = check(_Drives, main.drives, "tune.drives")
    if not main.free:
        raise InputError("tune.free", "must name a parameter", "none", "e.g. K_B = { ... }")
    spreads = tuple(_spread(study, name, v) for name, v in drives.spread.items())
    if (drives.count > 1) != bool(spreads):
        got = f"count = {drives.count}, spread = {drives.spread}"
        raise InputError("tune.drives", "needs both count > 1 and spread", got, "give both")
    _check_drives(drives, study.objective)
    return Spec(
        free=tuple(_free(study.law, name, v) for name, v in main.free.items()),
        spreads=spreads,
        count=drives.count,
        starts=main.starts,
        screen=min(drives.screen, drives.count),
        finalists=main.finalists,
        iterations=main.iterations,
        tolerance=main.tolerance,
        seed=main.seed,
        objective=study.objective,
        working=min(drives.working or drives.count, drives.count),
        check=drives.check,
    )


def _check_drives(drives: _Drives, objective: Objective) -> None:
    """A working set knows the worst drives, not how many are bad; fresh drives need a spread."""
    if drives.check and not drives.spread:
        raise InputError("tune.drives.check", "needs a spread", "none", "give spread")
    sampled = [x.metric for x in objective.limits if x.over != "worst"]
    if drives.working and sampled:
        fix = 'leave working out, or take over = "worst"'
        raise InputError("tune.drives.working", "needs limits on the worst case", sampled, fix)


def _free(law: Any, name: str, given: Any) -> Free:
    where = f"tune.free.{name}"
    item = check(_Free, given, where)
    paths = tuple(_path(law, path, where) for path in item.of or [name])
    unit = tree.unit(law, paths[0])
    lower, upper = (
        float(to_si(getattr(item, k), unit, f"{where}.{k}")) for k in ("lower", "upper")
    )
    if not lower < upper:
        raise InputError(where, "must have lower < upper", [lower, upper], "swap or widen them")
    for path in paths:
        rule = _rule(law, path, where)
        for key, bound in (("lower", lower), ("upper", upper)):
            if not rule.holds(np.asarray(bound)):
                raise InputError(f"{where}.{key}", rule.text, bound, rule.fix)
    if item.scale == "log" and lower * upper <= 0.0:
        raise InputError(
            where, "must have bounds of one sign for scale = 'log'", [lower, upper], "use 'linear'"
        )
    return Free(name, paths, lower, upper, _is_log(item.scale, lower, upper), unit)


def _is_log(scale: str | None, lower: float, upper: float) -> bool:
    wide = lower * upper > 0.0 and max(lower / upper, upper / lower) >= _WIDE
    return scale == "log" or (scale is None and wide)


def _path(owner: Any, name: str, where: str) -> str:
    try:
        return tree.resolve(owner, name)
    except InputError as error:
        raise InputError(where, error.rule, error.value, error.fix) from None


def _rule(owner: Any, path: str, where: str) -> Rule:
    item = next(i for i in all_parameters(owner) if i.path.lstrip(".") == path)
    if np.ndim(item.value) != 0:
        raise InputError(
            where, "must be a single number", f"{np.shape(item.value)}", "name another"
        )
    return item.rule


def _spread(study: Study, name: str, given: Any) -> Spread:
    """A half-width relative to the study's drive, such as "20 %", or a list [lower, upper]."""
    where = f"tune.drives.spread.{name}"
    path = _path(study.drive, name, where)
    unit, value = tree.unit(study.drive, path), float(tree.get(study.drive, path))
    if isinstance(given, list) and len(given) == 2:
        lower, upper = (float(v) for v in to_si(given, unit, where))
    elif isinstance(given, str) and given.rstrip().endswith("%"):
        share = _percent(given, where)
        lower, upper = sorted((value * (1.0 - share), value * (1.0 + share)))
    else:
        rule = 'must be relative like "20 %" or a list [lower, upper]'
        raise InputError(where, rule, repr(given), 'e.g. "20 %"')
    if not lower < upper:
        raise InputError(where, "must span a range", [lower, upper], "give lower < upper")
    return Spread(name, path, lower, upper)


def _percent(text: str, where: str) -> float:
    try:
        share = float(text.rstrip().removesuffix("%")) / 100.0
    except ValueError:
        raise InputError(where, "must be a number and %", repr(text), 'e.g. "20 %"') from None
    if not 0.0 < share < float("inf"):
        raise InputError(where, "must be > 0 %", text, 'e.g. "20 %"')
    return share


def describe(spec: Spec) -> Mapping[str, Any]:
    """The specification as plain tables: what a result file says of it."""
    return {
        "free": {f.name: {"lower": f.lower, "upper": f.upper, "log": f.log} for f in spec.free},
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
        "objective": [list(map(list, part)) for part in spec.objective],
    }
