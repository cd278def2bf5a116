"""What every solver of tuning is: a batch of starts that propose laws and learn what these do.

One iteration of all starts that run is one batch of runs. What a solver knows is in the states of
its starts, as plain data: so a search can be written to disk, taken up, and handed from one solver
to the next.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, final

import numpy as np

from jaxsim.catalog import Catalog
from tuning.local import Local
from tuning.subproblem import Step, best_step

SOLVERS = Catalog("solvers", "tuning.solvers", "tuning.solver:Solver")

# Points on the unit cube, and which state each is of -> the objective there, or words for why it
# cannot be evaluated.
Look = Callable[[np.ndarray, list[int]], list[Local | str]]

RUNNING, CONVERGED, STALLED, FAILED, SPENT = "running", "converged", "stalled", "failed", "spent"
# Where a search goes on from the end of another one.
_SECOND_RADIUS = 0.05
# Half the width of the cube around the best law in which its multipliers are read.
_NEAR = 1e-2
_FIRST_PENALTY = 10.0


@dataclasses.dataclass(frozen=True)
class State:
    """One start of a search.

    z (P,): where it is; radius: how far it looks around, 0 before it has begun; local: the
    objective at z (None where it could not be evaluated); best (P,), best_local: the best point
    met, by violation, then cost; memory: what its solver keeps besides.
    """

    z: np.ndarray
    radius: float = 0.0
    status: str = RUNNING
    iterations: int = 0
    local: Local | None = None
    best: np.ndarray | None = None
    best_local: Local | None = None
    reason: str = ""
    memory: Any = None

    @property
    def rank(self) -> tuple[float, float]:
        """Smaller is better: violation of the limits, then cost."""
        if self.best_local is None:
            return np.inf, np.inf
        return self.best_local.violation, self.best_local.cost

    def met(self, z: np.ndarray, local: Local) -> State:
        """With another point as the best one, if it is better."""
        there = dataclasses.replace(self, best=z, best_local=local)
        return there if there.rank < self.rank else self

    def ended(self, status: str, reason: str = "") -> State:
        return dataclasses.replace(self, status=status, reason=reason)


class Solver(abc.ABC):
    """A way to search. slopes: whether it needs them; first_radius: of a start."""

    slopes: ClassVar[bool]
    first_radius: ClassVar[float]

    @abc.abstractmethod
    def remember(self, s: State, local: Local) -> Any:
        """What it keeps of a start that begins."""

    @abc.abstractmethod
    def propose(self, s: State, tolerance: float, most: int) -> tuple[State, np.ndarray]:
        """The state and the points (n, P) it wants to see next; none where it has ended.

        tolerance: steps shorter than this, on the unit cube, end it. most: iterations.
        """

    @abc.abstractmethod
    def judge(self, s: State, points: np.ndarray, found: list[Local | str]) -> State:
        """The state after it has seen its points."""

    @abc.abstractmethod
    def dump(self, memory: Any) -> dict[str, Any]:
        """What it keeps, as plain data."""

    @abc.abstractmethod
    def restore(self, table: dict[str, Any]) -> Any:
        """The inverse of `dump`."""

    @final
    def begin(self, s: State, local: Local | str) -> State:
        """The state with the objective at its point; where there is none, it fails."""
        if isinstance(local, str):
            return s.ended(FAILED, local)
        s = dataclasses.replace(s, local=local, radius=s.radius or self.first_radius)
        return dataclasses.replace(s, memory=self.remember(s, local)).met(s.z, local)

    @final
    def advance(
        self, states: Sequence[State], look: Look, tolerance: float, most: int
    ) -> list[State]:
        """One iteration of all states that run, their points in one call of `look`."""
        moved = list(states)
        asked: dict[int, np.ndarray] = {}
        for i, s in enumerate(states):
            if s.status == RUNNING:
                moved[i], points = self.propose(s, tolerance, most)
                if moved[i].status == RUNNING:
                    asked[i] = points
        if asked:
            which = [i for i, points in asked.items() for _ in points]
            found = look(np.concatenate(list(asked.values())), which)
            for i, points in asked.items():
                own = [x for x, k in zip(found, which, strict=True) if k == i]
                moved[i] = self.judge(moved[i], points, own)
        return moved

    def again(self, s: State) -> State:
        """A state to go on from the best point of another one."""
        assert s.best is not None
        return State(s.best, _SECOND_RADIUS)

    def multipliers(self, s: State, local: Local) -> Step | None:
        """The step that would be taken at the best law, for its multipliers.

        local: the objective there, with slopes. None where no step can be found.
        """
        return near_step(s, local, first_hessian(local, self.first_radius), _FIRST_PENALTY)


def near_step(s: State, local: Local, hessian: np.ndarray, penalty: float) -> Step | None:
    """The best step in a small cube around the best law of a state."""
    assert s.best is not None
    lower, upper = np.maximum(-_NEAR, -s.best), np.minimum(_NEAR, 1.0 - s.best)
    return best_step(local, hessian, penalty, lower, upper)


def first_hessian(local: Local, length: float) -> np.ndarray:
    """Such that a step down the gradient is so long."""
    slope = sum(g.factor * g.slopes[int(np.argmax(g.values))] for g in local.goals)
    size = float(np.abs(np.asarray(slope)).max())
    return np.eye(np.size(slope)) * max(size / length, 1e-6)
