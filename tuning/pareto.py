"""The front between two goals: all its points as one batch, each with a limit of its own.

Two searches find the ends, the laws that are best for one goal alone; between them the first goal
is minimised under limits on the second (epsilon constraints), which reaches concave parts of a
front, too, where weighted sums jump. Every law looked at on the way is kept: each point of the
front starts from the best one known for its limit, so a law that one search meets serves all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim.errors import InputError
from jaxsim.objective import Goal, Limit, Objective, check_name
from jaxsim.study import Study
from tuning import front_checkpoint, space, working
from tuning.local import RESERVE, Local, localise
from tuning.problem import Problem
from tuning.session import noted_interrupts
from tuning.solver import RUNNING, State
from tuning.solvers.sqp import Sqp
from tuning.spec import Spec

_SOLVER = Sqp()
SCREEN, FULL = "screen", "full"
# Searches that are not made again when drives have joined: their laws are known by then.
_AGAIN = ("points", "points in the gaps")
# Of a front, unless told otherwise.
POINTS = 12
# At an end, the other goal counts by this share: a flat valley ends where that is best as well.
_OTHER = 1e-3
# A goal that spans more than this along the front is spaced in its square root: evenly spaced
# values crowd at one end of it, logarithms at the other where a goal goes to 0.
WIDE = 10.0
# Ends closer than this in both goals, relative, are one law.
_SAME = 1e-6


class Seen(NamedTuple):
    """A law that was looked at: place on the unit cube, both goals, violation of the limits."""

    z: np.ndarray
    first: float
    second: float
    violation: float


class Progress(NamedTuple):
    """The searches that run now, their iteration, and how many laws are on the front so far."""

    what: str
    iteration: int
    most: int
    found: int


def pair_of(
    objective: Objective, names: tuple[str, str], options: tuple[str, str] = ("--between", "--and")
) -> tuple[Goal, Goal]:
    """Two metrics as goals, over drives and scenarios as the objective has them, else the mean.

    options: under which they were given.

    Raises: InputError for an unknown metric, with the nearest, and for one named twice.
    """
    for name, option in zip(names, options, strict=True):
        check_name(name, option)
    if names[0] == names[1]:
        raise InputError(options[1], "must be another metric", names[1], "name two goals")
    over = {x.metric: x.over for x in (*objective.limits, *objective.goals)}
    first, second = (Goal(name, 1.0, over.get(name, "mean")) for name in names)
    return first, second


class Tracer:
    """Searches for the front of a problem; the problem's objective must name both metrics.

    limits: of the study; they hold at every point. every: indices of the drives that run.
    drives: of those looked at now; with a working set those join on which laws of the front are
    worse than on the others. seen: the laws looked at on them. left_out: index -> why, of
    drives that fail under every start. stage, done: where it stands, and its searches that are
    finished. file: where its state is kept after every iteration.
    """

    def __init__(
        self,
        problem: Problem,
        pair: tuple[Goal, Goal],
        tell: Callable[[Progress], None],
        file: Path | None = None,
    ) -> None:
        self.problem, self.pair, self.tell, self.file = problem, pair, tell, file
        self.limits = problem.spec.objective.limits
        self.every = self.drives = np.arange(problem.spec.count)
        self.starts = np.zeros((0, len(problem.spec.free)))
        self.seen: list[Seen] = []
        self.bounds: list[float] = []
        self.left_out: dict[int, str] = {}
        self.stage, self.done = "", []
        self.interrupted, self._points = False, POINTS
        self._before: list[Seen] = []
        self._pressed: list[int] = []

    def _leave_out(self, starts: np.ndarray) -> None:
        """Leave out the drives that fail under every one of the starts.

        Raises: InputError where no drive is left.
        """
        problem = self.problem
        status = problem.evaluate(starts, self.drives, slopes=False).status
        dead = np.asarray(status.any(axis=-1).all(axis=0))
        self.left_out = {
            int(i): problem.trouble(int(i), int(status[0, k].max()))
            for k, i in enumerate(self.drives)
            if dead[k]
        }
        if dead.all():
            told = "; ".join(f"{problem.label(i)}: {w}" for i, w in self.left_out.items())
            raise InputError(
                "tune", "needs a drive that runs under one start", told, "other bounds or drives"
            )
        self.every = self.drives = self.drives[~dead]

    def trace(self, starts: np.ndarray, points: int) -> list[np.ndarray]:
        """Laws on the unit cube for a front of so many points; at Ctrl-C those known by then.

        starts (n, P): all are tried on the few drives of the screen, then come all drives, or those
        of the working set and what joins them. What a checkpoint says is done is not done again.
        """
        spec, self._points = self.problem.spec, points
        try:
            with noted_interrupts() as self._pressed:
                if not self.stage:
                    self._leave_out(starts)
                    self.stage = SCREEN if spec.screen < spec.count else FULL
                    self.starts, self.drives = starts, self._wanted()
                if self.stage == SCREEN:
                    self._stage(points, spec.iterations // 2)
                    self.stage = FULL
                    again = [*self._chosen(2 * points), *self.starts[:2]]
                    self._restart(again, self._wanted(), [])
                self._stage(points, spec.iterations)
                while self._widen(points):
                    self._stage(points, spec.iterations)
        except KeyboardInterrupt:
            self.interrupted = True
            self.seen = self.seen or self._before
            if not self.seen:
                raise
        return self._chosen(points)

    def _wanted(self) -> np.ndarray:
        """Indices of the drives that a stage begins with."""
        spec = self.problem.spec
        if self.stage == FULL:
            return self.every[self.every < spec.working]
        return self.every[space.spanning(self.problem.drives[self.every], spec.screen)]

    def _restart(self, starts: list[np.ndarray], drives: np.ndarray, done: list[str]) -> None:
        """Go on from some laws on other drives; what was seen on those before is not comparable."""
        self.starts, self.drives, self.done = np.array(starts), drives, done
        self.seen, self._before = [], self.seen

    def _widen(self, points: int) -> bool:
        """Take drives up on which laws of the front are worse; whether there are any."""
        rest = np.setdiff1d(self.every, self.drives)
        if not len(rest):
            return False
        laws, problem = np.array(self._chosen(points)), self.problem
        objective = Objective(self.pair, self.limits)
        values = problem.evaluate(laws, self.drives, slopes=False)
        known = [
            localise(objective, problem.metrics, v, s, self._sample)
            for v, s in zip(values.values, values.slopes, strict=True)
        ]
        worse = working.worse(problem, objective, laws, known, rest)
        if not len(worse):
            return False
        starts = [*laws, *(s.z for s in self._spaced(2 * points))]
        self._restart(starts, np.concatenate([self.drives, worse]), list(_AGAIN))
        self._keep()
        return True

    @property
    def _sample(self) -> np.ndarray | None:
        """Of the drives looked at those that stand for all in a mean; None: all of them."""
        return self.drives < self.problem.spec.working if self.stage == FULL else None

    def _stage(self, points: int, most: int) -> None:
        """Ends; half of the points evenly, the others in the widest gaps; all once more."""
        starts = self.starts
        if not self.seen:
            self._look([self._alone(0)] * len(starts), np.ones(len(starts)), starts)
        if not self.seen:
            why = "a run fails under each of them"
            raise InputError("tune", "needs a start that can be evaluated", why, "other bounds")
        if "ends" not in self.done:
            ends = [(self._alone(k), z) for k in (0, 1) for z in self._best_alone(k, starts)]
            self._solve("ends", *zip(*ends, strict=True), most=most)
        inner = max(points - 2, 1)
        for what, bounds in (
            ("points", partial(self._even, -(-inner // 2))),
            ("points in the gaps", partial(self._gaps, inner // 2)),
            # Laws that other searches have met may be better starts by now.
            ("all points again", partial(self._again, points)),
        ):
            if what in self.done:
                continue
            self.bounds = bounds()
            if self.bounds:
                objectives = [self._under(b) for b in self.bounds]
                starts_ = [self._start(b) for b in self.bounds]
                self._solve(what, objectives, starts_, most=most)

    def _again(self, points: int) -> list[float]:
        """Limits on the second goal that the spaced points of the front just keep."""
        return [s.second + 2.0 * RESERVE * abs(s.second) for s in self._spaced(points)[1:-1]]

    def _chosen(self, count: int) -> list[np.ndarray]:
        """The ends, and the best law for each of the last limits; where there are none, spaced."""
        if not self.bounds or self.interrupted:
            return [s.z for s in self._spaced(count)]
        front = self._non_dominated()
        return [front[0].z, *(self._start(b) for b in self.bounds), front[-1].z]

    def _best_alone(self, goal: int, starts: np.ndarray) -> list[np.ndarray]:
        """Half of the starts, best first by violation and goal: the others would be far off."""
        ranked = sorted(self.seen, key=lambda s: (s.violation, s[1 + goal]))
        return [s.z for s in ranked[: max(2, len(starts) // 2)]]

    def _alone(self, goal: int) -> Objective:
        """One goal, and the other one by a small share, in units of the laws seen."""
        sizes = [self._size(k) for k in (0, 1)]
        own, other = self.pair[goal], self.pair[1 - goal]
        weight = _OTHER * sizes[goal] / sizes[1 - goal]
        return Objective((own, other._replace(weight=weight)), self.limits)

    def _size(self, goal: int) -> float:
        values = [abs(s[1 + goal]) for s in self.seen]
        return float(min((v for v in values if v > 0.0), default=1.0))

    def _under(self, most: float) -> Objective:
        """The first goal, with a limit on the second."""
        second = self.pair[1]
        return Objective(self.pair[:1], (*self.limits, Limit(second.metric, most, second.over)))

    def _kept(self) -> list[Seen]:
        """The laws that keep the study's limits, or those nearest to that if none does."""
        least = min(s.violation for s in self.seen)
        return [s for s in self.seen if s.violation <= least]

    def _start(self, most: float) -> np.ndarray:
        """The best law seen for a limit on the second goal."""
        kept = self._kept()
        inside = [s for s in kept if s.second <= most]
        if inside:
            return min(inside, key=lambda s: s.first).z
        return min(kept, key=lambda s: s.second).z

    def _non_dominated(self) -> list[Seen]:
        """Ordered by the second goal."""
        front: list[Seen] = []
        for s in sorted(self._kept(), key=lambda s: (s.second, s.first)):
            if not front or s.first < front[-1].first:
                front.append(s)
        return front

    def _even(self, count: int) -> list[float]:
        """Limits on the second goal that cut its span evenly."""
        front = self._non_dominated()
        low, high = front[0].second, front[-1].second
        if high - low <= _SAME * abs(high):
            return []
        return list(_scale(low, high, np.linspace(0.0, 1.0, count + 2)[1:-1]))

    def _gaps(self, count: int) -> list[float]:
        """Limits in the middle of the widest gaps between neighbours of the front."""
        front = self._non_dominated()
        places = _places(np.array([[s.first, s.second] for s in front]))
        bounds: list[float] = []
        pieces = [
            (float(np.linalg.norm(b - a)), s.second, t.second)
            for a, b, s, t in zip(places, places[1:], front, front[1:], strict=False)
        ]
        while len(bounds) < count and pieces:
            pieces.sort()
            width, low, high = pieces.pop()
            middle = float(_scale(low, high, 0.5))
            bounds.append(middle)
            pieces += [(0.5 * width, low, middle), (0.5 * width, middle, high)]
        return bounds

    def _spaced(self, count: int) -> list[Seen]:
        """At most so many laws of the front, ends and then always the farthest from those."""
        front = self._non_dominated()
        places = _places(np.array([[s.first, s.second] for s in front]))
        return [front[k] for k in sorted(space.spanning(places, count))]

    def _solve(
        self, what: str, objectives: Sequence[Objective], starts: Sequence[np.ndarray], *, most: int
    ) -> None:
        """Search for all objectives at once, each from its start; what is met stays in `seen`."""
        first = self._look(objectives, np.ones(len(starts)), np.array(starts))
        units = np.array([1.0 if isinstance(x, str) else abs(x.cost) or 1.0 for x in first])
        states = [
            _SOLVER.begin(State(z), x if isinstance(x, str) else _scaled(x, unit))
            for z, x, unit in zip(starts, first, units, strict=True)
        ]

        def look(points: np.ndarray, which: list[int]) -> list[Local | str]:
            return self._look([objectives[i] for i in which], units[which], points)

        tolerance = self.problem.spec.tolerance
        for iteration in range(most + 1):
            if all(s.status != RUNNING for s in states):
                break
            states = _SOLVER.advance(states, look, tolerance, most)
            self._keep()
            self.tell(Progress(what, iteration + 1, most, len(self._non_dominated())))
            if self._pressed:
                raise KeyboardInterrupt

        self.done.append(what)
        self._keep()

    def _keep(self) -> None:
        if self.file is not None:
            front_checkpoint.write(self, self._points, self.file)

    def _look(
        self, objectives: Sequence[Objective], units: np.ndarray, points: np.ndarray
    ) -> list[Local | str]:
        """Each point under its objective; all that complete are remembered."""
        outcome = self.problem.evaluate(points, self.drives)
        found: list[Local | str] = []
        names = self.problem.metrics
        for z, objective, unit, values, slopes, status in zip(
            points, objectives, units, *outcome, strict=True
        ):
            if status.any() or not (np.isfinite(values).all() and np.isfinite(slopes).all()):
                found.append("a run fails, or a metric or its slope is not finite")
                continue
            sample = self._sample
            both = localise(Objective(self.pair, self.limits), names, values, slopes, sample)
            first, second = (float(g.values.max()) for g in both.goals)
            self.seen.append(Seen(z, first, second, both.violation))
            found.append(_scaled(localise(objective, names, values, slopes, sample), unit))
        return found


def _scaled(local: Local, unit: float) -> Local:
    """Goals in units of the search: the penalty is measured against them."""
    return local._replace(goals=tuple(g._replace(factor=g.factor / unit) for g in local.goals))


def _scale(low: float, high: float, share: Any) -> Any:
    """Between two values, in the square root where they span much."""
    if low >= 0.0 and high > WIDE * low:
        return (np.sqrt(low) + share * (np.sqrt(high) - np.sqrt(low))) ** 2
    return low + share * (high - low)


def _places(values: np.ndarray) -> np.ndarray:
    """Pairs of goals (n, 2) on the unit square, in the square root where they span much."""
    low, high = values.min(axis=0), values.max(axis=0)
    wide = (low >= 0.0) & (high > WIDE * low)
    values = np.where(wide, np.sqrt(np.maximum(values, 0.0)), values)
    low, high = values.min(axis=0), values.max(axis=0)
    return (values - low) / np.where(high > low, high - low, 1.0)


def tracer_of(
    study: Study,
    spec: Spec,
    pair: tuple[Goal, Goal],
    tell: Callable[[Progress], None],
    file: Path | None = None,
) -> Tracer:
    """A tracer that computes both goals and what the study's own limits need."""
    both = spec._replace(objective=Objective(pair, spec.objective.limits))
    return Tracer(Problem(study, both), pair, tell, file)
