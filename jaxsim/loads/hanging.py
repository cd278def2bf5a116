"""A body on a horizontal axis."""

from __future__ import annotations

from typing import ClassVar

from jaxsim.drive import Load, Scalar
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter
from jaxsim.sincos import sincos


class Hanging(Load):
    """J_L omega_L' = T_s + d_L - D_L omega_L - g moment sin(theta_L); theta_L = 0 hangs down.

    moment = mass times distance of its centre from the axis: what a log shows, where a `Pendulum`
    is put together from known parts.
    """

    axes: ClassVar[int] = 1

    J_L: Scalar = parameter("kg m^2", "moment of inertia about the axis", rule=POSITIVE)
    moment: Scalar = parameter("kg m", "mass times distance of its centre")
    D_L: Scalar = parameter("Nm s/rad", "load-side viscosity", rule=NON_NEGATIVE, default=0.0)
    g: Scalar = parameter("m/s^2", "gravity", rule=NON_NEGATIVE, default=9.81)

    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        weight = self.g * self.moment * sincos(theta_L[0])[0]
        return ((torque[0] - self.D_L * omega_L[0] - weight) / self.J_L,)
