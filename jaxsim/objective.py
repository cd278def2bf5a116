"""What is wanted of a law: metrics to make small, and limits that must hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from jaxsim.catalog import METRICS
from jaxsim.criterion import chosen
from jaxsim.errors import InputError, called
from jaxsim.validation import check

# A smaller weight in a quantile is none: what is far from it may be infinite.
_NOTHING = 1e-12

Over = str | float  # "mean", "worst", or a quantile between 0 and 1


class Goal(NamedTuple):
    """weight * metric, taken over all drives and scenarios by `over`.

    A quantile is the one of Harrell and Davis: it moves smoothly with the law, where one between
    two of the runs has a kink whenever others take their place.
    """

    metric: str
    weight: float
    over: Over

    def reduce(self, values: Any) -> Any:
        """The one number of values (members,) of the metric."""
        return _reduce(values, self.over, smooth=True)


class Limit(NamedTuple):
    """metric <= bound for every drive and scenario (the worst case), or for a quantile of them.

    With least: metric >= bound. A quantile is counted: 0.9 keeps nine in ten runs below the bound.
    """

    metric: str
    bound: float
    over: Over
    least: bool = False

    @property
    def sign(self) -> float:
        """1, or -1 where the metric must be large: sign*metric <= sign*bound."""
        return -1.0 if self.least else 1.0

    @property
    def words(self) -> str:
        return f"{self.metric} {'>=' if self.least else '<='} {self.bound:g}"

    def reduce(self, values: Any) -> Any:
        """The one number of values (members,) of the metric that the bound is about."""
        return self.sign * _reduce(self.sign * values, self.over, smooth=False)

    def excess(self, value: Any) -> Any:
        """By how much a value breaks it, in the unit of the metric; <= 0 where it holds."""
        return self.sign * (value - self.bound)


class Objective(NamedTuple):
    """Goals to minimise (their weighted sum) and limits to keep."""

    goals: tuple[Goal, ...]
    limits: tuple[Limit, ...]

    def metrics(self) -> tuple[str, ...]:
        """The metrics that it needs, each once."""
        return tuple(dict.fromkeys(item.metric for item in (*self.goals, *self.limits)))

    def sign(self, metric: str) -> float | None:
        """1 where less of a metric is better, -1 where more is; None where it is not asked for."""
        signs = [limit.sign for limit in self.limits if limit.metric == metric]
        wanted = any(goal.metric == metric for goal in self.goals)
        return next(iter(signs), 1.0 if wanted else None)


class _Goal(BaseModel):
    model_config = ConfigDict(extra="forbid")
    weight: float = Field(gt=0, allow_inf_nan=False, default=1.0)
    over: Over = "mean"


class _Limit(BaseModel):
    model_config = ConfigDict(extra="forbid")
    most: float | None = Field(allow_inf_nan=False, default=None)
    least: float | None = Field(allow_inf_nan=False, default=None)
    over: Over = "worst"


def read_objective(table: Mapping[str, Any], where: str = "objective") -> Objective:
    """The objective that a table describes.

    `minimise = { METRIC = WEIGHT or { weight, over } }`, `limits = { METRIC = MOST or
    { most or least, over } }` with over = "mean", "worst" or a quantile such as 0.95. Defaults:
    the mean for goals, the worst case for limits. METRIC is a metric or a stability criterion.

    Raises: InputError for unknown keys and metrics, or where nothing is to be minimised.
    """
    for key in table:
        if key not in ("minimise", "limits"):
            raise InputError.unknown(f"{where}.{key}", key, ("minimise", "limits"))
    goals = [
        Goal(name, item.weight, _over(item.over, f"{where}.minimise.{name}"))
        for name, item in _items(table, "minimise", _Goal, "weight", where)
    ]
    limits = [
        _limit(name, item, f"{where}.limits.{name}")
        for name, item in _items(table, "limits", _Limit, "most", where)
    ]
    if not goals:
        raise InputError(
            f"{where}.minimise", "must name at least one metric", "none", "e.g. itae_rad_s2 = 1.0"
        )
    return Objective(tuple(goals), tuple(limits))


def _limit(name: str, item: _Limit, where: str) -> Limit:
    given = [v for v in (item.most, item.least) if v is not None]
    if len(given) != 1:
        got = {"most": item.most, "least": item.least}
        raise InputError(where, "must have one bound, most or least", got, "e.g. { least = 6.0 }")
    return Limit(name, given[0], _over(item.over, where), item.most is None)


def _items(
    table: Mapping[str, Any], key: str, model: type[BaseModel], main: str, where: str
) -> list[tuple[str, Any]]:
    given = table.get(key, {})
    if not isinstance(given, Mapping):
        raise InputError(f"{where}.{key}", "must be a table", repr(given), "e.g. METRIC = 1.0")
    items = []
    for name, value in given.items():
        check_name(name, f"{where}.{key}.{name}")
        wanted = value if isinstance(value, Mapping) else {main: value}
        items.append((name, check(model, wanted, f"{where}.{key}.{name}")))
    return items


def check_name(name: str, where: str) -> None:
    """Raises: InputError for what is neither a metric nor a criterion, with the nearest."""
    metrics = [v for group in METRICS.all().values() for v in group.values]
    with called(where):
        chosen((name,), metrics)


def _over(over: Over, where: str) -> Over:
    words = over in ("mean", "worst")
    quantile = not isinstance(over, str) and 0.0 < over < 1.0
    if not (words or quantile):
        raise InputError(
            f"{where}.over",
            'must be "mean", "worst" or a quantile in (0, 1)',
            repr(over),
            'e.g. "worst"',
        )
    return over


def ordered_weights(over: Over, count: int, *, smooth: bool) -> np.ndarray:
    """Weights (count,) of values in ascending order whose sum is their mean, maximum or quantile.

    A quantile q lies between two of them, at q (count - 1); with smooth it is the sum of all,
    weighted by Beta((count + 1) q, (count + 1)(1 - q)) over [i/count, (i + 1)/count].
    Source: Harrell and Davis, A new distribution-free quantile estimator, Biometrika 69 (1982).
    """
    if over == "mean":
        return np.full(count, 1.0 / count)
    if over == "worst":
        return np.eye(count)[-1]
    q = float(over)
    if smooth:
        from scipy.stats import beta  # slow to import, and rarely needed

        edges = np.linspace(0.0, 1.0, count + 1)
        weights = np.diff(beta.cdf(edges, (count + 1) * q, (count + 1) * (1.0 - q)))
        return np.where(weights < _NOTHING, 0.0, weights)
    place = q * (count - 1)
    return np.maximum(0.0, 1.0 - np.abs(np.arange(count) - place))


def _reduce(values: Any, over: Over, *, smooth: bool) -> Any:
    values = np.asarray(values, float)
    weights = ordered_weights(over, len(values), smooth=smooth)
    # A weight of 0 times infinity is not 0: what does not count is left out.
    return weights[weights > 0.0] @ np.sort(values)[weights > 0.0]
