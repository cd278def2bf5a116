"""Least squares by Levenberg and Marquardt, for many fits side by side.

All fits advance together, one simulation of the whole batch per iteration, residuals and forward
derivatives at once. The loop is the host's: it can be watched and interrupted, a fit that fails
keeps its last good point, and the others go on.

Source: Madsen, Nielsen, Tingleff, Methods for non-linear least squares problems (2004), 3.2, with
Marquardt's scaling.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from jaxsim.hybrid import Deadzone
from tuning.identification.residuals import Problem
from tuning.identification.robust import Loss, Squares


class Stage(NamedTuple):
    """One leg of a fit: the model of the contact, and the share of each log's duration that counts.

    The later a reading, the more impacts decide it, and the less is it a smooth function of the
    parameters: a fit that first looks at the beginning finds its way from farther off.
    """

    deadzone: Deadzone | None = None  # the exact one of the problem
    horizon: float = 1.0


# A growing horizon on the exact model. The bench's logs of 0.3 s, four parameters 30 to 50 % wrong:
# 96 of 96 fits arrive, against 62 when all of the log counts from the beginning, 71 with smoothed
# contact first, and 96 with both, which compiles two programs and takes half as many steps more.
STAGES = tuple(Stage(horizon=share) for share in (0.1, 0.2, 0.4, 1.0))
_DAMPING = 1e-3  # the first, as a share of the curvature
_MOST = 1e12  # damping beyond which no step is found any more
# A column whose curvature is below this share of the largest is damped as if it were there: a
# parameter that the log does not show must not take unbounded steps.
_FLOOR = 1e-12


class Progress(NamedTuple):
    """After one iteration: which stage, how many fits still move, the lowest loss so far."""

    stage: int
    stages: int
    iteration: int
    moving: int
    loss: float


class Fits(NamedTuple):
    """Where the fits ended; F of them.

    values: (F, P) in SI units. loss: (F,) half the sum of rho over all residuals, inf where no run
    completed. converged: (F,) whether the last stage ended by its tolerance. iterations: (F,).
    interrupted: whether Ctrl-C ended them all.
    """

    values: np.ndarray
    loss: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    interrupted: bool = False

    @property
    def best(self) -> int:
        return int(np.argmin(self.loss))


class Fit(Protocol):
    """`fit`, or what does the same elsewhere."""

    def __call__(
        self, problem: Problem, starts: np.ndarray, *, who: np.ndarray | None = None,
        stages: Sequence[Stage] = STAGES, loss: Loss | None = None, iterations: int = 50,
        tolerance: float = 1e-9, frozen: np.ndarray | None = None,
        tell: Callable[[Progress], None] | None = None,
    ) -> Fits: ...  # fmt: skip


class _Local(NamedTuple):
    """Loss, gradient (F, P) and Gauss-Newton matrix (F, P, P) at the points of all fits."""

    loss: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray


def fit(
    problem: Problem, starts: np.ndarray, *, who: np.ndarray | None = None,
    stages: Sequence[Stage] = STAGES, loss: Loss | None = None, iterations: int = 50,
    tolerance: float = 1e-9, frozen: np.ndarray | None = None,
    tell: Callable[[Progress], None] | None = None,
) -> Fits:  # fmt: skip
    """Fit from every row of `starts` (F, P), through all stages.

    who: which experiments each fit looks at, as in `Problem`. stages: the last one must be `Exact`
    and look at everything. loss: `Squares()` by default. iterations: at most, per stage.
    tolerance: a stage ends for a fit when the next step would gain less than this share of its
    loss. frozen: (F, P) unknowns that stay as they start.

    Ctrl-C returns what there is, with `interrupted` set.
    """
    loss = Squares() if loss is None else loss
    starts = np.atleast_2d(starts)
    who = problem.everyone(len(starts)) if who is None else who
    frozen = np.zeros(starts.shape, bool) if frozen is None else frozen
    search = _Search(problem, starts, who, loss, frozen)
    try:
        for index, stage in enumerate(stages):
            # What comes after it begins anew: an early stage only has to come near.
            last = index == len(stages) - 1
            search.begin(stage, tolerance if last else max(tolerance, 1e-4))
            for iteration in range(iterations):
                if tell:
                    moving = int(search.moving.sum())
                    low = float(search.local.loss.min())
                    tell(Progress(index, len(stages), iteration, moving, low))
                if not search.moving.any():
                    break
                search.iterate()
    except KeyboardInterrupt:
        return search.fits(interrupted=True)
    return search.fits()


class _Search:
    """The state of all fits between two iterations."""

    def __init__(
        self, problem: Problem, starts: np.ndarray, who: np.ndarray, loss: Loss, frozen: np.ndarray
    ) -> None:
        self.problem, self.who, self.loss, self.frozen = problem, who, loss, frozen
        self.y = problem.unknowns.to_point(starts)
        fits, size = self.y.shape
        self.iterations = np.zeros(fits, int)
        self.moving = np.zeros(fits, bool)
        self.local = _Local(
            np.full(fits, np.inf), np.zeros((fits, size)), np.zeros((fits, size, size))
        )

    def begin(self, stage: Stage, tolerance: float) -> None:
        """Go on from here with another model of the contact."""
        self.stage, self.tolerance = stage, tolerance
        self.damping = np.full(len(self.y), _DAMPING)
        self.growth = np.full(len(self.y), 2.0)
        self.local = self._look(self.y)
        self.moving = np.isfinite(self.local.loss)

    def fits(self, *, interrupted: bool = False) -> Fits:
        values = self.problem.unknowns.to_values(self.y)
        done = np.isfinite(self.local.loss) & ~self.moving
        return Fits(values, self.local.loss, done, self.iterations, interrupted)

    def _look(self, y: np.ndarray) -> _Local:
        unknowns = self.problem.unknowns
        seen = self.problem.evaluate(
            unknowns.to_values(y), unknowns.slope(y),
            who=self.who, deadzone=self.stage.deadzone, horizon=self.stage.horizon,
        )  # fmt: skip
        local = reduced(self.problem, seen.residuals, seen.jacobian, self.who, self.loss)
        moves = ~self.frozen
        both = moves[:, :, None] & moves[:, None, :]
        return local._replace(gradient=local.gradient * moves, matrix=local.matrix * both)

    def iterate(self) -> None:
        """One damped Gauss-Newton step of every fit that still moves."""
        step, gain = self._steps()
        self.iterations += self.moving
        # Nothing left to gain, or no step that gains: this stage is over for the fit.
        ended = gain <= self.tolerance * np.maximum(self.local.loss, 1e-300)
        self.moving &= ~ended & (self.damping < _MOST)
        if not self.moving.any():
            return
        there = self._look(np.where(self.moving[:, None], self.y + step, self.y))
        with np.errstate(invalid="ignore"):
            ratio = (self.local.loss - there.loss) / gain
        taken = self.moving & np.isfinite(there.loss) & (ratio > 0.0)
        self.y = np.where(taken[:, None], self.y + step, self.y)
        self.local = _Local(
            *(
                np.where(taken.reshape(-1, *[1] * (new.ndim - 1)), new, old)
                for new, old in zip(there, self.local, strict=True)
            )
        )
        shrink = np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.where(taken, ratio, 0.0) - 1.0) ** 3)
        damping = self.damping * np.where(taken, shrink, self.growth)
        self.damping = np.clip(damping, 1e-12, 2.0 * _MOST)
        self.growth = np.where(taken, 2.0, 2.0 * self.growth)

    def _steps(self) -> tuple[np.ndarray, np.ndarray]:
        """The damped steps (F, P) and what they gain by the linear model (F,)."""
        diagonal = np.einsum("fii->fi", self.local.matrix)
        scale = np.maximum(diagonal, _FLOOR * diagonal.max(axis=1, keepdims=True)) + 1e-300
        # Divided by its diagonal, so that units do not decide how well it can be solved.
        root = np.sqrt(scale)
        matrix = self.local.matrix / (root[:, :, None] * root[:, None, :])
        matrix = matrix + self.damping[:, None, None] * np.eye(root.shape[1])
        right = self.local.gradient / root
        scaled = -np.linalg.solve(matrix, right[..., None])[..., 0]
        gain = 0.5 * np.sum(scaled * (self.damping[:, None] * scaled - right), axis=1)
        return scaled / root, gain


def reduced(
    problem: Problem, residuals: np.ndarray, jacobian: np.ndarray, who: np.ndarray, loss: Loss
) -> _Local:
    """Loss, gradient and Gauss-Newton matrix over the columns of the unknowns, by weights."""
    fits, experiments = who.shape
    size, own = len(problem.unknowns.of), len(problem.unknowns.free)
    bad: np.ndarray = ~np.isfinite(residuals).all(axis=(1, 2, 3))  # pyright: ignore
    bad |= ~np.isfinite(jacobian).all(axis=(1, 2, 3, 4))
    r = np.where(bad[:, None, None, None], 0.0, residuals).reshape(fits, experiments, -1)
    J = np.where(bad[:, None, None, None, None], 0.0, jacobian)
    J = J.reshape(fits, experiments, -1, own)
    weight = loss.weight(r)[..., None]
    weighted = J * weight
    gradient, matrix = np.zeros((fits, size)), np.zeros((fits, size, size))
    small = np.einsum("feni,fen->fei", weighted, r), weighted.swapaxes(-1, -2) @ J
    columns = problem.unknowns.columns()[who]
    row = np.arange(fits)[:, None]
    for e in range(experiments):
        at = columns[:, e]
        np.add.at(gradient, (row, at), small[0][:, e])
        np.add.at(matrix, (row[:, :, None], at[:, :, None], at[:, None, :]), small[1][:, e])
    total = np.where(bad, np.inf, 0.5 * loss.value(r).sum(axis=(1, 2)))
    return _Local(total, gradient, matrix)


__all__ = ["STAGES", "Fit", "Fits", "Progress", "Stage", "fit", "reduced"]
