"""Switched torsional damping: the proposal of the 2018 paper."""

from __future__ import annotations

from typing import Any

from jaxsim.hybrid import Surface, Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import parameter


class SwitchedDamping(Law):
    """T_B = K_B omega_B where omega_B*omega_L >= 0, else 0; 2018 paper (22), (23).

    From rest the first approach has omega_L = 0 identically, so the damping rests on the
    EQUALITY: the two guards carry the sign 0 until the load has moved, and 0 counts as on.
    In smoothed runs the gate is one-sided: exactly 1 where the product is >= 0.
    """

    K_B: Scalar = parameter("Nm s/rad", "gain on the deflection speed; negative damps")

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return Surface("omega_B", "rad/s"), Surface("omega_L", "rad/s")

    def guards(self, state: Any, y: Measured) -> tuple[Scalar, ...]:
        return y.omega_B, y.omega_L

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return self.K_B * y.omega_B * switches[0].agrees(switches[1])
