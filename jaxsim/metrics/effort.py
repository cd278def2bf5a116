"""The command to the motor."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.metric import Metric, Scalar


class Effort(Metric):
    """Of the command (Nm or V, as the motor takes):

    command_max, command_min, command_peak = max |u|; command_rms over the run;
    command_variation = sum |change| over the accepted pieces and at the jumps between them.
    """

    values: ClassVar[tuple[str, ...]] = (
        "command_max",
        "command_min",
        "command_peak",
        "command_rms",
        "command_variation",
    )

    def start(self) -> Any:
        zero = jnp.zeros_like(self.task.target)
        return zero - jnp.inf, zero + jnp.inf, zero, zero, zero

    def update(self, fold: Any, piece: Piece) -> Any:
        top, bottom, square, variation, last = fold
        u = piece.cubic("command")
        bottom, top = hermite.widened(bottom, top, piece.segment("command"))
        jump = jnp.abs(piece.before.command - last)
        return (
            top,
            bottom,
            square + piece.h * hermite.integral(lambda s: u.value(s) ** 2, 0.0, 1.0),
            variation + jump + jnp.abs(piece.after.command - piece.before.command),
            piece.after.command,
        )

    def finish(self, fold: Any) -> dict[str, Scalar]:
        top, bottom, square, variation, _ = fold
        positive = square > 0.0  # the root has no derivative at zero
        rms = jnp.sqrt(jnp.where(positive, square, 1.0) / self.task.duration)
        return {
            "command_max": top,
            "command_min": bottom,
            "command_peak": jnp.maximum(top, -bottom),
            "command_rms": jnp.where(positive, rms, 0.0),
            "command_variation": variation,
        }
