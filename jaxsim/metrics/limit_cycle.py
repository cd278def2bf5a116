"""Sustained oscillation at the end of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.metric import Metric, Scalar

_WINDOW = 0.4  # share of the run, at its end, in which the oscillation is measured
# A speed below this has no sign, rad/s. Where omega_L is a switching surface its zero is landed on
# to rounding: the pieces on both sides may both show a rise through zero, or neither.
_STILL = 1e-9


class LimitCycle(Metric):
    """Over the last 40 % of the run:

    limit_cycle_rad: peak to peak of theta_L; limit_cycle_Nm: largest |T_s|;
    limit_cycle_Hz: from the first to the last minimum of theta_L (omega_L rising through zero),
    0 with fewer than two of them; limit_cycle_growth: peak to peak in the second half of the
    window over that in the first (1 for a cycle that lasts and for rest, < 1 for one that dies
    out, inf for one that begins in the second half).
    """

    values: ClassVar[tuple[str, ...]] = (
        "limit_cycle_rad",
        "limit_cycle_Nm",
        "limit_cycle_Hz",
        "limit_cycle_growth",
    )
    never: ClassVar[Mapping[str, tuple[float, str]]] = {"limit_cycle_Hz": (0.0, "no limit cycle")}

    def start(self) -> Any:
        zero = jnp.zeros_like(self.task.target)
        never = zero + jnp.inf
        return (-never, never), (-never, never), zero, zero, never, -never, zero

    def update(self, fold: Any, piece: Piece) -> Any:
        early, late, torque, count, first, last, sign = fold
        begin = (1.0 - _WINDOW) * self.task.duration
        middle = (1.0 - 0.5 * _WINDOW) * self.task.duration
        theta, omega = piece.segment("theta_L"), piece.cubic("omega_L")
        at = piece.t + 0.5 * piece.h
        inside = at >= begin
        low, high = hermite.widened(jnp.inf, -jnp.inf, theta)
        crosses, s = hermite.crossing(omega)
        when = piece.t + jnp.where(crosses, s, 0.0) * piece.h
        end = omega.value(1.0)
        now = jnp.where(jnp.abs(end) > _STILL, jnp.sign(end), sign)
        rises = (sign < 0.0) & (now > 0.0) & inside
        lowest, highest = hermite.widened(-torque, torque, piece.segment("T_s"))
        return (
            _widen(early, high, low, inside & (at < middle)),
            _widen(late, high, low, at >= middle),
            jnp.where(inside, jnp.maximum(highest, -lowest), torque),
            count + rises,
            jnp.where(rises, jnp.minimum(first, when), first),
            jnp.where(rises, when, last),
            now,
        )

    def finish(self, fold: Any) -> dict[str, Scalar]:
        early, late, torque, count, first, last, _ = fold
        whole = jnp.maximum(early[0], late[0]) - jnp.minimum(early[1], late[1])
        before, after = early[0] - early[1], late[0] - late[1]
        moves = before > 0.0
        many = count >= 2
        span = jnp.where(many, last, 1.0) - jnp.where(many, first, 0.0)
        return {
            "limit_cycle_rad": whole,
            "limit_cycle_Nm": torque,
            "limit_cycle_Hz": jnp.where(many, (count - 1.0) / span, 0.0),
            "limit_cycle_growth": jnp.where(
                moves, after / jnp.where(moves, before, 1.0), jnp.where(after > 0.0, jnp.inf, 1.0)
            ),
        }


def _widen(span: Any, high: Scalar, low: Scalar, counts: Scalar) -> Any:
    top, bottom = span
    return (
        jnp.where(counts, jnp.maximum(top, high), top),
        jnp.where(counts, jnp.minimum(bottom, low), bottom),
    )
