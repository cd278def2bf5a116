"""Switched torsional damping whose switch is a ramp."""

from __future__ import annotations

from typing import Any

from jaxsim.hybrid import Switch, quintic
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import POSITIVE, Rule, parameter

NOT_POSITIVE = Rule(
    "must be <= 0",
    lambda v: (v <= 0.0) & (v > -float("inf")),
    "give 0 or less: at rest, where the product is 0, the damping must be on",
)


class RampedDamping(Law):
    """T_B = K_B omega_B g, g = q(1 + (omega_B omega_L - threshold)/width), 2018 paper (22), (23).

    q is the C2 step from 0 to 1. One-sided: g is exactly 1 where omega_B omega_L >= threshold and
    0 below threshold - width; width -> 0 with threshold 0 is `SwitchedDamping`. It has no
    switching surfaces, so that an objective under it does not jump with its gains where the law
    is sampled, and threshold and width can be tuned as gains can.
    """

    K_B: Scalar = parameter("Nm s/rad", "gain on the deflection speed; negative damps")
    threshold: Scalar = parameter(
        "rad^2/s^2", "omega_B*omega_L above which it is fully on", rule=NOT_POSITIVE, default=0.0
    )
    width: Scalar = parameter("rad^2/s^2", "of the ramp below it", rule=POSITIVE, default=0.01)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        product = y.omega_B * y.omega_L
        return self.K_B * y.omega_B * quintic(1.0 + (product - self.threshold) / self.width)
