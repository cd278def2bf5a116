"""Torsional damping addition."""

from __future__ import annotations

from typing import Any

from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import parameter


class LinearDamping(Law):
    """T_B = K_B omega_B; 2018 paper (22). K_B < 0 damps, K_B = 0 is no damping."""

    K_B: Scalar = parameter("Nm s/rad", "gain on the deflection speed; negative damps")

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return self.K_B * y.omega_B
