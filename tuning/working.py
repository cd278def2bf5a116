"""Drives that a law does not suit: which of many to search on, and how many of fresh ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxsim.objective import Limit, Objective
from tuning.drive_set import hypercube
from tuning.local import RESERVE, Local, size
from tuning.problem import Problem
from tuning.scoring import Scores, fresh

# So many join a search of one law at once: those next to the worst are cured with it. Of several
# laws each has a share, but not fewer than the second number.
_JOIN, _FEWEST = 32, 4


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


def worse(
    problem: Problem,
    objective: Objective,
    laws: np.ndarray,
    known: Sequence[Local],
    drives: np.ndarray,
) -> np.ndarray:
    """Of `drives` (by index) the worst under some laws, beyond those that these know.

    laws (n, P): on the unit cube. known: the objective at each, on the drives looked at. A drive
    whose run fails is among the worst. All laws have the same share of those that join.
    """
    outcome = problem.evaluate(laws, drives, slopes=False)
    each = max(_JOIN // len(laws), _FEWEST)
    found: list[int] = []
    for local, values, status in zip(known, outcome.values, outcome.status, strict=True):
        failed = status.any(axis=1)
        far = np.where(failed, np.inf, _beyond(objective, problem.metrics, local, values))
        order = np.argsort(-far, kind="stable")[:each]
        found += drives[order[far[order] > 0.0]].tolist()
    return np.array(list(dict.fromkeys(found)), int)


def _beyond(
    objective: Objective, metrics: tuple[str, ...], known: Local, values: np.ndarray
) -> np.ndarray:
    """By what share each drive (values: drives, cases, metrics) is worse than those known."""
    far = np.full(len(values), -np.inf)
    for limit, least in zip(objective.limits, known.excess, strict=True):
        own = limit.excess(values[..., metrics.index(limit.metric)]).max(axis=1) / size(limit)
        far = np.maximum(far, own + RESERVE - max(float(least), 0.5 * RESERVE))
    for goal, rows in zip(objective.goals, known.goals, strict=True):
        if goal.over == "worst":
            top = float(rows.values.max())
            own = values[..., metrics.index(goal.metric)].max(axis=1)
            far = np.maximum(far, (own - top) / (abs(top) or 1.0) - RESERVE)
    return np.nan_to_num(far, nan=np.inf)


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
