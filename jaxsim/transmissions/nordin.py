"""The physical model of a gear with play, whose spring has a twist of its own."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsim.drive import Scalar, Transmission
from jaxsim.hybrid import Surface, Switch
from jaxsim.parameters import POSITIVE, parameter


class Nordin(Transmission):
    """Play in series with a spring and damper: T_s never pulls, and the twist dies out in play.

    With the position theta_b inside the play as a state, |theta_b| <= half_gap:

        T_s = K (theta_B - theta_b) + D_B (omega_B - theta_b'),
        theta_b' = v              in play,  v = omega_B + (K/D_B)(theta_B - theta_b),
        theta_b' = max(0, v)      at theta_b = -half_gap,
        theta_b' = min(0, v)      at theta_b = +half_gap.

    So T_s = 0 in play, and D_B v at the wall: contact ends where T_s changes its sign. At rest the
    spring is relaxed, or compressed where |theta_B| > half_gap. The twist dies out at the rate
    K/D_B, so an integration step must be shorter than 2.7 D_B/K. Smoothed runs leave it hard.

    Source: Nordin, Galic, Gutman, New models for backlash and gear play, Int. J. Adaptive Control
    and Signal Processing 11 (1997): the "exact model" that the 2018 paper cites as [9].
    """

    K: Scalar = parameter("Nm/rad", "torsional rigidity", rule=POSITIVE)
    half_gap: Scalar = parameter("rad", "HALF of the play, load side", rule=POSITIVE)
    # Without damper there is nothing for theta_b to relax by: Backlash(no_pull=True) is the limit.
    D_B: Scalar = parameter("Nm s/rad", "torsional damping", rule=POSITIVE)
    N: Scalar = parameter("1", "ratio: motor angle over load angle", rule=POSITIVE, default=1.0)

    @property
    def ratio(self) -> Scalar:
        return self.N

    def rest(self, theta_B: Scalar) -> Any:
        return (jnp.clip(theta_B, -self.half_gap, self.half_gap),)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return Surface("contact+", "rad"), Surface("contact-", "rad")

    def guards(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        (theta_b,) = extra
        push = theta_B + self.D_B / self.K * omega_B
        return (
            self._wall(theta_b - self.half_gap, push - self.half_gap, modes[0]),
            self._wall(-theta_b - self.half_gap, -push - self.half_gap, modes[1]),
        )

    def _wall(self, beyond: Scalar, push: Scalar, mode: Scalar) -> Scalar:
        """In play the wall is what ends it, in contact |T_s|/K; without a mode, both decide."""
        pushed = jnp.where(mode == 0.0, beyond >= 0.0, mode > 0.0)
        return jnp.where(pushed, push, beyond)

    def torque(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        # From the wall itself, not from theta_b, which holds its landing to rounding only.
        plus, minus = (s.on for s in switches)
        damping = self.D_B * omega_B
        return plus * (self.K * (theta_B - self.half_gap) + damping) + minus * (
            self.K * (theta_B + self.half_gap) + damping
        )

    def field(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Any:
        (theta_b,) = extra
        in_play = (1.0 - switches[0].on) * (1.0 - switches[1].on)
        return (in_play * (omega_B + self.K / self.D_B * (theta_B - theta_b)),)

    def loss(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        (slip,) = self.field(theta_B, omega_B, extra, switches)
        return self.D_B * (omega_B - slip) ** 2

    def contact(self, switches: tuple[Switch, ...]) -> Scalar:
        return jnp.asarray(switches[0].on - switches[1].on)
