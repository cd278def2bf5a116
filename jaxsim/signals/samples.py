"""Equally spaced samples, found by arithmetic instead of a search."""

from __future__ import annotations

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError
from jaxsim.parameters import POSITIVE, parameter
from jaxsim.signal import Scalar, Signal


class Samples(Signal):
    """`values` at 0, period, 2 period, ...: held until the next one, or joined by straight lines.

    Constant after the last sample. Every sample is a breakpoint, unless `on_ticks` says that the
    period is a multiple of the integration step: steps end there anyway, and a run need not
    reserve room for them. A `Table` of the same samples gives the same run.

    Raises: InputError for fewer than two samples.
    """

    values: Scalar = parameter("rad or Nm or V", "samples", ndim=1)
    period: Scalar = parameter("s", "time between two samples", rule=POSITIVE)
    between: Literal["hold", "linear"] = eqx.field(static=True, default="linear")
    on_ticks: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        if self.between not in ("hold", "linear"):
            raise InputError("Samples.between", "must be hold or linear", self.between, "choose")
        if np.shape(self.values)[-1:] < (2,):
            raise InputError("Samples.values", "must be at least 2", np.shape(self.values), "add")

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        values = jnp.asarray(self.values)
        last = values.shape[-1] - 1
        left = jnp.clip(jnp.floor(inside / self.period), 0.0, 1.0 * last)
        index = left.astype(jnp.int32)
        if self.between == "hold":
            return values[index]
        share = jnp.where(left < last, t / self.period - left, 0.0)
        share = jnp.where(inside < 0.0, 0.0, share)
        right = jnp.minimum(index + 1, last)
        return values[index] + share * (values[right] - values[index])

    def next_break(self, t: Scalar) -> Scalar:
        if self.on_ticks:
            return jnp.full_like(t, jnp.inf)
        following = jnp.floor(t / self.period) + 1.0
        last = 1.0 * (np.shape(self.values)[-1] - 1)
        return jnp.where(following <= last, following * self.period, jnp.inf)

    @property
    def breaks(self) -> int:
        return 0 if self.on_ticks else np.shape(self.values)[-1]
