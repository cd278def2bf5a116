"""A planar arm of two links, in relative coordinates."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from jaxsim.drive import Load, Scalar
from jaxsim.errors import InputError
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, is_concrete, parameter
from jaxsim.sincos import sincos


class TwoLink(Load):
    """M(q) q'' + C(q', q) + D_L q' + G(q) = T_s + d_L with q = theta_L, 2014 paper (1), (30)-(31):

        M = [[inertia_1 + 2 coupling cos q2, inertia_2 + coupling cos q2], [., inertia_2]]
        C = coupling sin(q2) [-(2 q1' q2' + q2'^2), q1'^2]      (corrected: see the errata)
        G = [gravity_1 sin q1 + gravity_2 sin(q1 + q2), gravity_2 sin(q1 + q2)]

    q = 0 hangs down. Solved in closed form; M is positive definite at every angle if and only if
    inertia_2 (inertia_1 - inertia_2) > coupling^2.

    Raises: InputError when it is not.
    """

    axes: ClassVar[int] = 2

    inertia_1: Scalar = parameter("kg m^2", "M_11 at q2 = 90 degrees", rule=POSITIVE)
    inertia_2: Scalar = parameter("kg m^2", "M_22", rule=POSITIVE)
    coupling: Scalar = parameter("kg m^2", "factor of cos q2 in M_12")
    gravity_1: Scalar = parameter("Nm", "weight torque about joint 1 of link 1 and mass 2")
    gravity_2: Scalar = parameter("Nm", "weight torque of link 2")
    D_L1: Scalar = parameter("Nm s/rad", "viscosity of joint 1", rule=NON_NEGATIVE, default=0.0)
    D_L2: Scalar = parameter("Nm s/rad", "viscosity of joint 2", rule=NON_NEGATIVE, default=0.0)

    def __check_init__(self) -> None:
        least = self._least_determinant
        if is_concrete(least) and np.ndim(least) == 0 and not least > 0.0:
            raise InputError(
                "TwoLink.coupling", "must keep M(q) positive definite at every angle",
                np.asarray(self.coupling).tolist(),
                "inertia_2*(inertia_1 - inertia_2) must exceed coupling^2",
            )  # fmt: skip

    @property
    def _least_determinant(self) -> Scalar:
        """det M at cos(q2)^2 = 1, where it is smallest."""
        return self.inertia_2 * (self.inertia_1 - self.inertia_2) - self.coupling**2

    def definite(self, theta_L: tuple[Scalar, ...]) -> Scalar:
        return jnp.asarray(self._least_determinant > 0.0)

    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        (q1, q2), (w1, w2) = theta_L, omega_L
        (sine_1, cosine_1), (sine, cosine) = sincos(q1), sincos(q2)
        swing = self.coupling * sine
        hang = self.gravity_2 * (sine_1 * cosine + cosine_1 * sine)  # sin(q1 + q2)
        rest_1 = torque[0] + swing * (2.0 * w1 * w2 + w2 * w2) - self.D_L1 * w1
        rest_1 = rest_1 - self.gravity_1 * sine_1 - hang
        rest_2 = torque[1] - swing * w1 * w1 - self.D_L2 * w2 - hang
        M_11 = self.inertia_1 + 2.0 * self.coupling * cosine
        M_12 = self.inertia_2 + self.coupling * cosine
        # det M without the cancelling terms: M_11 M_22 - M_12^2 = least + (coupling sin q2)^2.
        determinant = self._least_determinant + swing * swing
        inverse = 1.0 / jnp.where(self._least_determinant > 0.0, determinant, jnp.nan)
        return (
            (self.inertia_2 * rest_1 - M_12 * rest_2) * inverse,
            (M_11 * rest_2 - M_12 * rest_1) * inverse,
        )
