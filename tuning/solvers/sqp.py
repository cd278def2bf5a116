"""Sequential quadratic programming in a trust region.

The limits enter by an exact penalty, one row per limit and drive; the curvature is a damped BFGS
matrix of the Lagrangian. A trial whose runs fail, or whose merit does not fall as the model says,
is rejected and the trust region shrinks: no step can make things worse or carry a nan on.

Where contacts come and go, ITAE has kinks, and the largest torque is that of now one, now another
impact: minima lie in such folds, where one gradient says nothing of the other side. So the points
seen lately stand in the model by their tangents (cuts, as in bundle methods). Measured on the
bench, one drive, 16 starts: without cuts the median start ended 41 % above the best law, with them
10 to 17 %; begun after 40 generations of CMA-ES, which end 2.4 % above, it ends at the best law.

Tried and left out: a second-order correction after a rejection (on the bench 27 to 42 iterations
for the same end, against 30 without); tangents at points drawn around every trial (five times the
runs: 6 % nearer from random starts, nothing gained after CMA-ES). Forward-mode Jacobians come with
every value, so rejected trials still teach the curvature.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from tuning.local import Local, Rows
from tuning.solver import CONVERGED, SPENT, STALLED, Solver, State, first_hessian, near_step
from tuning.subproblem import Step, best_step, merit

_LEAST_RADIUS = 1e-8
_FIRST_PENALTY, _MOST_PENALTY = 1.0, 1e8
_ACCEPT, _GOOD = 1e-4, 0.75  # shares of the predicted fall of the merit
_NO_FALL = 1e-13  # a predicted fall below this share of the merit is rounding
_DAMPING = 0.2  # Powell's
# The share of the attainable cut in violation that a step must make (Byrd, Nocedal, Waltz 2008).
_STEERING = 0.3
# Cuts that are kept, and how far they reach, in radii: a rejected trial lies four radii away when
# its tangent is needed. With a reach of one, 15 of 16 starts stalled at the first fold.
_CUTS, _REACH = 12, 5.0
_NEARER = 0.25


class Cut(NamedTuple):
    """The tangents of all terms at a point (P,): values (terms,), slopes (terms, P).

    Goals first, then limits; of each its largest row.
    """

    z: np.ndarray
    values: np.ndarray
    slopes: np.ndarray


@dataclasses.dataclass(frozen=True)
class Memory:
    """hessian (P, P) and penalty of the model; cuts, the last one newest; step proposed last."""

    hessian: np.ndarray
    penalty: float = _FIRST_PENALTY
    cuts: tuple[Cut, ...] = ()
    step: Step | None = None


class Sqp(Solver):
    """Gradients: few iterations, and multipliers that tell what a limit costs."""

    slopes = True
    first_radius = 0.1

    def remember(self, s: State, local: Local) -> Memory:
        known = s.memory
        return known if known is not None else Memory(first_hessian(local, self.first_radius))

    def again(self, s: State) -> State:
        """With the curvature and the penalty that it has."""
        fresh = super().again(s)
        if not isinstance(s.memory, Memory):
            return fresh
        return dataclasses.replace(fresh, memory=Memory(s.memory.hessian, s.memory.penalty))

    def propose(self, s: State, tolerance: float, most: int) -> tuple[State, np.ndarray]:
        here = s.local
        assert here is not None
        reach, moves = _REACH * s.radius, False
        while True:
            cuts = _within(s.memory.cuts, s.z, reach)
            penalty, step = _steered(s, with_cuts(here, s.z, cuts))
            if step is None:
                return s.ended(STALLED, "the model of the step is not finite"), s.z[None]
            s = _with_step(s, step, penalty)
            moves = _moves(s, here, step, tolerance)
            if moves or not cuts:
                break
            # Far tangents can lie: where they leave no step, the near ones are asked.
            reach = _NEARER * max(float(np.abs(cut.z - s.z).max()) for cut in cuts)
        if not moves:
            free = float(np.abs(step.d).max()) < 0.99 * s.radius
            why = "" if free else "no shorter step improves it"
            return s.ended(CONVERGED if free else STALLED, why), s.z[None]
        if s.iterations >= most:
            return s.ended(SPENT, f"{most} iterations"), s.z[None]
        return s, np.clip(s.z + step.d, 0.0, 1.0)[None]

    def judge(self, s: State, points: np.ndarray, found: list[Local | str]) -> State:
        """Accept or reject the trial."""
        (z,), (local,) = points, found
        here, step, penalty = s.local, s.memory.step, s.memory.penalty
        assert here is not None
        s = dataclasses.replace(s, iterations=s.iterations + 1)
        length = float(np.abs(step.d).max())
        if isinstance(local, str):
            return _shrunk(s, 0.25 * length, local)
        now = merit(here, penalty)
        ratio = (now - merit(local, penalty)) / (now - step.merit)
        # A rejected trial may still be the best point: the merit weighs cost against violation.
        s = _learned(s, z, local).met(z, local)
        if ratio < _ACCEPT:
            return _shrunk(s, 0.25 * length, "no shorter step improves it")
        radius = s.radius
        if ratio > _GOOD and length >= 0.99 * s.radius:
            radius = min(2.0 * radius, 1.0)
        elif ratio < 0.25:
            radius = 0.5 * length
        return dataclasses.replace(s, z=z, local=local, radius=radius)

    def multipliers(self, s: State, local: Local) -> Step | None:
        if not isinstance(s.memory, Memory) or s.best is None:
            return super().multipliers(s, local)
        model = with_cuts(local, s.best, _within(s.memory.cuts, s.best, _REACH * s.radius))
        return near_step(s, model, s.memory.hessian, s.memory.penalty)

    def dump(self, memory: Memory) -> dict[str, Any]:
        cuts = [cut._asdict() for cut in memory.cuts]
        return {"hessian": memory.hessian, "penalty": memory.penalty, "cuts": cuts}

    def restore(self, table: dict[str, Any]) -> Memory:
        cuts = [Cut(**{k: np.array(v, float) for k, v in cut.items()}) for cut in table["cuts"]]
        return Memory(np.array(table["hessian"], float), table["penalty"], tuple(cuts))


def _with_step(s: State, step: Step, penalty: float) -> State:
    return dataclasses.replace(s, memory=dataclasses.replace(s.memory, step=step, penalty=penalty))


def _moves(s: State, here: Local, step: Step, tolerance: float) -> bool:
    """Whether a step is worth a trial: of one that still breaks a limit, shorter ones are."""
    enough = tolerance if here.violation <= 0.0 else 1e-3 * tolerance
    now = merit(here, s.memory.penalty)
    return float(np.abs(step.d).max()) > enough and now - step.merit > _NO_FALL * abs(now)


def _steered(s: State, model: Local) -> tuple[float, Step | None]:
    """The smallest penalty, in powers of ten, whose step cuts the violation as it should."""
    lower = np.maximum(-s.radius, -s.z)
    upper = np.minimum(s.radius, 1.0 - s.z)

    def solved(penalty: float) -> tuple[Step | None, float]:
        step = best_step(model, s.memory.hessian, penalty, lower, upper)
        return step, np.inf if step is None else float(np.maximum(step.excess, 0.0).sum())

    now = float(np.maximum(model.excess, 0.0).sum())
    penalty = s.memory.penalty
    step, left = solved(penalty)
    if left <= 1e-9:
        return penalty, step
    least = solved(_MOST_PENALTY)[1]
    wanted = 1e-9 if least <= 1e-9 else now - _STEERING * (now - least) + 1e-9
    while left > wanted and penalty < _MOST_PENALTY:
        penalty *= 10.0
        step, left = solved(penalty)
    return penalty, step


def _shrunk(s: State, radius: float, reason: str) -> State:
    s = dataclasses.replace(s, radius=radius)
    return s.ended(STALLED, reason) if radius < _LEAST_RADIUS else s


def _learned(s: State, z: np.ndarray, local: Local) -> State:
    """With the curvature between here and a trial, and with cuts at both."""
    memory, here = s.memory, s.local
    assert here is not None
    cuts = (*memory.cuts, _cut(s.z, here), _cut(z, local))[-_CUTS:]
    hessian = _updated(memory.hessian, memory.step, here, local)
    return dataclasses.replace(s, memory=dataclasses.replace(memory, hessian=hessian, cuts=cuts))


def _updated(hessian: Any, step: Step, before: Local, after: Local) -> np.ndarray:
    """BFGS on the gradient of the Lagrangian, with Powell's damping: it stays positive."""
    d = step.d
    y = _lagrangian(after, step) - _lagrangian(before, step)
    Hd = hessian @ d
    curvature, own = float(d @ y), float(d @ Hd)
    if not np.isfinite(y).all() or own <= 0.0:
        return hessian
    if curvature < _DAMPING * own:
        share = (1.0 - _DAMPING) * own / (own - curvature)
        y = share * y + (1.0 - share) * Hd
    return hessian - np.outer(Hd, Hd) / own + np.outer(y, y) / float(d @ y)


def _lagrangian(local: Local, step: Step) -> np.ndarray:
    """Its gradient at the multipliers of the step; cuts, which come last, are straight."""
    terms = zip(
        (*local.goals, *local.limits), (*step.goal_weights, *step.limit_weights), strict=True
    )
    return np.asarray(sum(weights[: len(rows.values)] @ rows.slopes for rows, weights in terms))


def _cut(z: np.ndarray, local: Local) -> Cut:
    terms = (*local.goals, *local.limits)
    largest = [int(np.argmax(rows.values)) for rows in terms]
    values = np.array([rows.values[k] for rows, k in zip(terms, largest, strict=True)])
    slopes = np.array([rows.slopes[k] for rows, k in zip(terms, largest, strict=True)])
    return Cut(z, values, slopes)


def _within(cuts: tuple[Cut, ...], z: np.ndarray, reach: float) -> list[Cut]:
    """Those at other points that are near."""
    return [cut for cut in cuts if 0.0 < float(np.abs(cut.z - z).max()) <= reach]


def with_cuts(local: Local, z: np.ndarray, cuts: list[Cut]) -> Local:
    """The objective at z with a row more per term and cut.

    A tangent that is above the value at z (the term is not convex) is lowered to it.
    """

    def grown(rows: Rows, k: int) -> Rows:
        top = float(rows.values.max())
        values = [min(top, float(cut.values[k] + cut.slopes[k] @ (z - cut.z))) for cut in cuts]
        return rows._replace(
            values=np.append(rows.values, values),
            slopes=np.vstack([rows.slopes, *(cut.slopes[k] for cut in cuts)]),
            source=np.append(rows.source, np.full(len(cuts), -1)),
        )

    if not cuts:
        return local
    goals = tuple(grown(rows, k) for k, rows in enumerate(local.goals))
    limits = tuple(grown(rows, len(goals) + k) for k, rows in enumerate(local.limits))
    return Local(goals, limits)
