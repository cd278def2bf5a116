"""The joint torque along a step of the reference and against it."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.metric import Metric, Scalar


class StepTorque(Metric):
    """Peaks of T_s in the direction of the step, the same for steps in either direction.

    driving_torque_max_Nm: largest T_s towards the target, 0 if there is none;
    braking_torque_max_Nm: largest T_s away from it, as a positive number, 0 if there is none.
    A reference that does not step counts as one that steps up; nan for laws whose reference is
    no angle. Peaks are those of the cubic Hermite of each step, and include T_s just after contact.
    """

    values: ClassVar[tuple[str, ...]] = ("driving_torque_max_Nm", "braking_torque_max_Nm")

    def start(self) -> Any:
        zero = jnp.zeros_like(self.task.target)
        return zero, zero

    def update(self, fold: Any, piece: Piece) -> Any:
        direction = self.task.direction
        way = jnp.where(direction == 0.0, 1.0, direction)
        torque = piece.segment("T_s")
        return (
            hermite.raised(fold[0], torque, way, 0.0),
            hermite.raised(fold[1], torque, -way, 0.0),
        )

    def finish(self, fold: Any) -> dict[str, Scalar]:
        return {"driving_torque_max_Nm": fold[0], "braking_torque_max_Nm": fold[1]}
