"""Control laws: pytrees with their own state, continuous or sampled."""

from __future__ import annotations

import abc
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


class Law(Parameters):
    """A control law of ONE axis, written on scalars.

    Its state is a tuple of scalars, integrated with the drive (continuous) or advanced by
    Tustin's rule (inside `Sampled`); it is affine in its state for given measurements, which
    is what makes Tustin's rule exact.
    """

    command_unit: str = eqx.field(static=True, default="Nm", kw_only=True)

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

    def __add__(self, other: Law) -> Sum:
        return Sum((self, other))


class Sum(Law):
    """The sum of several laws on the same axis, e.g. PD + switched damping; 2018 paper (20)."""

    laws: tuple[Law, ...] = eqx.field(converter=tuple)

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


class Decentral(eqx.Module):
    """One law per axis, each seeing its own axis only: the joint law of a drive."""

    laws: tuple[Law, ...] = eqx.field(converter=tuple)

    @property
    def axes(self) -> int:
        return len(self.laws)

    @property
    def command_unit(self) -> str:
        return self.laws[0].command_unit

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


def as_joint_law(law: Any, axes: int) -> Any:
    """A law for all axes: joint laws as they are, a single-axis law for a one-axis drive.

    Raises: InputError when the numbers of axes differ.
    """
    joint = Decentral((law,)) if isinstance(law, Law) else law
    if joint.axes != axes:
        raise InputError(
            "law", f"must control {axes} axes, as the drive has", f"{joint.axes} axes",
            "wrap one law per axis in Decentral",
        )
    return joint
