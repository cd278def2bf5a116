"""PI control of the joint torque."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import NON_NEGATIVE, parameter


class PITorque(Law):
    """v = K_p (e + K_i z), z' = e, e = tau_r - T_s; 2014 paper (13). The reference is tau_r, Nm."""

    K_p: Scalar = parameter("V/Nm", "proportional gain", rule=NON_NEGATIVE)
    K_i: Scalar = parameter("1/s", "inverse integral time", rule=NON_NEGATIVE)
    command_unit: str = eqx.field(static=True, default="V", kw_only=True)

    @property
    def reference_unit(self) -> str:
        return "Nm"

    def rest(self, y: Measured) -> Any:
        """An empty integral: one that has seen a constant error for ever has no finite value."""
        return (0.0 * y.T_s,)

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        return (y.reference - y.T_s,)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return self.K_p * (y.reference - y.T_s + self.K_i * state[0])
