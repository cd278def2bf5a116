"""A front as it is told: laws that no other found one beats, by fresh runs on the exact model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxsim.objective import Goal
from tuning import space
from tuning.pareto import Tracer
from tuning.scoring import Scores, score


class Point(NamedTuple):
    """A law and its scores by fresh runs on the exact model; `goals` are the two numbers."""

    gains: np.ndarray
    goals: tuple[float, float]
    scores: Scores
    feasible: bool


class Front(NamedTuple):
    """Points that no other found law beats in both goals, ordered by the second.

    marks: name -> a law to compare with. drives: scored. left_out: index -> why.
    """

    pair: tuple[Goal, Goal]
    points: tuple[Point, ...]
    marks: dict[str, Point]
    drives: np.ndarray
    left_out: dict[int, str]
    interrupted: bool


def conclude(tracer: Tracer, laws: list[np.ndarray], marks: dict[str, np.ndarray]) -> Front:
    """Score the laws (on the unit cube) and the marks (gains) afresh; keep what none beats."""
    problem, free = tracer.problem, tracer.problem.spec.free
    drives = tracer.every
    gains = [*(space.to_gains(free, z) for z in laws), *marks.values()]
    scored = score(problem, gains, drives, problem.study.run.dt, problem.metrics)
    points = [_point(tracer, g, s) for g, s in zip(gains, scored, strict=True)]
    kept: list[Point] = []
    for p in sorted((p for p in points[: len(laws)] if p.feasible), key=lambda p: p.goals[::-1]):
        if not kept or p.goals[0] < kept[-1].goals[0]:
            kept.append(p)
    named = dict(zip(marks, points[len(laws) :], strict=True))
    return Front(tracer.pair, tuple(kept), named, drives, tracer.left_out, tracer.interrupted)


def _point(tracer: Tracer, gains: np.ndarray, scores: Scores) -> Point:
    first, second = (scores.aimed(g) for g in tracer.pair)
    holds = all(x.excess(scores.limited(x)) <= 0.0 for x in tracer.limits)
    return Point(gains, (first, second), scores, bool(holds and not scores.status.any()))
