"""What a drive is asked to do: reference, disturbances, start and duration."""

from __future__ import annotations

import math

import equinox as eqx

from jaxsim.errors import InputError
from jaxsim.parameters import Parameters, parameter
from jaxsim.signal import Scalar, Signal
from jaxsim.signals.constant import Constant


class Start(Parameters):
    """Where an axis starts; at rest in mid-gap by default."""

    theta_L: Scalar = parameter("rad", "load angle", default=0.0)
    omega_L: Scalar = parameter("rad/s", "load speed", default=0.0)
    theta_B: Scalar = parameter("rad", "deflection theta_M/N - theta_L", default=0.0)
    omega_B: Scalar = parameter("rad/s", "deflection speed omega_M/N - omega_L", default=0.0)


def _per_axis(value: object) -> tuple:
    return value if isinstance(value, tuple) else (value,)


class Scenario(eqx.Module):
    """reference, load_torque, start: one per axis (a single one is taken as one axis).

    reference: of the load angle, rad (position laws) or the joint torque, Nm (torque laws).
    load_torque: d_L, Nm on the load. duration: s, static (it fixes the number of steps).

    Raises: InputError for a duration that is not positive or unequal numbers of axes.
    """

    reference: tuple[Signal, ...] = eqx.field(converter=_per_axis, default_factory=Constant)
    load_torque: tuple[Signal, ...] = eqx.field(converter=_per_axis, default_factory=Constant)
    start: tuple[Start, ...] = eqx.field(converter=_per_axis, default_factory=Start)
    duration: float = eqx.field(static=True, default=0.3)

    def __check_init__(self) -> None:
        if not 0.0 < self.duration < float("inf"):
            raise InputError("scenario.duration", "must be > 0 s", self.duration, "e.g. 0.3")
        counts = {n: len(getattr(self, n)) for n in ("reference", "load_torque", "start")}
        if len(set(counts.values())) != 1:
            raise InputError("scenario", "must have one signal and start per axis", counts, "match")

    @property
    def axes(self) -> int:
        return len(self.reference)

    def signals(self) -> tuple[Signal, ...]:
        return (*self.reference, *self.load_torque)

    def ticks(self, dt: float) -> int:
        """The number of integration steps of dt seconds.

        Raises: InputError unless 0 < dt < 1 s and dt divides the duration.
        """
        if not 0.0 < dt < 1.0:
            raise InputError("dt", "must be > 0 s and < 1 s", dt, "e.g. 2e-4")
        count = round(self.duration / dt)
        if abs(count * dt - self.duration) > 1e-6 * dt:
            rule = f"must divide the duration {self.duration:g} s"
            raise InputError("dt", rule, dt, f"e.g. {_fitting(self.duration, dt):.9g}")
        return count


def _fitting(duration: float, dt: float) -> float:
    """The largest number of two digits, at most dt, that divides a duration; s."""
    decade = math.floor(math.log10(min(dt, duration)))
    for digits in range(99, 9, -1):
        short = float(f"{digits}e{decade - 1}")
        count = round(duration / short)
        if short <= dt and count > 0 and abs(count * short - duration) <= 1e-6 * short:
            return short
    return duration / math.ceil(duration / dt)
