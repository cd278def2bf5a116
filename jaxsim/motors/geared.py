"""A motor behind gear wheels whose friction grows with the torque they carry."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsim.drive import Motor, Scalar, Shaft
from jaxsim.hybrid import Surface, Switch
from jaxsim.motors.friction import stick_guard
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter

# A stick holds this much more than the slip that it ends, as a share. A motor that creeps to rest
# under its own position loop stops where both are equal to the last digit, and toggled for ever.
_HOLD = 1e-3
# 1/s. What is left of the speed when a stick begins is rounding; left alone it would wind the gear
# up until the stick breaks.
_SETTLE = 200.0


class Geared(Motor):
    """J_M omega_M' = T_M + bias - D_M omega_M - T - friction, T = T_s/N the torque of the load.

    While the shaft turns, the friction is against the motion and of the size

        Fc + (Fs - Fc) exp(-|omega_M|/ws) + driving |T| or driven |T|,

    `driving` where the motor moves the load, `driven` where the load moves the motor: tooth and
    sliding friction are a share of the torque that goes through, and gears give less of it back.
    driven near 1 holds the load without current. A shaft at rest sticks up to the same size (Fs
    for the first two terms); slip and stick are modes with located changes, as in `Stribeck`.

    For a prismatic axis read m, N and kg for rad, Nm and kg m^2.

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), for the speed;
    models M3-M6 of Duclusaud et al. (2024), "Extended friction models for the physics simulation
    of servo actuators", arXiv 2410.08650, for the load. Their |omega| and T are smoothed there.
    """

    command_unit: ClassVar[str] = "Nm"

    J_M: Scalar = parameter("kg m^2", "moment of inertia at the shaft", rule=POSITIVE)
    D_M: Scalar = parameter("Nm s/rad", "viscosity at the shaft", rule=NON_NEGATIVE, default=0.0)
    Fc: Scalar = parameter("Nm", "Coulomb friction without load", rule=NON_NEGATIVE, default=0.0)
    Fs: Scalar = parameter("Nm", "what a stick holds without load", rule=NON_NEGATIVE, default=0.0)
    ws: Scalar = parameter("rad/s", "Stribeck speed", rule=POSITIVE, default=1.0)
    driving: Scalar = parameter("1", "friction per load torque, driving it", rule=NON_NEGATIVE,
                                default=0.0)  # fmt: skip
    driven: Scalar = parameter("1", "friction per load torque, driven by it", rule=NON_NEGATIVE,
                               default=0.0)  # fmt: skip
    bias: Scalar = parameter("Nm", "torque that is there without command", default=0.0)

    def rest(self) -> Any:
        return ()

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return Surface("slip+", "rad/s"), Surface("slip-", "rad/s")

    def torque(self, extra: Any, command: Scalar) -> Scalar:
        return command

    def guards(
        self, shaft: Shaft, extra: Any, command: Scalar, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        forward, backward = modes
        torque, speed = self._pull(shaft, command), shaft.omega_M
        still = jnp.zeros_like(speed)
        ahead = (1.0 + _HOLD) * self.friction(still, shaft.torque)
        back = (1.0 + _HOLD) * self.friction(still, -shaft.torque)
        return (
            stick_guard(speed, torque - ahead, forward, backward),
            stick_guard(-speed, -torque - back, backward, forward),
        )

    def _pull(self, shaft: Shaft, command: Scalar) -> Scalar:
        """All torques on the rotor but dry friction, Nm."""
        return command + self.bias - self.D_M * shaft.omega_M - shaft.torque

    def friction(self, speed: Scalar, against: Scalar) -> Scalar:
        """Size of the dry friction, Nm, at |speed| with a load torque `against` the motion."""
        free = self.Fc + (self.Fs - self.Fc) * jnp.exp(-speed / self.ws)
        share = jnp.where(against > 0.0, self.driving, -self.driven)
        return free + share * against

    def field(
        self, shaft: Shaft, extra: Any, command: Scalar, switches: tuple[Switch, ...]
    ) -> tuple[Scalar, Any]:
        forward, backward = switches
        turning, speed = forward.gate + backward.gate, jnp.abs(shaft.omega_M)
        ahead = forward.gate * self.friction(speed, shaft.torque)
        back = backward.gate * self.friction(speed, -shaft.torque)
        rate = (turning * self._pull(shaft, command) - ahead + back) / self.J_M
        return rate - (1.0 - turning) * _SETTLE * shaft.omega_M, ()
