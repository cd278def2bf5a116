"""A drive is composed: motor + transmission per axis, and one load for all axes."""

from __future__ import annotations

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from jaxsim.errors import InputError
from jaxsim.hybrid import Surface, Switch
from jaxsim.parameters import Parameters

Scalar = Any


class Motor(Parameters):
    """What turns a command into motor speed."""

    command_unit: ClassVar[str]

    @abc.abstractmethod
    def rest(self) -> Any:
        """Its own state besides the speed, at rest: a tuple of floats (empty if none)."""

    @abc.abstractmethod
    def torque(self, extra: Any, command: Scalar) -> Scalar:
        """The air-gap torque T_M, Nm."""

    @abc.abstractmethod
    def field(
        self, omega_M: Scalar, extra: Any, command: Scalar, load_torque: Scalar
    ) -> tuple[Scalar, Any]:
        """d omega_M/dt in rad/s^2 and the rates of its own state; load_torque at its shaft."""


class Transmission(Parameters):
    """What turns deflection theta_B = theta_M/N - theta_L into joint torque T_s (load side)."""

    @property
    @abc.abstractmethod
    def ratio(self) -> Scalar:
        """N: motor angle over load angle."""

    @abc.abstractmethod
    def rest(self, theta_B: Scalar) -> Any:
        """Its own state at rest at a deflection: a tuple of scalars (empty if none)."""

    @property
    @abc.abstractmethod
    def surfaces(self) -> tuple[Surface, ...]:
        """Its switching surfaces."""

    @abc.abstractmethod
    def guards(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        """Guard values of its surfaces; `modes` are the carried signs, for those that depend.

        A mode 0 is not known yet (at the start) or not carried (without location): the value
        must then tell the sign by itself.
        """

    @abc.abstractmethod
    def torque(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        """Joint torque T_s on the load, Nm."""

    @abc.abstractmethod
    def field(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Any:
        """Rates of its own state."""

    @abc.abstractmethod
    def loss(
        self, theta_B: Scalar, omega_B: Scalar, extra: Any, switches: tuple[Switch, ...]
    ) -> Scalar:
        """Power that its damping turns into heat, W."""

    @abc.abstractmethod
    def contact(self, switches: tuple[Switch, ...]) -> Scalar:
        """+1, 0 or -1: positive contact, gap, negative contact."""


class Load(Parameters):
    """What the transmissions move."""

    axes: ClassVar[int]

    @abc.abstractmethod
    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        """d omega_L/dt per axis, rad/s^2, under the torques of transmissions and disturbances."""


class AxisState(NamedTuple):
    """State of one axis. The deflection is carried, never the difference of two large angles."""

    theta_L: Scalar
    omega_L: Scalar
    theta_B: Scalar
    omega_M: Scalar
    motor: Any
    transmission: Any


class Drive(eqx.Module):
    """motor, transmission: one per axis (a single one is taken as one axis); load: for all axes.

    For axis i, with N the ratio and T_M the motor torque (2018 paper (1)-(5), N = 1 there):

        theta_B' = omega_M/N - omega_L,   theta_L' = omega_L,
        motor:  omega_M' = f(T_M, T_s/N),  load:  omega_L' = M(theta_L)^-1 (T_s + d_L - ...).

    Raises: InputError when motors, transmissions and load disagree on the number of axes.
    """

    motor: tuple[Motor, ...] = eqx.field(converter=lambda v: v if isinstance(v, tuple) else (v,))
    transmission: tuple[Transmission, ...] = eqx.field(
        converter=lambda v: v if isinstance(v, tuple) else (v,)
    )
    load: Load

    def __check_init__(self) -> None:
        counts = {
            "motor": len(self.motor),
            "transmission": len(self.transmission),
            "load": self.load.axes,
        }
        if len(set(counts.values())) != 1:
            raise InputError(
                "drive", "must have one motor and one transmission per load axis", counts, "match"
            )
        units = {m.command_unit for m in self.motor}
        if len(units) != 1:
            raise InputError("drive.motor", "must all take one command unit", units, "match")

    @property
    def axes(self) -> int:
        return len(self.motor)

    @property
    def command_unit(self) -> str:
        """What the drive takes as command: "Nm" or "V"."""
        return self.motor[0].command_unit

    def speed(self, axis: int, state: AxisState) -> Scalar:
        """omega_B = omega_M/N - omega_L, rad/s (4)."""
        return state.omega_M / self.transmission[axis].ratio - state.omega_L

    def guards(
        self, state: tuple[AxisState, ...], modes: tuple[tuple[Scalar, ...], ...]
    ) -> tuple[tuple[Scalar, ...], ...]:
        """Guard values of the transmissions, per axis."""
        return tuple(
            self.transmission[i].guards(s.theta_B, self.speed(i, s), s.transmission, modes[i])
            for i, s in enumerate(state)
        )

    def joint_torques(
        self, state: tuple[AxisState, ...], switches: tuple[tuple[Switch, ...], ...]
    ) -> tuple[Scalar, ...]:
        """T_s per axis, Nm (5)."""
        return tuple(
            self.transmission[i].torque(s.theta_B, self.speed(i, s), s.transmission, switches[i])
            for i, s in enumerate(state)
        )

    def field(
        self,
        state: tuple[AxisState, ...],
        command: tuple[Scalar, ...],
        load_torque: tuple[Scalar, ...],
        switches: tuple[tuple[Switch, ...], ...],
    ) -> tuple[AxisState, ...]:
        """Rates of the state under commands (Nm or V) and load torques d_L (Nm)."""
        torques = self.joint_torques(state, switches)
        accelerations = self.load.acceleration(
            tuple(s.theta_L for s in state),
            tuple(s.omega_L for s in state),
            tuple(T_s + d_L for T_s, d_L in zip(torques, load_torque, strict=True)),
        )
        return tuple(
            self._axis_field(i, s, command[i], torques[i], accelerations[i], switches[i])
            for i, s in enumerate(state)
        )

    def _axis_field(
        self,
        axis: int,
        s: AxisState,
        command: Scalar,
        torque: Scalar,
        acceleration: Scalar,
        switches: tuple[Switch, ...],
    ) -> AxisState:
        transmission, omega_B = self.transmission[axis], self.speed(axis, s)
        domega_M, dmotor = self.motor[axis].field(
            s.omega_M, s.motor, command, torque / transmission.ratio
        )
        dtransmission = transmission.field(s.theta_B, omega_B, s.transmission, switches)
        return AxisState(s.omega_L, acceleration, omega_B, domega_M, dmotor, dtransmission)
