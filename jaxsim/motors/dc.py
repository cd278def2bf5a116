"""A DC motor with its electrical side, ripple, friction and supply."""

from __future__ import annotations

from typing import Any, ClassVar

from jaxsim.drive import Motor, Scalar, Shaft
from jaxsim.hybrid import Surface, Switch
from jaxsim.motors.friction import Stribeck
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, Parameters, parameter
from jaxsim.sincos import sincos


class Ripple(Parameters):
    """amplitude cos(order theta_M + phase), Nm at the MOTOR shaft.

    Source: 2014 paper, section 3.3, where tau_d acts without the N^-1 that (2) prints (errata).
    """

    amplitude: Scalar = parameter("Nm", "torque amplitude at the motor shaft")
    order: Scalar = parameter("1", "periods per motor revolution", default=2.0)
    phase: Scalar = parameter("rad", "phase at theta_M = 0", default=0.0)

    def torque(self, theta_M: Scalar) -> Scalar:
        return self.amplitude * sincos(self.order * theta_M + self.phase)[1]


class Supply(Parameters):
    """The voltage that can be had: the command is cut to +-limit, at located instants."""

    limit: Scalar = parameter("V", "largest voltage of either sign", rule=POSITIVE)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return Surface("limit+", "V"), Surface("limit-", "V")

    def guards(self, command: Scalar) -> tuple[Scalar, ...]:
        return command - self.limit, -command - self.limit

    def voltage(self, command: Scalar, switches: tuple[Switch, ...]) -> Scalar:
        over, under = switches
        return command - over.on * (command - self.limit) - under.on * (command + self.limit)


class DC(Motor):
    """A permanent-magnet motor fed with a voltage; state: current i.

        L i' + R i = v - K_w omega_M
        J_M omega_M' + D_M omega_M + T_s/N = K_t i + ripple - friction

    Ripple, friction and supply are optional. Source: 2014 paper, (2)-(3); J_M = J_m, D_M = B_m.
    """

    command_unit: ClassVar[str] = "V"

    L: Scalar = parameter("H", "inductance", rule=POSITIVE)
    R: Scalar = parameter("ohm", "resistance", rule=POSITIVE)
    K_t: Scalar = parameter("Nm/A", "torque constant", rule=POSITIVE)
    K_w: Scalar = parameter("V s/rad", "back-emf constant", rule=NON_NEGATIVE)
    J_M: Scalar = parameter("kg m^2", "inertia of motor and gear at the shaft", rule=POSITIVE)
    D_M: Scalar = parameter("Nm s/rad", "viscosity at the shaft", rule=NON_NEGATIVE, default=0.0)
    ripple: Ripple | None = None
    friction: Stribeck | None = None
    supply: Supply | None = None

    def rest(self) -> Any:
        return (0.0,)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        friction = self.friction.surfaces if self.friction else ()
        return friction + (self.supply.surfaces if self.supply else ())

    def guards(
        self, shaft: Shaft, extra: Any, command: Scalar, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        guards: tuple[Scalar, ...] = ()
        if self.friction:
            guards += self.friction.guards(
                shaft.omega_M, self._drive_torque(shaft, extra), modes[:2]
            )
        if self.supply:
            guards += self.supply.guards(command)
        return guards

    def torque(self, extra: Any, command: Scalar) -> Scalar:
        return self.K_t * extra[0]

    def _drive_torque(self, shaft: Shaft, extra: Any) -> Scalar:
        """All torques on the rotor but dry friction, Nm."""
        torque = self.K_t * extra[0] - self.D_M * shaft.omega_M - shaft.torque
        return torque + self.ripple.torque(shaft.theta_M) if self.ripple else torque

    def field(
        self, shaft: Shaft, extra: Any, command: Scalar, switches: tuple[Switch, ...]
    ) -> tuple[Scalar, Any]:
        (current,) = extra
        torque = self._drive_torque(shaft, extra)
        rate = torque / self.J_M
        if self.friction:
            rate = self.friction.acceleration(shaft.omega_M, torque, self.J_M, switches[:2])
        voltage = self.supply.voltage(command, switches[-2:]) if self.supply else command
        return rate, ((voltage - self.R * current - self.K_w * shaft.omega_M) / self.L,)
