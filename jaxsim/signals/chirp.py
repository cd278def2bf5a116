"""A linear chirp."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter
from jaxsim.signal import Scalar, Signal
from jaxsim.sincos import sincos


class Chirp(Signal):
    """amplitude*sin(2 pi (f0 t + (f1 - f0) t^2 / (2 duration))); the frequency stays f1 after."""

    amplitude: Scalar = parameter("rad or Nm", "amplitude")
    f0: Scalar = parameter("Hz", "frequency at t = 0", rule=NON_NEGATIVE)
    f1: Scalar = parameter("Hz", "frequency at the end", rule=NON_NEGATIVE)
    duration: Scalar = parameter("s", "time of the sweep", rule=POSITIVE)

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        sweep = jnp.minimum(t, self.duration)
        cycles = self.f0 * sweep + 0.5 * (self.f1 - self.f0) * sweep**2 / self.duration
        cycles = cycles + self.f1 * (t - sweep)
        return self.amplitude * sincos(2.0 * jnp.pi * cycles)[0]
