"""Deadzone and linear damping: the standard model of a gear with play."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxsim.drive import Scalar, Transmission
from jaxsim.hybrid import Surface, Switch
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, Rule, parameter

# 0.35 rad is 20 degrees to either side: what is larger was given in mrad or degrees.
HALF_GAP = Rule(
    "must be >= 0 and < 0.35 rad",
    lambda v: (v >= 0) & (v < 0.35),
    "give HALF of the play, in load-side rad (0.45 deg is 7.85e-3)",
)


class Backlash(Transmission):
    """T_s = 0 inside the gap, D_B omega_B + K (theta_B -+ half_gap) in contact; 2018 paper (5).

    Contact includes the boundary |theta_B| = half_gap. T_s jumps by D_B omega_B when contact is
    made, and may pull shortly before release, as (5) allows; `no_pull` releases at T_s = 0
    instead. half_gap = 0 is a flexible joint without play.
    """

    K: Scalar = parameter("Nm/rad", "torsional rigidity", rule=POSITIVE)
    half_gap: Scalar = parameter("rad", "HALF of the play, load side", rule=HALF_GAP)
    D_B: Scalar = parameter("Nm s/rad", "torsional damping", rule=NON_NEGATIVE, default=0.0)
    N: Scalar = parameter("1", "ratio: motor angle over load angle", rule=POSITIVE, default=1.0)
    no_pull: bool = eqx.field(static=True, default=False)

    @property
    def ratio(self) -> Scalar:
        return self.N

    def rest(self, theta_B: Scalar) -> Any:
        return ()

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        contact = Surface("contact+", "rad"), Surface("contact-", "rad")
        push = Surface("push+", "Nm"), Surface("push-", "Nm")
        return contact + push if self.no_pull else contact

    def guards(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        plus, minus = theta_B - self.half_gap, -theta_B - self.half_gap
        if not self.no_pull:
            return plus, minus
        push_plus = self.K * plus + self.D_B * omega_B
        push_minus = self.K * minus - self.D_B * omega_B
        return plus, minus, push_plus, push_minus

    def _sides(self, switches: tuple[Switch, ...]) -> tuple[Switch, Switch]:
        """The two contacts; one of them where half_gap = 0 and rest put both on the boundary."""
        plus, minus = switches[:2]
        other = 1.0 - plus.on * minus.on
        return plus, minus._replace(on=minus.on * other, gate=minus.gate * other)

    def torque(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        plus, minus = self._sides(switches)
        springs = plus.on * (theta_B - self.half_gap), minus.on * (theta_B + self.half_gap)
        gates = plus.gate, minus.gate
        if self.no_pull:
            push = switches[2].on, switches[3].on
            springs = tuple(on * v for on, v in zip(push, springs, strict=True))
            gates = tuple(on * v for on, v in zip(push, gates, strict=True))
        return self.K * (springs[0] + springs[1]) + (gates[0] + gates[1]) * (self.D_B * omega_B)

    def field(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Any:
        return ()

    def loss(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        plus, minus = self._sides(switches)
        damped = plus.gate + minus.gate
        if self.no_pull:
            damped = plus.gate * switches[2].on + minus.gate * switches[3].on
        return damped * self.D_B * omega_B * omega_B

    def contact(self, switches: tuple[Switch, ...]) -> Scalar:
        plus, minus = self._sides(switches)
        return jnp.asarray(plus.on - minus.on)
