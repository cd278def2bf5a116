"""Fresh runs on the exact model: what laws really do, whatever the search ran on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxsim.catalog import METRICS
from jaxsim.hybrid import Exact
from jaxsim.objective import Goal, Limit, Objective
from tuning.problem import Problem


class Scores(NamedTuple):
    """Metrics of one law: name -> (drives, scenarios, axes); status (drives, scenarios)."""

    values: dict[str, np.ndarray]
    status: np.ndarray

    def aimed(self, goal: Goal) -> float:
        """What a goal is about, without its weight."""
        return float(goal.reduce(self.values[goal.metric].reshape(-1)))

    def limited(self, limit: Limit) -> float:
        """What a limit is about: the largest value, or the smallest where the bound is a least."""
        return float(limit.reduce(self.values[limit.metric].reshape(-1)))

    def worst(self, metric: str, objective: Objective) -> tuple[float, int, int]:
        """The worst value, its drive (by row) and scenario.

        The largest, or the smallest of what has a least bound; of what is no part of the objective
        the largest in size.
        """
        values, sign = self.values[metric], objective.sign(metric)
        badness = np.abs(values) if sign is None else sign * values
        badness = np.where(np.isnan(values), -np.inf, badness)
        row, scenario, axis = np.unravel_index(int(np.argmax(badness)), badness.shape)
        return float(values[row, scenario, axis]), int(row), int(scenario)

    def of_case(self, metric: str, row: int, scenario: int, objective: Objective) -> float:
        """The value of a drive (by row) in a scenario; of several axes the worst."""
        own = Scores({metric: self.values[metric][[row], scenario][:, None]}, self.status)
        return own.worst(metric, objective)[0]

    def cost(self, objective: Objective) -> float:
        """The weighted sum of the goals."""
        return sum(g.weight * self.aimed(g) for g in objective.goals)

    def part(self, rows: Any) -> Scores:
        """Some of the drives."""
        return Scores({k: v[rows] for k, v in self.values.items()}, self.status[rows])


def everything(problem: Problem) -> tuple[str, ...] | None:
    """All metrics, and the criteria among those of the objective, which None would leave out."""
    metrics = [v for group in METRICS.all().values() for v in group.values]
    criteria = [name for name in problem.metrics if name not in metrics]
    return (*metrics, *criteria) if criteria else None


def score(
    problem: Problem, laws: list[np.ndarray], drives: np.ndarray, dt: float, metrics: Any
) -> list[Scores]:
    """Each law, given by its gains, on each drive, given by its index, in each scenario."""
    gains = np.repeat(np.array(laws), len(drives), axis=0)
    whole = fresh(problem, gains, np.tile(drives, len(laws)), dt, metrics)
    return [whole.part(slice(k * len(drives), (k + 1) * len(drives))) for k in range(len(laws))]


def fresh(
    problem: Problem, gains: np.ndarray, drives: np.ndarray, dt: float, metrics: Any
) -> Scores:
    """One run of the exact model per row of gains (n, P) and index of a drive (n,), per scenario.

    metrics: names, None for all. All runs of a scenario are one batch.
    """
    own = problem.study.run.deadzone
    exact = own if isinstance(own, Exact) else Exact()
    laws = problem.law_of[drives]
    rows = [np.flatnonzero(laws == place) for place in np.unique(laws)]
    options = {"dt": dt, "deadzone": exact, "metrics": metrics}
    parts = [_alike(problem, int(laws[r[0]]), gains[r], drives[r], options) for r in rows]
    back = np.argsort(np.concatenate(rows))
    values = {k: np.concatenate([p.values[k] for p in parts])[back] for k in parts[0].values}
    return Scores(values, np.concatenate([p.status for p in parts])[back])


def _alike(
    problem: Problem, place: int, gains: np.ndarray, drives: np.ndarray, options: dict[str, Any]
) -> Scores:
    """Those of one of the laws."""
    runs = [problem.batch(place, gains, drives, name, **options) for name in problem.scenarios]
    shape = (len(gains), -1)
    values = {
        name: np.stack([np.asarray(run.metrics[name], float).reshape(shape) for run in runs], 1)
        for name in runs[0].metrics
    }
    return Scores(values, np.stack([np.asarray(run.status) for run in runs], axis=1))
