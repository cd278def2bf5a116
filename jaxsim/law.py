"""Control laws: pytrees with their own state, continuous or sampled."""

from __future__ import annotations

import abc
import functools
import operator
from collections.abc import Iterable
from typing import Any, NamedTuple

import equinox as eqx

from jaxsim.errors import InputError
from jaxsim.hybrid import Surface, Switch
from jaxsim.parameters import Parameters

Scalar = Any


class Measured(NamedTuple):
    """What a law may know of one axis at an instant. Angles rad, speeds rad/s, torque Nm."""

    reference: Scalar
    theta_L: Scalar
    omega_L: Scalar
    theta_B: Scalar
    omega_B: Scalar
    theta_M: Scalar
    omega_M: Scalar
    T_s: Scalar


def agreed(field: str, units: Iterable[str | None]) -> str | None:
    """The one unit among those declared; None where none is.

    Raises: InputError when they differ: a position law added to a torque law, say.
    """
    declared = sorted({u for u in units if u is not None})
    if len(declared) > 1:
        raise InputError(field, "must have one unit", declared, "combine laws that agree on it")
    return declared[0] if declared else None


class Control(Parameters):
    """What commands the motors: a `Law` of one axis or a `JointLaw` of all of them."""

    def __add__(self, other: Control) -> Any:
        """Sum of two: per axis where both are laws of one axis, else joint."""
        if isinstance(self, Law) and isinstance(other, Law):
            return Sum((self, other))
        return JointSum((self, other))


def total(parts: Iterable[Control]) -> Control:
    """The sum of one or more laws."""
    return functools.reduce(operator.add, parts)


class Law(Control):
    """A control law of ONE axis, written on scalars.

    Its state is a tuple of scalars, integrated with the drive (continuous) or advanced by
    Tustin's rule (inside `Sampled`); it is affine in its state for given measurements, which
    is what makes Tustin's rule exact.
    """

    command_unit: str = eqx.field(static=True, default="Nm", kw_only=True)

    @property
    def reference_unit(self) -> str | None:
        """Unit of the reference that it follows: rad or Nm; None where it looks at none."""
        return None

    def rest(self, y: Measured) -> Any:
        """Its state when it has seen the measurements y for ever."""
        return ()

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The surfaces on which it switches."""
        return ()

    def guards(self, state: Any, y: Measured) -> tuple[Scalar, ...]:
        """Guard values of its surfaces."""
        return ()

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        """Rates of its state."""
        return ()

    @abc.abstractmethod
    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        """The command to the motor, Nm or V."""


class Sum(Law):
    """The sum of several laws on the same axis, e.g. PD + switched damping; 2018 paper (20).

    Raises: InputError when they command or follow different units.
    """

    laws: tuple[Law, ...] = eqx.field(converter=tuple)
    command_unit: str = eqx.field(static=True, init=False)

    def __post_init__(self) -> None:
        self.command_unit = agreed("law.command", (v.command_unit for v in self.laws)) or "Nm"
        agreed("law.reference", (v.reference_unit for v in self.laws))

    @property
    def reference_unit(self) -> str | None:
        return agreed("law.reference", (v.reference_unit for v in self.laws))

    def rest(self, y: Measured) -> Any:
        return tuple(law.rest(y) for law in self.laws)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return tuple(s for law in self.laws for s in law.surfaces)

    def guards(self, state: Any, y: Measured) -> tuple[Scalar, ...]:
        pairs = zip(self.laws, state, strict=True)
        return tuple(value for law, s in pairs for value in law.guards(s, y))

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        own = share(switches, [law.surfaces for law in self.laws])
        return tuple(
            law.field(s, y, mine) for law, s, mine in zip(self.laws, state, own, strict=True)
        )

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        own = share(switches, [law.surfaces for law in self.laws])
        parts = [
            law.command(s, y, mine) for law, s, mine in zip(self.laws, state, own, strict=True)
        ]
        return sum(parts[1:], parts[0])


def share(flat: tuple[Any, ...], groups: Iterable[tuple[Surface, ...]]) -> tuple[Any, ...]:
    """Cut a flat tuple, one entry per surface, into one share per group of surfaces."""
    shares, at = [], 0
    for group in groups:
        shares.append(flat[at : at + len(group)])
        at += len(group)
    return tuple(shares)


class JointLaw(Control):
    """A control law of ALL axes, written on tuples of scalars, one per axis.

    Its state is a tree of scalars, treated as that of a `Law`. A law with `discrete` memory
    (differences, observers that are no linear filters) keeps it in states of rate zero and
    renews them in `on_sample`; it runs inside `Sampled` only.
    """

    @property
    @abc.abstractmethod
    def axes(self) -> int:
        """How many axes it controls."""

    @property
    @abc.abstractmethod
    def command_unit(self) -> str:
        """Nm or V."""

    @property
    def reference_unit(self) -> str | None:
        """Unit of the references that it follows: rad or Nm; None where it looks at none."""
        return None

    @property
    def discrete(self) -> bool:
        """Whether it only works inside `Sampled`."""
        return False

    def check_period(self, period: float) -> None:
        """Raises: InputError when it cannot be sampled so slowly."""

    @property
    def surfaces(self) -> tuple[tuple[Surface, ...], ...]:
        """The surfaces on which it switches, per axis."""
        return ((),) * self.axes

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        """Its state when it has seen the measurements ys for ever."""
        return ()

    def guards(self, state: Any, ys: tuple[Measured, ...]) -> tuple[tuple[Scalar, ...], ...]:
        """Guard values of its surfaces, per axis."""
        return ((),) * self.axes

    def field(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> Any:
        """Rates of its state; zero for discrete memory."""
        return ()

    def on_sample(self, state: Any, ys: tuple[Measured, ...], period: float) -> Any:
        """Its state with the discrete memory renewed at a sample."""
        return state

    @abc.abstractmethod
    def command(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> tuple[Scalar, ...]:
        """The commands to the motors, Nm or V."""


class Supervised(JointLaw):
    """A law at work, continuous, and something that sets its parameters anew at samples.

    The engine integrates `under(held)` and gives the supervisor its turn at every tick; inside
    `Sampled`, the law at work is sampled faster than the supervisor.

    Raises: InputError where it stands in a sum: it would never get its turn.
    """

    @abc.abstractmethod
    def ticks(self, dt: float) -> int:
        """Its period in integration steps. Raises: InputError when dt does not divide it."""

    @abc.abstractmethod
    def start(self, ys: tuple[Measured, ...], dt: float) -> Any:
        """Its memory before the first sample."""

    @abc.abstractmethod
    def on_tick(
        self, tick: Scalar, ys: tuple[Measured, ...], held: Any, ratios: tuple, dt: float,
        states: tuple[Any, Any],
    ) -> Any:  # fmt: skip
        """Its memory after a tick; states: of the law at work, and of the motors per axis."""

    @abc.abstractmethod
    def under(self, held: Any) -> JointLaw:
        """The law at work as it is set now."""

    def __add__(self, other: Control) -> Any:
        raise _not_alone(self)

    def check_period(self, period: float) -> None:
        self.ticks(period)


def _not_alone(law: Any) -> InputError:
    name = type(law).__name__
    fix = "put the other law into its `base`"
    return InputError("law", "must stand alone where it is sampled itself", name, fix)


class Decentral(JointLaw):
    """One law per axis, each seeing its own axis only: the joint law of a drive.

    Raises: InputError when they command or follow different units.
    """

    laws: tuple[Law, ...] = eqx.field(converter=tuple)

    def __check_init__(self) -> None:
        agreed("law.command", (v.command_unit for v in self.laws))
        agreed("law.reference", (v.reference_unit for v in self.laws))

    @property
    def axes(self) -> int:
        return len(self.laws)

    @property
    def command_unit(self) -> str:
        return self.laws[0].command_unit

    @property
    def reference_unit(self) -> str | None:
        return agreed("law.reference", (v.reference_unit for v in self.laws))

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        return tuple(law.rest(y) for law, y in zip(self.laws, ys, strict=True))

    @property
    def surfaces(self) -> tuple[tuple[Surface, ...], ...]:
        return tuple(law.surfaces for law in self.laws)

    def guards(self, state: Any, ys: tuple[Measured, ...]) -> tuple[tuple[Scalar, ...], ...]:
        return tuple(law.guards(s, y) for law, s, y in zip(self.laws, state, ys, strict=True))

    def field(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> Any:
        zipped = zip(self.laws, state, ys, switches, strict=True)
        return tuple(law.field(s, y, own) for law, s, y, own in zipped)

    def command(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> tuple[Scalar, ...]:
        zipped = zip(self.laws, state, ys, switches, strict=True)
        return tuple(law.command(s, y, own) for law, s, y, own in zipped)


class JointSum(JointLaw):
    """The sum of laws of all axes, e.g. PI torque control + positive feedback; 2014 paper (23).

    Raises: InputError when they differ in axes, or command or follow different units.
    """

    laws: tuple[JointLaw, ...] = eqx.field(converter=lambda parts: tuple(map(_joint, parts)))

    def __check_init__(self) -> None:
        for law in self.laws:
            if isinstance(law, Supervised):
                raise _not_alone(law)
        axes = [law.axes for law in self.laws]
        if len(set(axes)) != 1:
            raise InputError(
                "law", "must control the same axes in all its terms", axes,
                "wrap one law per axis in Decentral",
            )  # fmt: skip
        agreed("law.command", (v.command_unit for v in self.laws))
        agreed("law.reference", (v.reference_unit for v in self.laws))

    @property
    def axes(self) -> int:
        return self.laws[0].axes

    @property
    def command_unit(self) -> str:
        return self.laws[0].command_unit

    @property
    def reference_unit(self) -> str | None:
        return agreed("law.reference", (v.reference_unit for v in self.laws))

    @property
    def discrete(self) -> bool:
        return any(law.discrete for law in self.laws)

    def check_period(self, period: float) -> None:
        for law in self.laws:
            law.check_period(period)

    @property
    def surfaces(self) -> tuple[tuple[Surface, ...], ...]:
        return _joined([law.surfaces for law in self.laws])

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        return tuple(law.rest(ys) for law in self.laws)

    def guards(self, state: Any, ys: tuple[Measured, ...]) -> tuple[tuple[Scalar, ...], ...]:
        return _joined([v.guards(s, ys) for v, s in zip(self.laws, state, strict=True)])

    def field(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> Any:
        zipped = zip(self.laws, state, self._shares(switches), strict=True)
        return tuple(law.field(s, ys, own) for law, s, own in zipped)

    def on_sample(self, state: Any, ys: tuple[Measured, ...], period: float) -> Any:
        return tuple(v.on_sample(s, ys, period) for v, s in zip(self.laws, state, strict=True))

    def command(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> tuple[Scalar, ...]:
        zipped = zip(self.laws, state, self._shares(switches), strict=True)
        parts = [law.command(s, ys, own) for law, s, own in zipped]
        return tuple(sum(terms[1:], terms[0]) for terms in zip(*parts, strict=True))

    def _shares(self, switches: Any) -> list[Any]:
        """The switches of each law, per axis."""
        per_axis = [
            share(flat, [law.surfaces[axis] for law in self.laws])
            for axis, flat in enumerate(switches)
        ]
        return list(zip(*per_axis, strict=True))


def _joined(parts: list[Any]) -> tuple[tuple[Any, ...], ...]:
    """Per axis, what all laws have there, in their order."""
    return tuple(tuple(v for own in axis for v in own) for axis in zip(*parts, strict=True))


def _joint(law: Any) -> JointLaw:
    return Decentral((law,)) if isinstance(law, Law) else law


def as_joint_law(law: Any, axes: int) -> Any:
    """A law for all axes: joint laws as they are, a single-axis law for a one-axis drive.

    Raises: InputError when the numbers of axes differ, or for a discrete law outside `Sampled`.
    """
    joint = _joint(law)
    if isinstance(joint, JointLaw) and joint.discrete:
        raise InputError(
            "law", "must be sampled: it differentiates by differences", "a continuous law",
            "wrap it in Sampled(law, period)",
        )  # fmt: skip
    if joint.axes != axes:
        raise InputError(
            "law",
            f"must control {axes} axes, as the drive has",
            f"{joint.axes} axes",
            "wrap one law per axis in Decentral",
        )
    return joint
