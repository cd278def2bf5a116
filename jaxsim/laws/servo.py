"""A position servo as it comes in a box: firmware, bridge and winding."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxsim.hybrid import Surface, Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter
from jaxsim.signal import Signal
from jaxsim.signals.constant import Constant

# Feetech STS: position in 4096 counts per turn, duty in thousandths, k_p/4 of them per count.
_COUNT = 2.0 * np.pi / 4096.0


class Servo(Law):
    """The duty is proportional to the error of the angle; the command is the motor's torque, Nm.

        g'   = clip((reference - g)/lag, -slew, slew)
        duty = 0 where |g - theta_L| <= deadband, else
               clip(start_duty + k_p gain (|g - theta_L| - deadband), 0, 1) in its direction
        T_M  = K_T supply duty (1 - sag |duty|) - D_E omega_M, and 0 once the motor is released

    The winding is here and not in the motor because its inductance is left out and a released
    bridge opens the circuit: D_E = K_t K_w/R brakes a powered motor only. The duty jumps at the
    deadband, and there and at the release (`release` s, never by default) steps end.

    supply: V, a signal without jumps, read from the log where it was measured. A late command is
    the reference's `Delayed`. gain and the two thresholds default to the Feetech STS firmware: its
    duty register equals round(1000 duty) of this law in the logs that it was read from.
    """

    K_T: Scalar = parameter("Nm/V", "torque per volt at standstill", rule=POSITIVE)
    D_E: Scalar = parameter("Nm s/rad", "braking by back-emf", rule=NON_NEGATIVE)
    k_p: Scalar = parameter("1", "the gain that is set in the firmware", rule=NON_NEGATIVE)
    slew: Scalar = parameter("rad/s", "fastest change of the goal", rule=POSITIVE)
    lag: Scalar = parameter("s", "lag of the goal behind the command", rule=POSITIVE, default=4e-3)
    gain: Scalar = parameter("1/rad", "duty per k_p and error", rule=NON_NEGATIVE,
                             default=0.25e-3 / _COUNT)  # fmt: skip
    deadband: Scalar = parameter("rad", "error that is ignored", rule=NON_NEGATIVE, default=_COUNT)
    start_duty: Scalar = parameter("1", "least duty", rule=NON_NEGATIVE, default=0.016)
    sag: Scalar = parameter("1", "share of the torque that is missing at full duty", default=0.0)
    release: Scalar = parameter("s", "when the motor is released", rule=NON_NEGATIVE, default=1e9)
    supply: Signal = Constant(12.0)

    @property
    def reference_unit(self) -> str:
        return "rad"

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        band = Surface("duty+", "rad"), Surface("duty-", "rad")
        return (*band, Surface("release", "s"))

    def rest(self, y: Measured) -> Any:
        return y.reference, jnp.zeros_like(y.theta_L)

    def guards(self, state: Any, y: Measured) -> tuple[Scalar, ...]:
        goal, clock = state
        error = goal - y.theta_L
        return error - self.deadband, -error - self.deadband, clock - self.release

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        rate = jnp.clip((y.reference - state[0]) / self.lag, -self.slew, self.slew)
        return rate, jnp.ones_like(rate)

    def duty(self, error: Scalar, switches: tuple[Switch, ...]) -> Scalar:
        """Share of the supply on the motor, -1 to 1."""
        ahead, back, _ = switches
        slope, least = self.k_p * self.gain, self.start_duty
        up = ahead.gate * jnp.clip(least + slope * (error - self.deadband), 0.0, 1.0)
        return up - back.gate * jnp.clip(least - slope * (error + self.deadband), 0.0, 1.0)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        goal, clock = state
        duty = self.duty(goal - y.theta_L, switches)
        drive = self.K_T * self.supply.value(clock, clock) * duty * (1.0 - self.sag * jnp.abs(duty))
        return (1.0 - switches[2].on) * (drive - self.D_E * y.omega_M)
