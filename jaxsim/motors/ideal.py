"""A torque-controlled motor."""

from __future__ import annotations

from typing import Any, ClassVar

from jaxsim.drive import Motor, Scalar, Shaft
from jaxsim.hybrid import Switch
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter


class Ideal(Motor):
    """A motor that makes the commanded torque at once: J_M omega_M' = T_M - D_M omega_M - T_s/N.

    Source: 2018 paper, (1).
    """

    command_unit: ClassVar[str] = "Nm"

    J_M: Scalar = parameter("kg m^2", "motor-side moment of inertia", rule=POSITIVE)
    D_M: Scalar = parameter("Nm s/rad", "motor-side viscosity", rule=NON_NEGATIVE, default=0.0)

    def rest(self) -> Any:
        return ()

    def torque(self, extra: Any, command: Scalar) -> Scalar:
        return command

    def field(
        self, shaft: Shaft, extra: Any, command: Scalar, switches: tuple[Switch, ...]
    ) -> tuple[Scalar, Any]:
        return (1.0 / self.J_M) * (command - self.D_M * shaft.omega_M - shaft.torque), ()
