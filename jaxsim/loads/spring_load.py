"""An inertia on a linear spring: a load linearised at rest."""

from __future__ import annotations

from typing import ClassVar

from jaxsim.drive import Load, Scalar
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter


class SpringLoad(Load):
    """J_L omega_L' = T_s + d_L - D_L omega_L - K_L theta_L; 2014 paper (5) with one axis.

    J_L = M_L, D_L = B_L. K_L is linearised gravity; it may be zero or negative (section 3.4.1).
    """

    axes: ClassVar[int] = 1

    J_L: Scalar = parameter("kg m^2", "load-side moment of inertia", rule=POSITIVE)
    K_L: Scalar = parameter("Nm/rad", "stiffness of the load, any sign")
    D_L: Scalar = parameter("Nm s/rad", "load-side viscosity", rule=NON_NEGATIVE, default=0.0)

    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        rest = torque[0] - self.D_L * omega_L[0] - self.K_L * theta_L[0]
        return (rest / self.J_L,)
