"""A tuning run from start to end: all starts on a few drives, then the best on all drives."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim.errors import InputError
from jaxsim.objective import Objective
from jaxsim.study import Study
from tuning import checkpoint, space, working
from tuning.local import Local, localise
from tuning.phase import FULL, Phase, phases
from tuning.problem import Outcome, Problem, Share
from tuning.solver import FAILED, RUNNING, SOLVERS, SPENT, Solver, State
from tuning.spec import Spec

_COARSE = 1e-3  # the screen only has to rank: steps shorter than this, on the unit cube, end it
# Ends of the screen closer than this, on the unit cube, are the same.
_SAME = 1e-2


class Progress(NamedTuple):
    """Where a run stands: iterations of this phase done and at most to do, and the best so far.

    phase: its index and title.
    """

    phase: tuple[int, str]
    done: int
    total: int
    cost: float
    violation: float


@contextlib.contextmanager
def noted_interrupts() -> Iterator[list[int]]:
    """The Ctrl-C pressed so far. Each also raises, as ever.

    Where the exception falls into a callback of JAX, Python prints it and goes on: a search went
    on to its end although it had been interrupted. So it is noted, too.
    """
    pressed: list[int] = []

    def note(number: int, _: Any) -> None:
        pressed.append(number)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield pressed  # only the main thread may set a handler, and only it is interrupted
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, before)


class Session:
    """One search, whose state is on disk after every iteration.

    at: index of the phase. drives: indices of those looked at. excluded: index -> why, of
    drives that fail under every law tried. unit: the cost that counts as 1 in the search.
    history: one table per start and iteration.
    """

    def __init__(self, study: Study, spec: Spec, file: Path, share: Share | None = None) -> None:
        self.study, self.spec, self.file = study, spec, file
        self.problem = Problem(study, spec, share)
        self.phases, self.at = phases(study, spec), 0
        self._solvers: dict[str, Solver] = {n: SOLVERS.find(n)() for n in spec.solvers}
        self._models: dict[int, Problem] = {}
        self.states: list[State] = []
        self.drives = np.arange(spec.count)
        self.excluded: dict[int, str] = {}
        self.unit = 1.0
        self.history: list[dict[str, Any]] = []
        self.seconds = 0.0
        self.done = self.interrupted = False
        self.allowed = spec.iterations  # on all drives, since these were looked at last

    @property
    def phase(self) -> Phase:
        return self.phases[self.at]

    @property
    def final(self) -> bool:
        """Whether the laws of this phase have seen the study's own model, and all drives."""
        return self.at == len(self.phases) - 1

    @property
    def solver(self) -> Solver:
        return self._solvers[self.phase.solver]

    @property
    def _model(self) -> Problem:
        """The runs of this phase."""
        own = self.phase.deadzone
        if own == self.study.run.deadzone:
            return self.problem
        if self.at not in self._models:
            study = self.study._replace(run=self.study.run._replace(deadzone=own))
            self._models[self.at] = Problem(study, self.spec, self.problem.share)
        return self._models[self.at]

    def search(self, tell: Callable[[Progress], None]) -> None:
        """Search to the end, or until Ctrl-C; `tell` is called after every iteration.

        Raises: InputError where no start can be evaluated on any drive.
        """
        begun, before = time.perf_counter(), self.seconds
        try:
            with noted_interrupts() as pressed:
                while not self.done:
                    self._turn()
                    self.seconds = before + time.perf_counter() - begun
                    checkpoint.write(self)
                    tell(self.progress())
                    if pressed:
                        raise KeyboardInterrupt
        except KeyboardInterrupt:
            if not any(s.best is not None for s in self.states):
                raise  # nothing to keep
            self.interrupted = True

    def best(self) -> State:
        """The best law met in this phase: by violation, then cost."""
        return min(self.states, key=lambda s: s.rank)

    def progress(self) -> Progress:
        done = max(s.iterations for s in self.states)
        best = self.best()
        cost = np.nan if best.best_local is None else best.best_local.cost * self.unit
        total = done if self.done else self._most()
        return Progress((self.at, self.phase.title), done, total, cost, best.rank[0])

    def _most(self) -> int:
        """Iterations of this phase; the screen, which only ranks, has half of them."""
        return self.allowed if self.phase.stage == FULL else -(-self.spec.iterations // 2)

    def _turn(self) -> None:
        """The next piece of work: opening a phase, or an iteration of it."""
        running = [s.status == RUNNING for s in self.states]
        if not self.states:
            points = space.starting_points(self.study.law, self.spec)
            self._open([State(z) for z in points])
            self._record([True] * len(points))
        elif any(running):
            full = self.phase.stage == FULL
            tolerance = self.spec.tolerance if full else max(_COARSE, self.spec.tolerance)
            self.states = self.solver.advance(
                self.states, lambda points, _: self.see(points), tolerance, self._most()
            )
            self._record(running)
        elif not self.final:
            self._next_phase()
            self._record([True] * len(self.states))
        elif not self._widen():
            self.done = True

    def _next_phase(self) -> None:
        """All go on from their ends, or, to see all drives, the best of them."""
        before = self.phase
        self.at += 1
        ends = [s for s in sorted(self.states, key=lambda s: s.rank) if s.best is not None]
        given = State(space.starting_points(self.study.law, self.spec)[0])
        if before.stage != self.phase.stage:
            self._open_full(ends, given)
        else:
            # What was best on another model may be worse here than the law that was given.
            other = [given] if before.deadzone != self.phase.deadzone else []
            self._open([*map(self.solver.again, ends), *other])

    def _open(self, states: list[State]) -> None:
        """Begin a phase. Drives that fail under every one of its laws are left out, and named."""
        self.drives = self._wanted()
        points = np.array([s.z for s in states])
        outcome = self._evaluate(points)
        dead = np.asarray(outcome.status.any(axis=-1).all(axis=0))
        for k in np.flatnonzero(dead):
            index, first = int(self.drives[k]), int(np.argmax(outcome.status[0, k] != 0))
            self.excluded[index] = self.problem.trouble(index, int(outcome.status[0, k, first]))
        if dead.all():
            why = "; ".join(f"{self.problem.label(i)}: {w}" for i, w in self.excluded.items())
            raise InputError(
                "tune", "needs a drive that runs under one start", why, "other bounds or drives"
            )
        self.drives = self.drives[~dead]
        locals_ = self._locals(_part(outcome, ~dead))
        if not self.history:
            self.unit = _unit(locals_)
            locals_ = self._locals(_part(outcome, ~dead))
        self.states = [self.solver.begin(s, x) for s, x in zip(states, locals_, strict=True)]
        if all(s.status == FAILED for s in self.states):
            why = self.states[0].reason
            raise InputError("tune", "needs a start that can be evaluated", why, "other bounds")

    def _wanted(self) -> np.ndarray:
        """Indices of the drives of this phase."""
        known = np.array([i for i in range(self.spec.count) if i not in self.excluded])
        if self.phase.stage == FULL:
            return known[(known < self.spec.working) | np.isin(known, self.drives)]
        return known[space.spanning(self.problem.drives[known], self.spec.screen)]

    def _open_full(self, ends: list[State], given: State) -> None:
        """The ends of the screen on all drives; the best of them go on."""
        apart: list[State] = []
        for s in ends:
            if all(np.abs(s.best - other.best).max() > _SAME for other in apart):  # type: ignore[operator]
                apart.append(s)
        self._open([*map(self.solver.again, apart[: 2 * self.spec.finalists]), given])
        ranked = sorted(self.states, key=lambda s: s.rank)
        self.states = [s for s in ranked if s.status != FAILED][: self.spec.finalists]

    def _widen(self) -> bool:
        """Take drives up on which the best law breaks a limit; whether there are any.

        Values alone cost a twentieth of values with Jacobians: so all drives can be looked at
        between two searches on a few.
        """
        best = self.best()
        known = np.array([i for i in range(self.spec.count) if i not in self.excluded])
        rest = np.setdiff1d(known, self.drives)
        if not len(rest) or best.status == FAILED:
            return False
        assert best.best is not None
        assert best.best_local is not None
        worse = working.worse(
            self.problem, self.spec.objective, best.best[None], [best.best_local], rest
        )
        if not len(worse):
            return False
        self.drives = np.concatenate([self.drives, worse])
        self.allowed = best.iterations + self.spec.iterations
        self._open([dataclasses.replace(self.solver.again(best), iterations=best.iterations)])
        self._record([True])
        return True

    def look(self, points: np.ndarray) -> list[Local | str]:
        """The objective at each point (n, P) of the unit cube, with slopes, on the drives."""
        return self._locals(self._model.evaluate(points, self.drives))

    def see(self, points: np.ndarray) -> list[Local | str]:
        """The same, with slopes only where the solver needs them."""
        return self._locals(self._evaluate(points))

    def _evaluate(self, points: np.ndarray) -> Outcome:
        return self._model.evaluate(points, self.drives, slopes=self.solver.slopes)

    def _locals(self, outcome: Outcome) -> list[Local | str]:
        """The objective at each point, or why it has none there."""
        found: list[Local | str] = []
        for values, slopes, status in zip(*outcome, strict=True):
            trouble = self._trouble(values, slopes, status)
            if trouble:
                found.append(trouble)
                continue
            sample = self.drives < self.spec.working if self.phase.stage == FULL else None
            local = localise(self.spec.objective, self.problem.metrics, values, slopes, sample)
            goals = tuple(g._replace(factor=g.factor / self.unit) for g in local.goals)
            found.append(local._replace(goals=goals))
        return found

    def _trouble(self, values: np.ndarray, slopes: np.ndarray, status: np.ndarray) -> str:
        problem = self.problem
        for k, c in np.argwhere(status):
            index = int(self.drives[k])
            return f"{problem.label(index, c)}: {problem.trouble(index, int(status[k, c]))}"
        axes = values.shape[1] // len(problem.scenarios)
        for k, case, m in np.argwhere(~np.isfinite(values) | ~np.isfinite(slopes).all(axis=-1)):
            label = problem.label(int(self.drives[k]), case // axes)
            return f"{label}: {problem.metrics[m]} or its slope is not finite"
        return ""

    def _record(self, moved: list[bool]) -> None:
        for k, s in enumerate(self.states):
            if s.local is None or not moved[k]:
                continue
            gains = space.to_gains(self.spec.free, s.z).tolist()
            self.history.append(
                {
                    "stage": self.phase.title,
                    "iteration": s.iterations,
                    "start": k,
                    "status": s.status,
                    "cost": s.local.cost * self.unit,
                    "violation": s.local.violation,
                    "radius": s.radius,
                    **dict(zip(excess_columns(self.spec.objective), s.local.excess, strict=True)),
                    **dict(zip((f.name for f in self.spec.free), gains, strict=True)),
                }
            )


def excess_columns(objective: Objective) -> list[str]:
    """Names of the columns of a history: by what share each limit, less its reserve, is broken."""
    return [f"excess of {limit.words}" for limit in objective.limits]


def _part(outcome: Outcome, drives: np.ndarray) -> Outcome:
    return Outcome(*(a[:, drives] for a in outcome))


def _unit(locals_: list[Local | str]) -> float:
    """The smallest size of the cost among the starts: the penalty is measured against it."""
    costs = [abs(x.cost) for x in locals_ if not isinstance(x, str) and x.cost != 0.0]
    return min(costs, default=1.0)


def resume(session: Session) -> None:
    """Take a session up where its file left it; spent starts get their iterations anew.

    Raises: InputError where there is no such file, or it belongs to another problem.
    """
    states = checkpoint.read(session)
    kept = [s for s in states if s.best is not None]
    if not kept:
        return
    here = session.see(np.array([s.z for s in kept]))
    best = session.see(np.array([s.best for s in kept]))
    revived = []
    for s, now, top in zip(kept, here, best, strict=True):
        if isinstance(now, str) or isinstance(top, str):
            continue
        again = dataclasses.replace(s, local=now, best_local=top)
        if s.status == SPENT:
            again = dataclasses.replace(again, status=RUNNING, iterations=0, reason="")
        revived.append(again)
    session.states = revived
