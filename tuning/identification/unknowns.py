"""Unknowns: free parameters with bounds, shared by all experiments or one value for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxsim import tree
from jaxsim.errors import InputError, called
from jaxsim.loop import UNITS
from jaxsim.parameters import all_parameters
from tuning.identification.experiment import Experiment, Model, model_of, wound

# Bounds of one sign that span more than this are searched in the logarithm.
_WIDE = 10.0
# A start on a bound has no slope along it: the search begins this far inside, on the unit circle.
_INSIDE = 1.45


class Free(NamedTuple):
    """A free parameter: one value for all `paths` of a `Model`, between bounds in SI units.

    own: whether each experiment has a value of its own (a start, an offset).
    """

    name: str
    paths: tuple[str, ...]
    lower: float
    upper: float
    log: bool
    unit: str
    own: bool = False


def free(
    experiment: Experiment, name: str, lower: float, upper: float, *,
    log: bool | None = None, own: bool = False, of: Sequence[str] = (),
) -> Free:  # fmt: skip
    """A `Free` of an experiment's tree, by name.

    name: a parameter of drive, law or scenario by path or unambiguous tail ("half_gap",
    "start.theta_L"), or SIGNAL.offset, SIGNAL.scale, SIGNAL.delay of a sensor. of: several names
    that share the value. log: None searches wide bounds of one sign in the logarithm.

    Raises: InputError for unknown names, and bounds in the wrong order or against a rule.
    """
    model = model_of(experiment)
    where = f"free.{name}"
    paths = tuple(path_of(experiment, n, where) for n in of or [name])
    if not lower < upper:
        raise InputError(where, "must have lower < upper", [lower, upper], "swap or widen them")
    for path in paths:
        item = next(i for i in all_parameters(model) if i.path.lstrip(".") == path)
        if np.ndim(item.value) != 0:
            got = f"{np.shape(item.value)} numbers"
            raise InputError(where, "must be a single number", got, "name another")
        for key, bound in (("lower", lower), ("upper", upper)):
            if broken := item.rule.broken(bound):
                raise InputError(f"{where}.{key}", broken.text, bound, broken.fix)
    if log and lower * upper <= 0.0:
        fix = "search linearly"
        raise InputError(where, "must have bounds of one sign to use logs", [lower, upper], fix)
    wide = lower * upper > 0.0 and max(lower / upper, upper / lower) >= _WIDE
    unit = unit_of(experiment, paths[0])
    in_log = bool(wide) if log is None else log
    return Free(name, paths, float(lower), float(upper), in_log, unit, own)


def path_of(experiment: Experiment, name: str, where: str) -> str:
    """The path in the tree of an experiment of a parameter, or of SIGNAL.offset and the like.

    Raises: InputError for a name that is unknown, with the nearest, or ambiguous.
    """
    head, _, tail = name.rpartition(".")
    signals = experiment.signals
    if head in signals:
        index = f"[{signals.index(head)}]" if len(signals) > 1 else ""
        name = f"sensors{index}.{tail}"
    with called(where):
        return tree.resolve(model_of(experiment), name)


def unit_of(experiment: Experiment, path: str) -> str:
    """The unit of a parameter; an offset has that of its signal."""
    if path.startswith("sensors") and path.endswith(".offset"):
        index = path.partition("[")[2].partition("]")[0]
        signal = experiment.signals[int(index or 0)]
        return UNITS[signal.partition("[")[0]]
    return tree.unit(model_of(experiment), path)


class Unknowns(NamedTuple):
    """The columns of a fit: the shared parameters, then each own parameter per experiment.

    A point of the search is y (..., P), free of bounds: a value is the middle of its bounds plus
    half their distance times sin(y) (in the logarithm where `log`), so bounds hold by themselves
    and can still be reached.
    """

    free: tuple[Free, ...]
    experiments: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(
            f"{f.name}[{name}]" if f.own else f.name
            for f in self.free
            for name in (self.experiments if f.own else ("",))
        )

    @property
    def of(self) -> np.ndarray:
        """(P,) which of `free` a column belongs to."""
        count = len(self.experiments)
        return np.concatenate(
            [np.full(count if f.own else 1, i) for i, f in enumerate(self.free)]
        ).astype(int)

    def columns(self) -> np.ndarray:
        """(E, len(free)) the column of each free parameter, per experiment."""
        first = np.cumsum([0] + [len(self.experiments) if f.own else 1 for f in self.free])
        own = np.array([f.own for f in self.free], int)
        return first[:-1][None] + own[None] * np.arange(len(self.experiments))[:, None]

    def initial(self, experiments: Sequence[Experiment]) -> np.ndarray:
        """(P,) the values that the experiments' trees hold; shared ones from the first."""
        found = np.empty(len(self.of))
        for row, experiment in reversed(list(zip(self.columns(), experiments, strict=True))):
            model = model_of(experiment)
            found[row] = [float(tree.get(model, f.paths[0])) for f in self.free]
        return found

    def to_values(self, y: np.ndarray) -> np.ndarray:
        """Values in SI units (..., P) of a point."""
        low, high, log = self._bounds()
        z = 0.5 * (1.0 + np.sin(y))
        value = low + z * (high - low)
        return np.where(log, np.exp(np.where(log, value, 0.0)), value)

    def slope(self, y: np.ndarray) -> np.ndarray:
        """d value/d y (..., P)."""
        low, high, log = self._bounds()
        inner = 0.5 * (high - low) * np.cos(y)
        return np.where(log, self.to_values(y) * inner, inner)

    def to_point(self, values: np.ndarray) -> np.ndarray:
        """The point (..., P) of values; what lies outside its bounds, or on them, goes inside."""
        low, high, log = self._bounds()
        values = np.asarray(values, float)
        value = np.where(log, np.log(np.where(log & (values > 0.0), values, 1.0)), values)
        share = 2.0 * (value - low) / (high - low) - 1.0
        return np.clip(np.arcsin(np.clip(share, -1.0, 1.0)), -_INSIDE, _INSIDE)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        of = self.of
        log = np.array([f.log for f in self.free])[of]
        low = np.array([f.lower for f in self.free])[of]
        high = np.array([f.upper for f in self.free])[of]
        low, high = (np.where(log, np.log(np.where(log, v, 1.0)), v) for v in (low, high))
        return low, high, log

    def at_bounds(self, values: np.ndarray) -> dict[str, tuple[float, float]]:
        """The columns whose value lies on a bound (to a thousandth of their distance)."""
        low, high, log = self._bounds()
        value = np.where(log, np.log(np.where(log, values, 1.0)), values)
        share = (value - low) / (high - low)
        at = (share < 1e-3) | (share > 1.0 - 1e-3)
        bounds = [(self.free[i].lower, self.free[i].upper) for i in self.of]
        return {n: b for n, b, hit in zip(self.names, bounds, at, strict=True) if hit}


def with_values(model: Model, free: tuple[Free, ...], values: Any) -> Model:
    """The tree of one experiment with its free parameters set; values (len(free),), or traced."""
    set_: Mapping[str, Any] = {p: values[i] for i, f in enumerate(free) for p in f.paths}
    model = tree.replace(model, set_)
    return wound(model) if model.at_rest else model
