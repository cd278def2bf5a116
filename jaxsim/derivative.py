"""Where a law takes the velocity, acceleration and jerk of the load from."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

from jaxsim.law import Measured, Scalar
from jaxsim.parameters import Parameters


class Motion(NamedTuple):
    """Derivatives of theta_L of one axis: rad/s, rad/s^2, rad/s^3."""

    velocity: Scalar
    acceleration: Scalar
    jerk: Scalar


class Derivatives(Parameters):
    """A source of load derivatives for all axes, out of measurements only.

    Its state is a tree of scalars, treated as that of a `JointLaw` (see there for `discrete`).
    """

    @property
    def axes(self) -> int | None:
        """How many axes it is for; None for any number."""
        return None

    @property
    def discrete(self) -> bool:
        """Whether it only works inside `Sampled`."""
        return False

    def check_period(self, period: float) -> None:
        """Raises: InputError when it cannot be sampled so slowly."""

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        """Its state when it has seen the measurements ys for ever."""
        return ()

    def field(self, state: Any, ys: tuple[Measured, ...]) -> Any:
        """Rates of its state; zero for discrete memory."""
        return ()

    def on_sample(self, state: Any, ys: tuple[Measured, ...], period: float) -> Any:
        """Its state with the discrete memory renewed at a sample."""
        return state

    @abc.abstractmethod
    def motion(self, state: Any, ys: tuple[Measured, ...]) -> tuple[Motion, ...]:
        """The derivatives, per axis."""
