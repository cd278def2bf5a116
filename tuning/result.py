"""What a search has found: a law, scored afresh on the exact model, and whether its limits hold."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from jaxsim.objective import Limit
from tuning import certificate as certificates
from tuning import space, working
from tuning.certificate import Case, Certificate
from tuning.conflict import Attained, conflict
from tuning.local import Local, localise, size
from tuning.problem import Outcome, Problem
from tuning.scoring import Scores, everything, fresh, score
from tuning.session import Session
from tuning.solver import SPENT, STALLED, State

# A limit whose multiplier is below this share of the cost does not hold the law back.
_IDLE = 1e-6
# Drives whose share of a bound is smaller than that of the worst one by this have no say in it.
_ROOM = 0.1
# The engine moves peaks by 3e-6 of themselves from dt = 2e-4 s to the limit, other studies may be
# coarser: at half the step a limit may be exceeded by this share of its bound. The value at the
# step of the study may not exceed it at all.
_FINER = 1e-4


class Verdict(NamedTuple):
    """One limit at the end: value on the exact model, at half the step, worst drive and scenario.

    price: by what the cost falls per unit of a looser bound, as the search has it (nan if
    unknown); 0 where the limit is idle.
    """

    limit: Limit
    value: float
    finer: float
    drive: int
    scenario: int
    price: float

    @property
    def holds(self) -> bool:
        return self.excess <= 0.0

    @property
    def excess(self) -> float:
        finer = self.limit.excess(self.finer) - _FINER * size(self.limit)
        return max(self.limit.excess(self.value), finer)

    @property
    def share(self) -> float:
        """By what share of its bound it is exceeded."""
        return self.excess / size(self.limit)


class Result(NamedTuple):
    """A tuned law and its evidence.

    drives: indices of those scored, in every scenario. cases: the study's drive and the one that
    decides; certificate: on them. before, after: scores of the study's law
    and of the tuned one at the study's dt; finer: of the tuned one at dt/2, metrics of the
    objective only. searched: its cost as the search had it (on fewer drives if it was interrupted
    early). check: of the tuned law on fresh drives, where the study asks for it. attained: of a
    search that ended without a feasible law, how far each limit can be met.
    """

    law: Any
    gains: np.ndarray
    initial: np.ndarray
    drives: np.ndarray
    before: Scores
    after: Scores
    finer: Scores
    verdicts: tuple[Verdict, ...]
    cases: tuple[Case, ...]
    certificate: Certificate
    searched: float
    status: str
    reason: str
    check: working.Check | None
    attained: tuple[Attained, ...]

    @property
    def feasible(self) -> bool:
        complete = not (self.after.status.any() or self.finer.status.any())
        return complete and all(v.holds for v in self.verdicts)

    @property
    def worst(self) -> Case:
        """The case that decides."""
        return self.cases[-1]


def conclude(session: Session) -> Result:
    """Score the study's law and the best one of a session on the exact model, by fresh runs.

    Where a finished search has no feasible law, the one whose worst limit is broken least.
    """
    drives = np.array([i for i in range(session.spec.count) if i not in session.excluded])
    state = _best(session, drives)
    found = _judged(session, state, drives)
    unfinished = session.interrupted or state.status == SPENT
    if unfinished or all(v.holds for v in found.verdicts):
        return found
    seen = conflict(session, state)
    nearest = _judged(session, seen.nearest, drives)
    if nearest.feasible:
        why = "it was met with the goals set aside; --law goes on from it"
        return nearest._replace(status=STALLED, reason=why)
    return min(found, nearest, key=_broken)._replace(attained=seen.attained)


def _broken(result: Result) -> float:
    """By what share the worst limit is broken; inf where runs fail."""
    if result.after.status.any() or result.finer.status.any():
        return np.inf
    return max((v.share for v in result.verdicts), default=0.0)


def _judged(session: Session, state: State, drives: np.ndarray) -> Result:
    """The law of a state by fresh runs on these drives."""
    study, problem = session.study, session.problem
    assert state.best is not None
    assert state.best_local is not None
    gains = space.to_gains(session.spec.free, state.best)
    initial = space.gains_of(study.law, session.spec.free)
    outcome = problem.evaluate(state.best[None], drives)
    told = prices(session, state, outcome)
    cases = certificates.cases(problem, outcome, drives)
    with ThreadPoolExecutor(2) as pool:  # two programs, which compile side by side
        half = pool.submit(score, problem, [gains], drives, 0.5 * study.run.dt, problem.metrics)
        before, after, *beside = _fresh(problem, initial, gains, drives, cases)
        (finer,) = half.result()
    verdicts = tuple(
        _verdict(limit, price, after, finer, drives)
        for limit, price in zip(session.spec.objective.limits, told, strict=True)
    )
    return Result(
        law=space.with_gains(study.law, session.spec.free, gains),
        gains=gains,
        initial=initial,
        drives=drives,
        before=before,
        after=after,
        finer=finer,
        verdicts=verdicts,
        cases=cases,
        certificate=certificates.certificate(
            problem, state.best, outcome, drives, cases, after, beside
        ),
        searched=state.best_local.cost * session.unit,
        status="interrupted" if session.interrupted else state.status,
        reason="" if session.interrupted else state.reason,
        check=None if session.interrupted else working.check(problem, gains),
        attained=(),
    )


def _best(session: Session, drives: np.ndarray) -> State:
    """The best law on all drives.

    A search that was interrupted on the few drives of its screen has not looked at the others: what
    it has found there may be worse than the law that it began with. So all of them are compared.
    """
    if session.final:
        return session.best()
    problem, spec = session.problem, session.spec
    given = space.starting_points(session.study.law, spec)[0]
    states = [State(given, best=given), *(s for s in session.states if s.best is not None)]
    points = np.array([s.best for s in states])
    found = []
    for s, values, slopes, status in zip(states, *problem.evaluate(points, drives), strict=True):
        if not status.any() and np.isfinite(values).all() and np.isfinite(slopes).all():
            local = localise(spec.objective, problem.metrics, values, slopes)
            goals = tuple(g._replace(factor=g.factor / session.unit) for g in local.goals)
            found.append(dataclasses.replace(s, best_local=local._replace(goals=goals)))
    return min(found, key=lambda s: s.rank) if found else session.best()


def _fresh(
    problem: Problem, initial: np.ndarray, gains: np.ndarray, drives: np.ndarray, cases: Any
) -> list[Scores]:
    """Scores of both laws on all drives, and per case those beside the tuned law.

    All in one batch: the certificate costs its runs, but no program of its own to compile.
    """
    beside = certificates.moved(gains)
    laws = [np.tile(initial, (len(drives), 1)), np.tile(gains, (len(drives), 1))]
    own = [drives, drives]
    for case in cases:
        laws.append(beside)
        own.append(np.full(len(beside), case.drive))
    runs = np.concatenate(laws), np.concatenate(own)
    whole = fresh(problem, *runs, problem.study.run.dt, everything(problem))
    ends = np.cumsum([len(part) for part in own])
    return [whole.part(slice(end - len(part), end)) for part, end in zip(own, ends, strict=True)]


def prices(session: Session, state: State, outcome: Outcome) -> list[float]:
    """d cost/d bound of each limit at the best law of a state; nan where it cannot be told.

    From the multipliers of the step there. outcome: of that law on all drives.
    """
    limits, unit = session.spec.objective.limits, session.unit
    values, slopes = outcome.values[0], outcome.slopes[0]
    objective, metrics = session.spec.objective, session.problem.metrics
    local = _near_bounds(localise(objective, metrics, values, slopes))
    goals = tuple(g._replace(factor=g.factor / unit) for g in local.goals)
    step = session.solver.multipliers(state, local._replace(goals=goals))
    if step is None:
        return [np.nan] * len(limits)
    sums = [float(w.sum()) for w in step.limit_weights]
    # A violated limit has the penalty as its multiplier: a price of nothing.
    return [
        np.nan
        if total >= 0.99 * step.penalty
        else total * unit / size(limit)
        if total > _IDLE
        else 0.0
        for total, limit in zip(sums, limits, strict=True)
    ]


def _near_bounds(local: Local) -> Local:
    """Without the rows of limits that no small step reaches: thousands of drives have most."""
    kept = [rows.values > rows.values.max() - _ROOM for rows in local.limits]
    return local._replace(
        limits=tuple(
            rows._replace(values=rows.values[k], slopes=rows.slopes[k], source=rows.source[k])
            for rows, k in zip(local.limits, kept, strict=True)
        )
    )


def _verdict(
    limit: Limit, price: float, after: Scores, finer: Scores, drives: np.ndarray
) -> Verdict:
    values = (limit.sign * after.values[limit.metric]).max(axis=2)
    place = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    row, scenario = np.unravel_index(place, values.shape)
    there = after.limited(limit), finer.limited(limit)
    return Verdict(limit, *there, int(drives[row]), int(scenario), price)
