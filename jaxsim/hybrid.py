"""Switching surfaces and how a run treats them: located exactly, smoothed, or not at all."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxsim.errors import InputError

Scalar = Any

# Natural sizes of guard quantities; the tolerance of a guard is a multiple of machine precision
# times these. Below it a sign is rounding, and toggling on it would never end (chatter at rest).
SCALES = {"rad": 1e-3, "rad/s": 1.0, "Nm": 1.0, "V": 1.0, "s": 1e-3}
_ROUNDING = 1e4  # units of machine precision: 2e-15 rad and 2e-12 rad/s in float64


class Surface(NamedTuple):
    """A switching surface: where its guard value is zero. The carried mode is the guard's sign."""

    name: str
    unit: str

    def tolerance(self, dtype: Any) -> float:
        return _ROUNDING * float(jnp.finfo(dtype).eps) * SCALES[self.unit]


class Switch(NamedTuple):
    """What a field may know of a guard: never the guard's value, only these.

    sign: -1, 0, +1 (0 only while the guard has been identically zero since the start; smoothed
    runs have values between); on: 1.0 where sign >= 0, hard in every mode (equality counts as
    on); gate: 1.0 or 0.0 like `on`, but smooth in smoothed runs; smooth: whether this is one.
    """

    sign: Scalar
    on: Scalar
    gate: Scalar
    smooth: bool = False

    def agrees(self, other: Switch) -> Scalar:
        """1.0 where the product of two signs is >= 0, else 0.0; smoothed on the negative side."""
        product = self.sign * other.sign
        if self.smooth:
            return quintic(1.0 + jnp.minimum(product, 0.0))
        return jnp.where(product >= 0.0, jnp.ones_like(product), 0.0)


def quintic(u: Scalar) -> Scalar:
    """The C2 step 6u^5 - 15u^4 + 10u^3, clipped to 0 and 1 outside [0, 1]."""
    u = jnp.clip(u, 0.0, 1.0)
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


def _hard(sign: Scalar, dtype: Any) -> Switch:
    on = (sign >= 0.0).astype(dtype)
    return Switch(sign, on, on)


class Deadzone(eqx.Module):
    """How contact and switching surfaces are treated in a run."""

    @property
    @abc.abstractmethod
    def located(self) -> bool:
        """Whether events are located inside the steps."""

    @property
    def rough(self) -> bool:
        """Whether metrics read the ends of steps alone."""
        return False

    @abc.abstractmethod
    def switch(self, surface: Surface, value: Scalar, mode: Scalar) -> Switch:
        """The switch of a surface, given its guard's present value and the carried mode."""


class Exact(Deadzone):
    """Events located inside the fixed step: right values AND right gradients.

    max_events is the least number of events that one run has room for (3 micro-steps each on top
    of the ticks, rounded up); None gives 40 plus one per 20 ticks. A run that needs more says so
    in its status.
    """

    max_events: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if self.max_events is not None and self.max_events < 0:
            raise InputError("max_events", "must be >= 0", self.max_events, "give a count")

    @property
    def located(self) -> bool:
        return True

    def switch(self, surface: Surface, value: Scalar, mode: Scalar) -> Switch:
        return _hard(mode, jnp.asarray(value).dtype)


class Plain(Deadzone):
    """No location: signs are read at every stage. For comparison and sampled real-time use.

    Values converge erratically, O(dt); gradients are WRONG at every dt: docs/concepts/gradients.md.
    So metrics do not look inside steps either: peaks are those of the ends, O(dt^2) less, times of
    passages the middles of their steps.
    """

    @property
    def located(self) -> bool:
        return False

    @property
    def rough(self) -> bool:
        return True

    def switch(self, surface: Surface, value: Scalar, mode: Scalar) -> Switch:
        value = jax.lax.stop_gradient(jnp.asarray(value))
        on = (value >= 0.0).astype(value.dtype)  # without the sign, which few ask for
        return Switch(jnp.sign(value), on, on)


class Smoothed(Deadzone):
    """The spring stays a kink (relu); damping gates are C2 over +- width, laws one-sided.

    width: half-width of the contact gate, rad. speed_width: half-width of sign(speed), rad/s.
    A homotopy for optimisers, never the truth: finish on `Exact`.
    """

    width: float = eqx.field(static=True, default=1e-3)
    speed_width: float = eqx.field(static=True, default=0.5)

    def __check_init__(self) -> None:
        for name in ("width", "speed_width"):
            if not getattr(self, name) > 0.0:
                raise InputError(name, "must be > 0", getattr(self, name), "give a width")

    @property
    def located(self) -> bool:
        return False

    def switch(self, surface: Surface, value: Scalar, mode: Scalar) -> Switch:
        value = jnp.asarray(value)
        width = self.width if surface.unit == "rad" else self.speed_width
        gate = quintic(0.5 * (1.0 + value / width))
        return Switch(2.0 * gate - 1.0, (value >= 0.0).astype(value.dtype), gate, smooth=True)


def switch_all(
    deadzone: Deadzone,
    surfaces: tuple[tuple[Surface, ...], ...],
    values: tuple[tuple[Scalar, ...], ...],
    modes: tuple[tuple[Scalar, ...], ...] | None,
) -> tuple[tuple[Switch, ...], ...]:
    """The switches of several owners of surfaces; without modes where none are carried."""
    modes = values if modes is None else modes
    return tuple(
        tuple(deadzone.switch(s, v, m) for s, v, m in zip(*own, strict=True))
        for own in zip(surfaces, values, modes, strict=True)
    )
