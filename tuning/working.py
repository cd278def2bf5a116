"""Drives that a law does not suit: which of many to search on, and how many of fresh ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxsim.objective import Limit
from tuning import space
from tuning.drive_set import hypercube
from tuning.local import RESERVE, size
from tuning.problem import Problem
from tuning.scoring import Scores, fresh
from tuning.solver import State

# So many join a search at once: those next to the worst are cured with it.
_JOIN = 32


class Check(NamedTuple):
    """A law on drives drawn afresh.

    count: drives. broken: limit in words -> drives that break it. failed: drives whose run failed.
    bad: drives with either. worst: limit in words -> its largest value and the drive in words.
    """

    count: int
    broken: dict[str, int]
    failed: int
    bad: int
    worst: dict[str, tuple[float, str]]

    @property
    def share(self) -> float:
        """The share of the drives that a limit is broken on, or that fail."""
        return self.bad / self.count


def excess(scores: Scores, limit: Limit) -> np.ndarray:
    """By what share of its bound each drive exceeds a limit in its worst case (drives,)."""
    values = scores.values[limit.metric].reshape(len(scores.status), -1)
    return np.nan_to_num(limit.excess(values) / size(limit), nan=np.inf).max(axis=1)


def worse(problem: Problem, state: State, drives: np.ndarray) -> np.ndarray:
    """Of `drives` (by index) the worst under the best law of a state, beyond those it knows.

    A drive whose run fails is among them.
    """
    assert state.best is not None
    assert state.best_local is not None
    gains = space.to_gains(problem.spec.free, state.best)
    scores = _scores(problem, gains, drives)
    beyond = np.where(scores.status.any(axis=1), np.inf, -np.inf)
    for limit, known in zip(problem.spec.objective.limits, state.best_local.excess, strict=True):
        own = excess(scores, limit) + RESERVE - max(float(known), 0.5 * RESERVE)
        beyond = np.maximum(beyond, own)
    for goal in (g for g in problem.spec.objective.goals if g.over == "worst"):
        values = scores.values[goal.metric].reshape(len(drives), -1).max(axis=1)
        rows = state.best_local.goals[problem.spec.objective.goals.index(goal)].values
        own = values / float(rows.max()) - 1.0 - RESERVE
        beyond = np.maximum(beyond, own)
    order = np.argsort(-beyond, kind="stable")[:_JOIN]
    return drives[order[beyond[order] > 0.0]]


def check(problem: Problem, gains: np.ndarray) -> Check | None:
    """A law on `spec.check` drives that no search has seen; None where none are asked for."""
    spec = problem.spec
    if not spec.check:
        return None
    # Another seed than that of the drives; the first row stays the study's own.
    drawn = hypercube(spec.spreads, spec.check, spec.seed + 1)
    other = Problem(problem.study, spec._replace(drives=np.concatenate([spec.drives[:1], drawn])))
    scores = _scores(other, gains, np.arange(1, spec.check + 1))
    failed = scores.status.any(axis=1)
    bad, broken, worst = failed.copy(), {}, {}
    for limit in spec.objective.limits:
        over = excess(scores, limit)
        row = int(np.argmax(over))
        value = limit.bound + limit.sign * over[row] * size(limit)
        broken[limit.words] = int((over > 0.0).sum())
        worst[limit.words] = (float(value), other.label(row + 1))
        bad |= over > 0.0
    return Check(spec.check, broken, int(failed.sum()), int(bad.sum()), worst)


def sentences(found: Check | None) -> list[str]:
    """A check in words, one line per limit."""
    if found is None:
        return []
    share = f"{found.bad} of {found.count} fresh drives ({100.0 * found.share:.2g} %)"
    lines = [f"{share} break a limit or fail."]
    for words, (value, where) in found.worst.items():
        lines.append(f"{words} on fresh drives: worst {value:.6g} on {where}.")
    return lines


def _scores(problem: Problem, gains: np.ndarray, drives: np.ndarray) -> Scores:
    laws = np.tile(gains, (len(drives), 1))
    return fresh(problem, laws, drives, problem.study.run.dt, problem.metrics)
