"""Fresh runs on the exact model: what laws really do, whatever the search ran on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxsim import batch
from jaxsim._simulate import simulate
from jaxsim.catalog import METRICS
from jaxsim.hybrid import Deadzone, Exact
from jaxsim.objective import Goal, Limit, Objective
from tuning import space
from tuning.problem import Outcome, Problem

# Runs in a batch of values without slopes: from here on both cores are at work.
_ROWS = 256


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


def values_only(problem: Problem, points: np.ndarray, drives: np.ndarray) -> Outcome:
    """As `Problem.evaluate`, without slopes (their last axis is empty), at a twentieth of the cost.

    In batches of one size, so that a search that loses starts compiles once.
    """
    gains = np.repeat(space.to_gains(problem.spec.free, points), len(drives), axis=0)
    own, count = np.tile(drives, len(points)), len(points) * len(drives)
    rows = np.minimum(np.arange(-(-count // _ROWS) * _ROWS), count - 1).reshape(-1, _ROWS)
    run = problem.study.run
    parts = [
        _measured(problem, gains[r], own[r], run.dt, problem.metrics, run.deadzone) for r in rows
    ]
    shape = (len(points), len(drives))
    values = np.stack(
        [np.concatenate([p.values[name] for p in parts])[:count] for name in problem.metrics], -1
    )
    values = values.reshape(*shape, -1, len(problem.metrics))
    status = np.concatenate([p.status for p in parts])[:count].reshape(*shape, -1)
    return Outcome(values, np.empty((*values.shape, 0)), status)


def fresh(
    problem: Problem, gains: np.ndarray, drives: np.ndarray, dt: float, metrics: Any
) -> Scores:
    """One run of the exact model per row of gains (n, P) and index of a drive (n,), per scenario.

    metrics: names, None for all. All runs of a scenario are one batch.
    """
    own = problem.study.run.deadzone
    exact = own if isinstance(own, Exact) else Exact()
    return _measured(problem, gains, drives, dt, metrics, exact)


def _measured(
    problem: Problem,
    gains: np.ndarray,
    drives: np.ndarray,
    dt: float,
    metrics: Any,
    deadzone: Deadzone,
) -> Scores:
    study, spec = problem.study, problem.spec
    law, drive = batch.spread(study.law, **space.leaves(spec.free, gains)), study.drive
    if spec.spreads:
        own = problem.drives[drives]
        drive = batch.spread(drive, **{s.path: own[:, i] for i, s in enumerate(spec.spreads)})
    runs = [
        simulate(
            drive,
            law,
            scenario,
            dt=dt,
            deadzone=deadzone,
            metrics=metrics,
            store=None,
            dtype=study.run.dtype,
            throw=False,
        )
        for scenario in study.scenarios.values()
    ]
    shape = (len(gains), -1)
    values = {
        name: np.stack([np.asarray(run.metrics[name], float).reshape(shape) for run in runs], 1)
        for name in runs[0].metrics
    }
    return Scores(values, np.stack([np.asarray(run.status) for run in runs], axis=1))
