"""A plain inertia."""

from __future__ import annotations

from typing import ClassVar

from jaxsim.drive import Load, Scalar
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter


class Inertia(Load):
    """J_L omega_L' = T_s + d_L - D_L omega_L; 2018 paper (2)."""

    axes: ClassVar[int] = 1

    J_L: Scalar = parameter("kg m^2", "load-side moment of inertia", rule=POSITIVE)
    D_L: Scalar = parameter("Nm s/rad", "load-side viscosity", rule=NON_NEGATIVE, default=0.0)

    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        return ((1.0 / self.J_L) * (torque[0] - self.D_L * omega_L[0]),)
