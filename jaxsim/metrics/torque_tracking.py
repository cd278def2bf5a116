"""How a torque law tracks its reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.metric import Metric, Scalar
from jaxsim.metrics.response import last_entry


class TorqueTracking(Metric):
    """Of T_s against the reference tau_r; the peak voltage is `command_peak`. With e = tau_r - T_s:

    torque_error_rms_Nm = sqrt(int e^2 dt/duration) and torque_error_max_Nm = max |e|, of the whole
    run, jumps of the reference included;
    torque_overshoot_pct: largest excursion beyond the target, % of the step, 0 if it is never
    passed; torque_settle_2pct_s: from the step to the last entry into the 2 % band, inf if not
    inside at the end (both nan where the reference does not step);
    nan, all of them, for laws whose reference is no torque.
    """

    values: ClassVar[tuple[str, ...]] = (
        "torque_error_rms_Nm",
        "torque_error_max_Nm",
        "torque_overshoot_pct",
        "torque_settle_2pct_s",
    )
    never: ClassVar[Mapping[str, tuple[float, str]]] = {
        "torque_settle_2pct_s": (math.inf, "not within 2 % at the end"),
    }
    reference_unit: ClassVar[str] = "Nm"

    def start(self) -> Any:
        zero = jnp.zeros_like(self.task.target)
        return zero, zero, zero, zero + self.task.onset

    def update(self, fold: Any, piece: Piece) -> Any:
        square, worst, beyond, settled = fold
        torque = piece.segment("T_s")
        off = piece.segment("reference").minus(torque)
        error = off.cubic()
        lowest, highest = hermite.widened(-worst, worst, off)
        return (
            square + piece.h * hermite.integral(lambda s: error.value(s) ** 2, 0.0, 1.0),
            jnp.maximum(highest, -lowest),
            hermite.raised(beyond, torque, self.task.direction, self.task.target),
            last_entry(torque.cubic(), piece, self.task, settled),
        )

    def finish(self, fold: Any) -> dict[str, Scalar]:
        square, worst, beyond, settled = fold
        task = self.task
        size = jnp.abs(task.target - task.initial)
        steps = size > 0.0
        positive = square > 0.0  # the root has no derivative at zero
        rms = jnp.sqrt(jnp.where(positive, square, 1.0) / task.duration)
        follows = jnp.isfinite(task.target)
        return {
            "torque_error_rms_Nm": jnp.where(follows, jnp.where(positive, rms, 0.0), jnp.nan),
            "torque_error_max_Nm": jnp.where(follows, worst, jnp.nan),
            "torque_overshoot_pct": jnp.where(
                steps, 100.0 * beyond / jnp.where(steps, size, 1.0), jnp.nan
            ),
            "torque_settle_2pct_s": jnp.where(steps, settled - task.onset, jnp.nan),
        }
