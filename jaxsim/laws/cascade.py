"""Position loop over speed loop, at the motor."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter


class Cascade(Law):
    """u = gain clip(k_v (k_p (reference - theta_M) - w), -limit, limit), w' = (omega_M - w)/lag.

    lag: of the speed, which a computer has from differences of positions over a sample or more.
    gain: what the amplifier makes of the control signal (its unit over V). The limit is a kink,
    not a jump: no surface. For a prismatic axis read m, N for rad, Nm.

    Source: Janot, Gautier, Brunot (2019), EMPS benchmark, with gain = g_tau.
    """

    k_p: Scalar = parameter("1/s", "position gain", rule=NON_NEGATIVE)
    k_v: Scalar = parameter("V s/rad", "speed gain", rule=NON_NEGATIVE)
    gain: Scalar = parameter("Nm/V", "torque per control signal", rule=POSITIVE)
    limit: Scalar = parameter("V", "largest control signal of either sign", rule=POSITIVE)
    lag: Scalar = parameter("s", "lag of the measured speed", rule=POSITIVE)
    command_unit: str = eqx.field(static=True, default="Nm", kw_only=True)

    @property
    def reference_unit(self) -> str:
        return "rad"

    def rest(self, y: Measured) -> Any:
        return (y.omega_M,)

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        return ((y.omega_M - state[0]) / self.lag,)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        wanted = self.k_p * (y.reference - y.theta_M)
        return self.gain * jnp.clip(self.k_v * (wanted - state[0]), -self.limit, self.limit)
