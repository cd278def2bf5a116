"""A drive is composed: motor + transmission per axis, and one load for all axes."""

from __future__ import annotations

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxsim.errors import InputError
from jaxsim.hybrid import Surface, Switch
from jaxsim.parameters import Parameters

Scalar = Any


class Shaft(NamedTuple):
    """What a motor feels at its shaft: angle rad, speed rad/s, torque T_s/N of the gear Nm."""

    theta_M: Scalar
    omega_M: Scalar
    torque: Scalar


class Motor(Parameters):
    """What turns a command into motor speed."""

    command_unit: ClassVar[str]

    @abc.abstractmethod
    def rest(self) -> Any:
        """Its own state besides the speed, at rest: a tuple of floats (empty if none)."""

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Its switching surfaces: friction that sticks, a supply that saturates."""
        return ()

    def guards(
        self, shaft: Shaft, extra: Any, command: Scalar, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        """Guard values of its surfaces; `modes` are the carried signs, 0 where none are carried."""
        return ()

    @abc.abstractmethod
    def torque(self, extra: Any, command: Scalar) -> Scalar:
        """The air-gap torque T_M, Nm."""

    @abc.abstractmethod
    def field(
        self, shaft: Shaft, extra: Any, command: Scalar, switches: tuple[Switch, ...]
    ) -> tuple[Scalar, Any]:
        """d omega_M/dt in rad/s^2 and the rates of its own state."""


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
    # Whether the mass matrix is positive definite at some angles and not at others.
    turns_singular: ClassVar[bool] = False

    @abc.abstractmethod
    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        """d omega_L/dt per axis, rad/s^2, under the torques of transmissions and disturbances.

        NaN where the mass matrix is not positive definite: the run stops there.
        """

    def definite(self, theta_L: tuple[Scalar, ...]) -> Scalar:
        """Whether the mass matrix is positive definite at these angles; asked after a failure."""
        return jnp.asarray(True)


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
        return (1.0 / self.transmission[axis].ratio) * state.omega_M - state.omega_L

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

    def shafts(
        self, state: tuple[AxisState, ...], torques: tuple[Scalar, ...]
    ) -> tuple[Shaft, ...]:
        """What the motors feel under the joint torques T_s, per axis."""
        ratios = (t.ratio for t in self.transmission)
        return tuple(
            Shaft(N * (s.theta_L + s.theta_B), s.omega_M, (1.0 / N) * T_s)
            for N, s, T_s in zip(ratios, state, torques, strict=True)
        )

    def motor_guards(
        self,
        state: tuple[AxisState, ...],
        torques: tuple[Scalar, ...],
        command: tuple[Scalar, ...],
        modes: tuple[tuple[Scalar, ...], ...],
    ) -> tuple[tuple[Scalar, ...], ...]:
        """Guard values of the motors, per axis."""
        shafts = self.shafts(state, torques)
        return tuple(
            self.motor[i].guards(shafts[i], s.motor, command[i], modes[i])
            for i, s in enumerate(state)
        )

    def field(
        self,
        state: tuple[AxisState, ...],
        command: tuple[Scalar, ...],
        load_torque: tuple[Scalar, ...],
        switches: tuple[tuple[Switch, ...], ...],
        motor_switches: tuple[tuple[Switch, ...], ...],
    ) -> tuple[AxisState, ...]:
        """Rates of the state under commands (Nm or V) and load torques d_L (Nm)."""
        torques = self.joint_torques(state, switches)
        accelerations = self.load.acceleration(
            tuple(s.theta_L for s in state),
            tuple(s.omega_L for s in state),
            tuple(T_s + d_L for T_s, d_L in zip(torques, load_torque, strict=True)),
        )
        shafts = self.shafts(state, torques)
        rates = []
        for i, s in enumerate(state):
            transmission, omega_B = self.transmission[i], self.speed(i, s)
            domega_M, dmotor = self.motor[i].field(
                shafts[i], s.motor, command[i], motor_switches[i]
            )
            dtransmission = transmission.field(s.theta_B, omega_B, s.transmission, switches[i])
            rates.append(
                AxisState(s.omega_L, accelerations[i], omega_B, domega_M, dmotor, dtransmission)
            )
        return tuple(rates)
