"""Dry friction at a motor shaft, with a stick that holds."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsim.drive import Scalar
from jaxsim.hybrid import Surface, Switch
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, Parameters, parameter


def stick_guard(speed: Scalar, excess: Scalar, own: Scalar, other: Scalar) -> Scalar:
    """Guard of slipping one way.

    Slipping that way: its speed. Stuck: the excess of torque over what the stick holds, that way.
    Slipping the other way: out of play.

    own, other: modes of this way and the other. Where modes are not known (0), the speed decides,
    and at rest the excess.
    """
    unknown = jnp.where(speed == 0.0, excess, speed)
    resting = jnp.where(other < 0.0, excess, -jnp.ones_like(speed))
    return jnp.where(own > 0.0, speed, jnp.where(own < 0.0, resting, unknown))


class Stribeck(Parameters):
    """Slipping: (Fc + (Fs - Fc) exp(-(omega_M/ws)^2)) against the motion; sticking: up to Fs.

    Two surfaces carry three modes: slip forward (+, -), slip backward (-, +), stick (-, -). A
    slip ends where omega_M = 0; a stick ends where the torque it holds exceeds Fs, on that side.
    A reversal under more than Fs is therefore two events at one instant, and rest cannot chatter:
    inside |torque| < Fs both slips point to rest, and the stick has no speed guard.
    In smoothed runs the direction is a C2 sign of omega_M and a stick creeps; in plain runs the
    sign is read at every stage.

    Source: errata to the 2014 paper, Fig. 10 (the paper gives no model).
    """

    Fc: Scalar = parameter("Nm", "Coulomb friction at the motor shaft", rule=NON_NEGATIVE)
    Fs: Scalar = parameter("Nm", "largest torque that a stick holds", rule=NON_NEGATIVE)
    ws: Scalar = parameter("rad/s", "Stribeck speed", rule=POSITIVE)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return Surface("slip+", "rad/s"), Surface("slip-", "rad/s")

    def guards(
        self, omega_M: Scalar, torque: Scalar, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        """Guard values; torque: all that drives the rotor besides this friction, Nm."""
        forward, backward = modes
        return (
            stick_guard(omega_M, torque - self.Fs, forward, backward),
            stick_guard(-omega_M, -torque - self.Fs, backward, forward),
        )

    def acceleration(
        self, omega_M: Scalar, torque: Scalar, inertia: Scalar, switches: tuple[Switch, ...]
    ) -> Scalar:
        """d omega_M/dt under `torque` and the friction; exactly zero while stuck."""
        forward, backward = switches
        curve = self.Fc + (self.Fs - self.Fc) * jnp.exp(-((omega_M / self.ws) ** 2))
        slipping = forward.gate + backward.gate
        direction = forward.gate - backward.gate
        return (slipping * torque - direction * curve) / inertia
