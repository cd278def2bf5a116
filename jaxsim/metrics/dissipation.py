"""Energy lost in impacts."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.metric import Metric, Scalar


class Dissipation(Metric):
    """impact_loss_J = int P_loss dt: what the damping of the transmission turns into heat.

    With the backlash model P_loss = D_B omega_B^2 in contact; 0 for a run without contact.
    """

    values: ClassVar[tuple[str, ...]] = ("impact_loss_J",)

    def start(self) -> Any:
        return (jnp.zeros_like(self.task.target),)

    def update(self, fold: Any, piece: Piece) -> Any:
        power = piece.cubic("P_loss")
        return (fold[0] + piece.h * hermite.integral(power.value, 0.0, 1.0),)

    def finish(self, fold: Any) -> dict[str, Scalar]:
        return {"impact_loss_J": fold[0]}
