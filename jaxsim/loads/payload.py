"""A planar arm of two links that carries a mass."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx

from jaxsim.drive import Load, Scalar
from jaxsim.loads.two_link import TwoLink
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter

_GRAVITY = 9.81  # m/s^2


class TwoLinkPayload(Load):
    """`TwoLink` with a point mass m at the end of link 2, l_1 and l_2 from joint to joint or end:

        inertia_1 + m (l_1^2 + l_2^2), inertia_2 + m l_2^2, coupling + m l_1 l_2,
        gravity_1 + m g l_1, gravity_2 + m g l_2

    A mass keeps M positive definite: it adds J' J m with J of the end.
    """

    axes: ClassVar[int] = 2

    arm: TwoLink = eqx.field(metadata={"base": Load})
    payload: Scalar = parameter("kg", "mass at the end of link 2", rule=NON_NEGATIVE)
    length_1: Scalar = parameter("m", "joint 1 to joint 2", rule=POSITIVE)
    length_2: Scalar = parameter("m", "joint 2 to the payload", rule=POSITIVE)

    @property
    def loaded(self) -> TwoLink:
        """The arm without payload that moves as this one does with it."""
        arm, m, l_1, l_2 = self.arm, self.payload, self.length_1, self.length_2
        return TwoLink(
            inertia_1=arm.inertia_1 + m * (l_1 * l_1 + l_2 * l_2),
            inertia_2=arm.inertia_2 + m * l_2 * l_2,
            coupling=arm.coupling + m * l_1 * l_2,
            gravity_1=arm.gravity_1 + m * _GRAVITY * l_1,
            gravity_2=arm.gravity_2 + m * _GRAVITY * l_2,
            D_L1=arm.D_L1,
            D_L2=arm.D_L2,
        )

    def definite(self, theta_L: tuple[Scalar, ...]) -> Scalar:
        return self.loaded.definite(theta_L)

    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        return self.loaded.acceleration(theta_L, omega_L, torque)
