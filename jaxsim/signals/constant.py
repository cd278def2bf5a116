"""A constant."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsim.parameters import parameter
from jaxsim.signal import Scalar, Signal


class Constant(Signal):
    """value for all t."""

    level: Scalar = parameter("rad or Nm", "the value", default=0.0)

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        return jnp.zeros_like(t) + self.level

    def onset(self) -> Scalar:
        return jnp.asarray(jnp.inf)
