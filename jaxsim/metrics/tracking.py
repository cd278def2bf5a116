"""Integrals of the control error."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.metric import Metric, Scalar
from jaxsim.rarely import rarely


class Tracking(Metric):
    """With e = target - theta_L from the onset of the reference to the end of the run:

    iae_rad_s = int |e| dt;  itae_rad_s2 = int (t - onset)|e| dt;
    error_rms_rad = sqrt(int e^2 dt/(duration - onset)); nan if the onset is after the end.

    The target is the FINAL reference, not the filtered one. The sign changes of e are located,
    or gradients would be off by percents.
    """

    values: ClassVar[tuple[str, ...]] = ("iae_rad_s", "itae_rad_s2", "error_rms_rad")

    def start(self) -> Any:
        zero = jnp.zeros_like(self.task.target)
        return zero, zero, zero

    def update(self, fold: Any, piece: Piece) -> Any:
        iae, itae, square = fold
        error = piece.cubic("theta_L").shifted(-self.task.target).scaled(-1.0)
        area, moment = _absolute(piece.segment("theta_L"), self.task.target)
        since = piece.t - self.task.onset
        counts = self.task.begun(piece)
        return (
            iae + jnp.where(counts, piece.h * area, 0.0),
            itae + jnp.where(counts, piece.h * (since * area + piece.h * moment), 0.0),
            square
            + jnp.where(
                counts, piece.h * hermite.integral(lambda s: error.value(s) ** 2, 0.0, 1.0), 0.0
            ),
        )

    def finish(self, fold: Any) -> dict[str, Scalar]:
        iae, itae, square = fold
        span = self.task.duration - self.task.onset
        moved = square != 0.0  # the root has no derivative at zero; nan stays nan
        rms = jnp.sqrt(jnp.where(moved, square, 1.0) / jnp.where(span > 0.0, span, 1.0))
        return {
            "iae_rad_s": iae,
            "itae_rad_s2": itae,
            "error_rms_rad": jnp.where(span > 0.0, jnp.where(moved, rms, 0.0), jnp.nan),
        }


def _absolute(s: hermite.Segment, target: Scalar) -> tuple[Scalar, Scalar]:
    """The integrals of |e| and s|e| over a piece, s from 0 to 1; e changes its sign once at most.

    Without a change they are the sizes of those of e. The rest is for pieces that have one.
    """
    error = s.cubic().shifted(-target)
    whole = error.area(1.0), error.moment(1.0)

    def divided(s: hermite.Segment) -> tuple[Scalar, Scalar]:
        error = s.cubic().shifted(-target)
        side = jnp.where(error.c0 < 0.0, -1.0, 1.0)
        crosses, cut = hermite.crossing(error.scaled(-side))
        # |e| is side*e up to the cut and -side*e from there on.
        halves = (error.area(cut), error.area(1.0)), (error.moment(cut), error.moment(1.0))
        area, moment = (
            jnp.where(crosses, side * (2.0 * first - both) - jnp.abs(both), 0.0)
            for first, both in halves
        )
        return area, moment

    def alike(s: hermite.Segment) -> tuple[Scalar, Scalar]:
        zero = jnp.zeros_like(s.start)
        return zero, zero

    more = rarely(error.c0 * (s.end - target), divided, alike, s)
    return jnp.abs(whole[0]) + more[0], jnp.abs(whole[1]) + more[1]
