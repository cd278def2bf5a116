"""The step response: extremes, overshoot, rise and settling."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.hermite import Cubic
from jaxsim.metric import Metric, Scalar, Task

_BAND = 0.02  # settling band, share of the step
_LEVELS = (0.1, 0.5, 0.9)


class Response(Metric):
    """theta_L against a reference that steps from `initial` to `target`, in either direction.

    theta_max_rad, theta_min_rad: extremes of theta_L;
    overshoot_rad, overshoot_pct: largest excursion beyond the target, 0 if it is never passed;
    rise_10_90_s, t50_s: first passage of 10 to 90 %, and of 50 % (absolute time), inf if never;
    settle_2pct_s: from the step to the last entry into the 2 % band, inf if not inside at the end;
    final_error_rad: target minus theta_L at the end.

    Overshoot, rise and settling look at what comes after the step, and are nan without one.
    """

    values: ClassVar[tuple[str, ...]] = (
        "theta_max_rad",
        "theta_min_rad",
        "overshoot_rad",
        "overshoot_pct",
        "rise_10_90_s",
        "t50_s",
        "settle_2pct_s",
        "final_error_rad",
    )
    never: ClassVar[Mapping[str, tuple[float, str]]] = {
        "rise_10_90_s": (math.inf, "90 % is never reached"),
        "t50_s": (math.inf, "50 % is never reached"),
        "settle_2pct_s": (math.inf, "not within 2 % at the end"),
    }

    def start(self) -> Any:
        never = jnp.zeros_like(self.task.target) + jnp.inf
        zero = jnp.zeros_like(never)
        return -never, never, zero, (never,) * len(_LEVELS), zero + self.task.onset, zero

    def update(self, fold: Any, piece: Piece) -> Any:
        top, bottom, beyond, passages, settled, _ = fold
        theta, segment = piece.cubic("theta_L"), piece.segment("theta_L")
        excess = hermite.raised(beyond, segment, self.task.direction, self.task.target)
        bottom, top = hermite.widened(bottom, top, segment)
        passages = tuple(
            jnp.minimum(old, self._passage(theta, piece, level))
            for old, level in zip(passages, _LEVELS, strict=True)
        )
        return (
            top,
            bottom,
            jnp.where(self.task.begun(piece), excess, beyond),
            passages,
            last_entry(theta, piece, self.task, settled),
            piece.after.theta_L,
        )

    def _passage(self, theta: Cubic, piece: Piece, level: float) -> Scalar:
        """The time at which theta_L passes a level of the step, inf if not in this piece."""
        task = self.task
        goal = task.initial + level * (task.target - task.initial)
        passes, s = hermite.crossing(theta.shifted(-goal).scaled(task.direction))
        return jnp.where(passes & task.begun(piece), piece.t + s * piece.h, jnp.inf)

    def finish(self, fold: Any) -> dict[str, Scalar]:
        top, bottom, beyond, passages, settled, last = fold
        task = self.task
        size = jnp.abs(task.target - task.initial)
        steps = size > 0.0
        overshoot = jnp.where(steps, beyond, jnp.nan)
        ten, fifty, ninety = passages
        rise = jnp.where(
            jnp.isfinite(ninety), jnp.where(jnp.isfinite(ninety), ninety, 0.0) - ten, jnp.inf
        )
        return {
            "theta_max_rad": top,
            "theta_min_rad": bottom,
            "overshoot_rad": overshoot,
            "overshoot_pct": 100.0 * overshoot / jnp.where(steps, size, 1.0),
            "rise_10_90_s": jnp.where(steps, rise, jnp.nan),
            "t50_s": jnp.where(steps, fifty, jnp.nan),
            "settle_2pct_s": jnp.where(steps, settled - task.onset, jnp.nan),
            "final_error_rad": task.target - last,
        }


def last_entry(signal: Cubic, piece: Piece, task: Task, settled: Scalar) -> Scalar:
    """The time of the last entry into the 2 % band about the target; inf while outside."""
    band = _BAND * jnp.abs(task.target - task.initial)
    error = signal.shifted(-task.target)
    above, below = error.shifted(-band), error.scaled(-1.0).shifted(-band)
    for outside in (above, below):
        # An entry is the outside distance falling through zero: its negative rises.
        enters, s = hermite.crossing(outside.scaled(-1.0))
        settled = jnp.where(enters & task.begun(piece), piece.t + s * piece.h, settled)
    after = jnp.abs(error.value(1.0)) > band
    return jnp.where(after & task.begun(piece), jnp.inf, settled)
