"""The closed loop as ONE hybrid system: drive, law and scenario behind field, guards, outputs."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxsim.drive import AxisState, Drive
from jaxsim.errors import InputError
from jaxsim.hybrid import Deadzone, Surface, switch_all
from jaxsim.law import Measured, Scalar, Supervised, as_joint_law, share
from jaxsim.parameters import all_valid
from jaxsim.sampled import Sampled
from jaxsim.scenario import Scenario

UNITS = {
    "reference": "rad or Nm",
    "theta_L": "rad",
    "omega_L": "rad/s",
    "theta_B": "rad",
    "omega_B": "rad/s",
    "theta_M": "rad",
    "omega_M": "rad/s",
    "T_s": "Nm",
    "T_M": "Nm",
    "command": "Nm or V",
    "d_L": "Nm",
    "P_loss": "W",
    "contact": "1",
}


class Outputs(NamedTuple):
    """All signals of one axis, in this order; units: `ClosedLoop.units`."""

    reference: Scalar
    theta_L: Scalar
    omega_L: Scalar
    theta_B: Scalar
    omega_B: Scalar
    theta_M: Scalar
    omega_M: Scalar
    T_s: Scalar
    T_M: Scalar
    command: Scalar
    d_L: Scalar
    P_loss: Scalar
    contact: Scalar


class State(NamedTuple):
    """What is integrated: the drive's axes and, for a continuous law, the law's state."""

    drive: tuple[AxisState, ...]
    law: Any


class _View(NamedTuple):
    """What field and outputs look at: measurements, commands, and switches per axis."""

    ys: tuple[Measured, ...]
    commands: tuple[Scalar, ...]
    transmission: Any
    motor: Any
    law: Any


class When(NamedTuple):
    """An instant t and any instant inside the present piece of the signals, s."""

    t: Scalar
    inside: Scalar


class ClosedLoop(eqx.Module):
    """Drive + law + scenario, seen by the engine as field, guards and outputs.

    Modes are carried by the engine as a flat tuple of signs, one per guard, drive first.
    """

    drive: Drive
    law: Any
    scenario: Scenario
    deadzone: Deadzone
    dt: float = eqx.field(static=True)

    def __init__(
        self, drive: Drive, law: Any, scenario: Scenario, deadzone: Deadzone, dt: float
    ) -> None:
        self.drive = drive
        self.law = as_joint_law(law, drive.axes)
        self.scenario, self.deadzone, self.dt = scenario, deadzone, dt
        if scenario.axes != drive.axes:
            raise InputError(
                "scenario",
                f"must have {drive.axes} axes, as the drive",
                scenario.axes,
                "give one signal per axis",
            )
        if self.law.command_unit != drive.command_unit:
            raise InputError(
                "law",
                f"must command {drive.command_unit}, as the motor takes",
                self.law.command_unit,
                "choose a law for this motor",
            )
        if self.clocked:
            self.law.ticks(dt)

    @property
    def located(self) -> bool:
        """Whether there are surfaces to land on."""
        return self.deadzone.located and bool(self.surfaces)

    @property
    def sampled(self) -> bool:
        """Whether the command is held, and no state of a law integrated."""
        return isinstance(self.law, Sampled)

    @property
    def clocked(self) -> bool:
        """Whether the law has a turn at ticks."""
        return isinstance(self.law, Sampled | Supervised)

    def _at_work(self, held: Any) -> Any:
        """The law that is integrated with the drive."""
        return self.law.under(held) if isinstance(self.law, Supervised) else self.law

    @property
    def ratios(self) -> tuple[Scalar, ...]:
        return tuple(t.ratio for t in self.drive.transmission)

    def valid(self) -> Scalar:
        """Whether every parameter obeys its rule; traceable, one value per batch member."""
        return all_valid((self.drive, self.law, self.scenario))

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """All surfaces whose modes the engine carries, drive first, then law."""
        return tuple(s for group in self._groups for s in group)

    @property
    def _groups(self) -> list[tuple[Surface, ...]]:
        """The surfaces by owner: transmissions, motors, then (continuous) laws, axis by axis."""
        groups = [part.surfaces for part in (*self.drive.transmission, *self.drive.motor)]
        return groups if self.sampled else groups + list(self.law.surfaces)

    @property
    def units(self) -> dict[str, str]:
        """The unit of every signal of this loop: what it is asked for and what it commands, too."""
        reference = self.law.reference_unit or UNITS["reference"]
        own = {"reference": reference, "command": self.law.command_unit}
        return UNITS | own

    def surface_names(self) -> tuple[str, ...]:
        """Names of the surfaces, with the axis where there are several axes."""
        axes = self.drive.axes
        return tuple(
            s.name if axes == 1 else f"{s.name}[{i % axes}]"
            for i, group in enumerate(self._groups)
            for s in group
        )

    def start(self) -> tuple[State, Any]:
        """State and sampled-law state before anything has happened (references before t = 0)."""
        drive = tuple(self._axis_start(i, s) for i, s in enumerate(self.scenario.start))
        zero = jnp.zeros_like(drive[0].theta_L)
        signs = tuple(tuple(zero for _ in t.surfaces) for t in self.drive.transmission)
        signs = jax.tree.map(jnp.sign, self.drive.guards(drive, signs))
        ys = self._measure(When(zero, zero - 1.0), drive, self._drive_switches(drive, signs))
        held = self.law.start(ys, self.dt) if self.clocked else ()
        return State(drive, () if self.sampled else self.law.rest(ys)), held

    def _axis_start(self, axis: int, start: Any) -> AxisState:
        ratio = self.ratios[axis]
        omega_M = ratio * (start.omega_L + start.omega_B)
        values = [start.theta_L, start.omega_L, start.theta_B, omega_M]
        transmission = self.drive.transmission[axis].rest(start.theta_B)
        extras = self.drive.motor[axis].rest(), transmission
        dtype = jnp.asarray(start.theta_L).dtype
        return AxisState(*jax.tree.map(lambda v: jnp.asarray(v, dtype), [*values, *extras]))

    def _drive_switches(self, drive: tuple[AxisState, ...], modes: Any) -> Any:
        surfaces = tuple(t.surfaces for t in self.drive.transmission)
        return switch_all(self.deadzone, surfaces, self.drive.guards(drive, modes), modes)

    def _measure(
        self, when: When, drive: tuple[AxisState, ...], switches: Any
    ) -> tuple[Measured, ...]:
        torques = self.drive.joint_torques(drive, switches)
        return tuple(
            Measured(
                reference=self.scenario.reference[i].value(*when),
                theta_L=s.theta_L,
                omega_L=s.omega_L,
                theta_B=s.theta_B,
                omega_B=self.drive.speed(i, s),
                theta_M=self.ratios[i] * (s.theta_L + s.theta_B),
                omega_M=s.omega_M,
                T_s=torques[i],
            )
            for i, s in enumerate(drive)
        )

    def _look(self, when: When, x: State, modes: tuple[Scalar, ...], held: Any) -> _View:
        """Measurements, commands and switches at an instant, in the carried modes."""
        shares = share(modes, self._groups)
        axes = self.drive.axes
        transmission = self._drive_switches(x.drive, shares[:axes])
        ys = self._measure(when, x.drive, transmission)
        law, commands = (), held.command if self.sampled else ()
        if not self.sampled:
            own = self._at_work(held)
            guards = own.guards(x.law, ys)
            law = switch_all(self.deadzone, own.surfaces, guards, shares[2 * axes :])
            commands = own.command(x.law, ys, law)
        surfaces = tuple(m.surfaces for m in self.drive.motor)
        own = shares[axes : 2 * axes]
        motor = switch_all(self.deadzone, surfaces, self._motor_guards(x, ys, commands, own), own)
        return _View(ys, commands, transmission, motor, law)

    def _motor_guards(self, x: State, ys: tuple[Measured, ...], commands: Any, modes: Any) -> Any:
        return self.drive.motor_guards(x.drive, tuple(y.T_s for y in ys), commands, modes)

    def guards(
        self, when: When, x: State, modes: tuple[Scalar, ...], held: Any
    ) -> tuple[Scalar, ...]:
        """Guard values of all `surfaces` at an instant."""
        axes, shares = self.drive.axes, share(modes, self._groups)
        values = self.drive.guards(x.drive, shares[:axes])
        ys = self._measure(when, x.drive, self._drive_switches(x.drive, shares[:axes]))
        # Only motors' guards need the command: a law with a model of the load is dear to trace.
        if any(m.surfaces for m in self.drive.motor):
            commands = self._look(when, x, modes, held).commands
            values += self._motor_guards(x, ys, commands, shares[axes : 2 * axes])
        else:
            values += ((),) * axes
        if not self.sampled:
            values += self._at_work(held).guards(x.law, ys)
        return tuple(v for own in values for v in own)

    def field(self, when: When, x: State, modes: tuple[Scalar, ...], held: Any) -> State:
        """Rates of everything that is integrated, in the carried modes."""
        view = self._look(when, x, modes, held)
        loads = tuple(d.value(*when) for d in self.scenario.load_torque)
        rates = self.drive.field(x.drive, view.commands, loads, view.transmission, view.motor)
        law = () if self.sampled else self._at_work(held).field(x.law, view.ys, view.law)
        return State(rates, law)

    def definite(self, x: State, rates: State, h: Scalar) -> Scalar:
        """Whether the load's mass matrix is positive definite wherever a step of h from x looks."""
        definite = jnp.asarray(True)
        for length, bend in ((0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (1.0, 0.5)):
            angles = tuple(
                s.theta_L + length * h * (s.omega_L + bend * h * rate.omega_L)
                for s, rate in zip(x.drive, rates.drive, strict=True)
            )
            definite = definite & self.drive.load.definite(angles)
        return definite

    def outputs(
        self, when: When, x: State, modes: tuple[Scalar, ...], held: Any
    ) -> tuple[Outputs, ...]:
        """All signals, per axis."""
        view = self._look(when, x, modes, held)
        return tuple(
            self._axis_outputs(i, when, x.drive[i], y, view.commands[i], view.transmission[i])
            for i, y in enumerate(view.ys)
        )

    def _axis_outputs(
        self, axis: int, when: When, s: AxisState, y: Measured, command: Scalar, switches: Any
    ) -> Outputs:
        transmission = self.drive.transmission[axis]
        return Outputs(
            *y,
            T_M=self.drive.motor[axis].torque(s.motor, command),
            command=command,
            d_L=self.scenario.load_torque[axis].value(*when),
            P_loss=transmission.loss(s.theta_B, y.omega_B, s.transmission, switches),
            contact=transmission.contact(switches),
        )

    def on_tick(
        self, tick: Scalar, when: When, x: State, modes: tuple[Scalar, ...], held: Any
    ) -> Any:
        """The turn of a sampled law or of a supervisor; nothing for continuous laws."""
        if not self.clocked:
            return held
        ys = self._look(when, x, modes, held).ys
        if self.sampled:
            return self.law.on_tick(tick, ys, held, self.ratios, self.dt)
        motors = tuple(s.motor for s in x.drive)
        return self.law.on_tick(tick, ys, held, self.ratios, self.dt, (x.law, motors))

    def next_break(self, t: Scalar) -> Scalar:
        """The next breakpoint of any signal after t, s."""
        following = jnp.full_like(t, jnp.inf)
        for signal in self.scenario.signals():
            following = jnp.minimum(following, signal.next_break(t))
        return following

    @property
    def breaks(self) -> int:
        return sum(s.breaks for s in self.scenario.signals())
