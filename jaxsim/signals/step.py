"""A step, and a step through a first-order low-pass."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsim.parameters import POSITIVE, parameter
from jaxsim.signal import Scalar, Signal


class Step(Signal):
    """0 before `at`, `size` from `at` on."""

    size: Scalar = parameter("rad or Nm", "height of the step")
    at: Scalar = parameter("s", "time of the step", default=0.0)

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        return jnp.where(inside >= self.at, self.size, jnp.zeros_like(t))

    def next_break(self, t: Scalar) -> Scalar:
        return jnp.where(self.at > t, self.at, jnp.full_like(t, jnp.inf))

    @property
    def breaks(self) -> int:
        return 1

    def onset(self) -> Scalar:
        return jnp.asarray(self.at)


class FilteredStep(Step):
    """size*(1 - exp(-2 pi cutoff (t - at))) from `at` on: a step through a first-order filter.

    The closed form, without a state. A control law that has the filter in it (and so in its
    sampled form, too) is `jaxsim.laws.prefilter.Prefilter`.
    """

    cutoff: Scalar = parameter("Hz", "cut-off of the low-pass", rule=POSITIVE, default=20.0)

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        after = inside >= self.at
        rise = -jnp.expm1(-2.0 * jnp.pi * self.cutoff * jnp.where(after, t - self.at, 0.0))
        return jnp.where(after, self.size * rise, 0.0)
