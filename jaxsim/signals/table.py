"""A recorded table."""

from __future__ import annotations

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError
from jaxsim.parameters import is_concrete, parameter
from jaxsim.signal import Scalar, Signal


class Table(Signal):
    """Samples `values` at `times`: held until the next sample, or joined by straight lines.

    Constant before the first and after the last sample. Every sample is a breakpoint.

    Raises: InputError for fewer than two samples, different lengths, or times not increasing.
    """

    times: Scalar = parameter("s", "sample times, increasing", ndim=1)
    values: Scalar = parameter("rad or Nm", "samples", ndim=1)
    between: Literal["hold", "linear"] = eqx.field(static=True, default="linear")

    def __check_init__(self) -> None:
        if self.between not in ("hold", "linear"):
            raise InputError("Table.between", "must be hold or linear", self.between, "choose")
        if np.shape(self.times)[-1:] != np.shape(self.values)[-1:] or np.shape(self.times)[-1] < 2:
            raise InputError(
                "Table",
                "times and values must be lists of one length, at least 2",
                (np.shape(self.times), np.shape(self.values)),
                "check the columns",
            )
        if is_concrete(self.times) and not np.all(np.diff(np.asarray(self.times, float)) > 0.0):
            at = int(np.argmin(np.diff(np.asarray(self.times, float))))
            raise InputError(
                "Table.times", "must increase", f"not after sample {at}", "sort or repair the log"
            )

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        last = self.times.shape[-1] - 1
        piece = jnp.searchsorted(self.times, inside, side="right") - 1
        left = jnp.clip(piece, 0, last)
        if self.between == "hold":
            return jnp.asarray(self.values)[left]
        right = jnp.clip(piece + 1, 0, last)
        times, values = jnp.asarray(self.times), jnp.asarray(self.values)
        width = jnp.where(right > left, times[right] - times[left], 1.0)
        share = jnp.where(right > left, (t - times[left]) / width, 0.0)
        return values[left] + share * (values[right] - values[left])

    def next_break(self, t: Scalar) -> Scalar:
        following = jnp.searchsorted(self.times, t, side="right")
        inside = following < self.times.shape[-1]
        times = jnp.asarray(self.times)
        return jnp.where(inside, times[jnp.minimum(following, times.shape[-1] - 1)], jnp.inf)

    @property
    def breaks(self) -> int:
        return self.times.shape[-1]

    def onset(self) -> Scalar:
        return jnp.asarray(self.times)[0]
