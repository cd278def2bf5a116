"""A flexible joint without play."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsim.drive import Scalar, Transmission
from jaxsim.hybrid import Surface, Switch
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter


class Elastic(Transmission):
    """T_s = K theta_B + D_B omega_B; 2014 paper (4) with K = K_H, D_B = 0.

    The same as `Backlash` with half_gap = 0, but without its two coinciding surfaces: no events.
    """

    K: Scalar = parameter("Nm/rad", "torsional rigidity, load side (K_H)", rule=POSITIVE)
    N: Scalar = parameter("1", "ratio: motor angle over load angle", rule=POSITIVE, default=1.0)
    D_B: Scalar = parameter("Nm s/rad", "torsional damping", rule=NON_NEGATIVE, default=0.0)

    @property
    def ratio(self) -> Scalar:
        return self.N

    def rest(self, theta_B: Scalar) -> Any:
        return ()

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return ()

    def guards(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        return ()

    def torque(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        return self.K * theta_B + self.D_B * omega_B

    def field(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Any:
        return ()

    def loss(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        return self.D_B * omega_B * omega_B

    def contact(self, switches: tuple[Switch, ...]) -> Scalar:
        """Always +1: it never separates."""
        return jnp.ones_like(jnp.asarray(self.K))
