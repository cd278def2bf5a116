"""A sum of sines."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError
from jaxsim.parameters import NON_NEGATIVE, parameter
from jaxsim.signal import Scalar, Signal
from jaxsim.sincos import sincos


class Multisine(Signal):
    """sum_k amplitudes[k]*sin(2 pi frequencies[k] t + phases[k]).

    Raises: InputError when the three arrays differ in length.
    """

    amplitudes: Scalar = parameter("rad or Nm", "amplitude of each sine", ndim=1)
    frequencies: Scalar = parameter("Hz", "frequency of each", rule=NON_NEGATIVE, ndim=1)
    phases: Scalar = parameter("rad", "phase of each", ndim=1)

    def __check_init__(self) -> None:
        lengths = [np.shape(v)[-1:] for v in (self.amplitudes, self.frequencies, self.phases)]
        if len(set(lengths)) != 1 or lengths[0] == ():
            raise InputError(
                "Multisine",
                "amplitudes, frequencies, phases must be lists of one length",
                lengths,
                "give one of each per sine",
            )

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        angles = 2.0 * jnp.pi * self.frequencies * t[..., None] + self.phases
        return jnp.sum(self.amplitudes * sincos(angles)[0], axis=-1)
