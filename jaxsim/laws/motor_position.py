"""Motor position feedback, for loads that torque control leaves unstable."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import NON_NEGATIVE, parameter


class MotorPosition(Law):
    """v = -K_theta (theta_M - theta_M0), added to a torque law; 2014 paper, section 3.4.1.

    Where the load stiffness is negative, the load falls away from any torque however well it is
    tracked. This spring at the motor holds it about the angle theta_M0 (motor side), and gives
    up torque tracking at low frequencies for it: beside it a torque law may have no integral
    action (K_i = 0), or the integral wins and the load falls, only slower.
    """

    K_theta: Scalar = parameter("V/rad", "gain on the motor angle", rule=NON_NEGATIVE)
    theta_M0: Scalar = parameter("rad", "motor angle (N theta_L) to hold", default=0.0)
    command_unit: str = eqx.field(static=True, default="V", kw_only=True)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return -self.K_theta * (y.theta_M - self.theta_M0)
