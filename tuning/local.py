"""An objective near one law: values of all its terms and their slopes, one row per drive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxsim.objective import Limit, Objective, Over, ordered_weights

# The search keeps this share of each bound in reserve, for rounding alone: fresh runs of the same
# model are compiled apart. What a smaller step would change is judged when a result is scored
# (`tuning.result`). A reserve for that, 1e-4 of each bound, cost 0.013 % of the optimum.
RESERVE = 1e-7


class Rows(NamedTuple):
    """A term of which the largest row counts: values (k,), slopes (k, P), its factor.

    For a goal the factor is its weight; a limit has values (metric - bound)/factor + RESERVE, with
    the opposite sign where the bound is a least one: <= 0 if it is kept with the reserve.
    source: the drive of each row, by its place among the drives looked at.
    """

    values: np.ndarray
    slopes: np.ndarray
    factor: float
    source: np.ndarray


class Local(NamedTuple):
    """Goals and limits at one law."""

    goals: tuple[Rows, ...]
    limits: tuple[Rows, ...]

    @property
    def cost(self) -> float:
        """Weighted sum of the goals."""
        return float(sum(g.factor * g.values.max() for g in self.goals))

    @property
    def excess(self) -> np.ndarray:
        """By what share of its bound each limit, less the reserve, is exceeded (limits,)."""
        return np.array([limit.values.max() for limit in self.limits])

    @property
    def violation(self) -> float:
        """By what share the worst limit is exceeded; 0 where all are kept by half the reserve."""
        worst = float(self.excess.max(initial=0.0)) - 0.5 * RESERVE
        return max(worst, 0.0)


def localise(
    objective: Objective,
    names: tuple[str, ...],
    values: np.ndarray,
    slopes: np.ndarray,
    sample: np.ndarray | None = None,
) -> Local:
    """The objective at one law.

    values: (drives, cases, metrics); slopes: (drives, cases, metrics, P); names: of the metrics;
    a case is an axis in a scenario. sample (drives,): those that stand for all in a mean or a
    quantile; the others are there because they are bad.
    """

    def rows(metric: str, over: Over, sign: float = 1.0, smooth: bool = True) -> Rows:
        at = names.index(metric)
        if sample is None or over == "worst":
            chosen = np.arange(len(values))
        else:
            chosen = np.flatnonzero(sample)
        source = np.repeat(chosen, values.shape[1])
        rates = slopes[chosen][..., at, :].reshape(len(source), slopes.shape[-1])
        own = sign * values[chosen][..., at].reshape(-1)
        return _over(own, sign * rates, source, over, smooth)

    return Local(
        tuple(rows(g.metric, g.over)._replace(factor=g.weight) for g in objective.goals),
        tuple(_relative(rows(x.metric, x.over, x.sign, smooth=False), x) for x in objective.limits),
    )


def size(limit: Limit) -> float:
    """What an excess of a limit is measured by: the bound, or 1 SI unit where that is 0."""
    return abs(limit.bound) or 1.0


def _relative(rows: Rows, limit: Limit) -> Rows:
    by = size(limit)
    excess = rows.values - limit.sign * limit.bound
    return Rows(excess / by + RESERVE, rows.slopes / by, by, rows.source)


def _over(
    values: np.ndarray, slopes: np.ndarray, source: np.ndarray, over: Over, smooth: bool
) -> Rows:
    """All rows for the worst case, one for a mean or a quantile.

    The slopes are those of the order in which the values stand.
    """
    if over == "worst":
        return Rows(values, slopes, 1.0, source)
    weights = np.empty(len(values))
    weights[np.argsort(values)] = ordered_weights(over, len(values), smooth=smooth)
    main = source[[int(np.argmax(weights))]]
    return Rows((weights @ values)[None], (weights @ slopes)[None], 1.0, main)
