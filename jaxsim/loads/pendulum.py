"""A rod with a point mass at its end, hanging."""

from __future__ import annotations

from typing import ClassVar

from jaxsim.drive import Load, Scalar
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter
from jaxsim.sincos import sincos


class Pendulum(Load):
    """J omega_L' = T_s + d_L - D_L omega_L - g (mass + rod/2) length sin(theta_L - theta_0),

    J = (mass + rod/3) length^2; it hangs at theta_0.
    """

    axes: ClassVar[int] = 1

    mass: Scalar = parameter("kg", "point mass at the end", rule=POSITIVE)
    length: Scalar = parameter("m", "length of the rod", rule=POSITIVE)
    rod: Scalar = parameter("kg", "mass of the uniform rod", rule=NON_NEGATIVE, default=0.0)
    D_L: Scalar = parameter("Nm s/rad", "load-side viscosity", rule=NON_NEGATIVE, default=0.0)
    g: Scalar = parameter("m/s^2", "gravity", rule=NON_NEGATIVE, default=9.81)
    theta_0: Scalar = parameter("rad", "load angle at which it hangs", default=0.0)

    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        inertia = (self.mass + self.rod / 3.0) * self.length**2
        weight = self.g * (self.mass + 0.5 * self.rod) * self.length
        rest = torque[0] - self.D_L * omega_L[0] - weight * sincos(theta_L[0] - self.theta_0)[0]
        return (rest / inertia,)
