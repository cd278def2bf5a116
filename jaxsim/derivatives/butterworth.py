"""Load derivatives from a Butterworth filter on the load speed."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxsim.derivative import Derivatives, Motion
from jaxsim.errors import InputError
from jaxsim.law import Measured, Scalar
from jaxsim.parameters import POSITIVE, is_concrete, parameter


def _chain(order: int, position: int) -> float:
    """Coefficient k of the normalised Butterworth polynomial s^n + ... + 1 (ascending)."""
    value = 1.0
    for k in range(1, position + 1):
        value *= math.cos((k - 1) * math.pi / (2 * order)) / math.sin(k * math.pi / (2 * order))
    return value


class Butterworth(Derivatives):
    """velocity = B(s) omega_L, acceleration = s B(s) omega_L, jerk = s^2 B(s) omega_L.

    B is the low-pass of the given order and cut-off; its derivatives are its own states, so
    nothing is differenced and, sampled, Tustin's rule makes the digital filter. order >= 2, for a
    jerk that exists. Source: 2014 paper, section 4 (order 3, 50 Hz); with the differences of its
    firmware: `ButterworthDifferences`.

    Raises: InputError for an order < 2.
    """

    cutoff: Scalar = parameter("Hz", "-3 dB frequency", rule=POSITIVE, default=50.0)
    order: int = eqx.field(static=True, default=3)

    def __check_init__(self) -> None:
        if self.order < 2:
            raise InputError("Butterworth.order", "must be >= 2", self.order, "e.g. 3")

    def check_period(self, period: float) -> None:
        nyquist = 0.5 / period
        if is_concrete(self.cutoff) and np.any(np.asarray(self.cutoff) >= nyquist):
            raise InputError(
                "Butterworth.cutoff", f"must be below the Nyquist frequency {nyquist:g} Hz",
                np.asarray(self.cutoff).tolist(), "lower it or sample faster",
            )  # fmt: skip

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        return tuple((y.omega_L,) + (0.0 * y.omega_L,) * (self.order - 1) for y in ys)

    def field(self, state: Any, ys: tuple[Measured, ...]) -> Any:
        return tuple((*v[1:], self._highest(v, y)) for v, y in zip(state, ys, strict=True))

    def _highest(self, v: Any, y: Measured) -> Scalar:
        """The order-th derivative of the filtered speed."""
        w = 2.0 * jnp.pi * self.cutoff
        rest = sum(_chain(self.order, k) * w ** (self.order - k) * d for k, d in enumerate(v))
        return w**self.order * y.omega_L - rest

    def motion(self, state: Any, ys: tuple[Measured, ...]) -> tuple[Motion, ...]:
        return tuple(Motion(*(*v, self._highest(v, y))[:3]) for v, y in zip(state, ys, strict=True))


class ButterworthDifferences(Derivatives):
    """velocity from a Butterworth filter, acceleration and jerk by backward differences of it.

    a_k = (v_k - v_{k-1})/period, j_k = (a_k - a_{k-1})/period. Source: 2014 paper, section 4.
    """

    filter: Butterworth = eqx.field(default_factory=Butterworth)

    @property
    def discrete(self) -> bool:
        return True

    def check_period(self, period: float) -> None:
        self.filter.check_period(period)

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        memory = tuple(Motion(y.omega_L, 0.0 * y.omega_L, 0.0 * y.omega_L) for y in ys)
        return self.filter.rest(ys), memory

    def field(self, state: Any, ys: tuple[Measured, ...]) -> Any:
        still = tuple(Motion(*(jnp.zeros_like(v) for v in last)) for last in state[1])
        return self.filter.field(state[0], ys), still

    def on_sample(self, state: Any, ys: tuple[Measured, ...], period: float) -> Any:
        memory = []
        for now, last in zip(state[0], state[1], strict=True):
            acceleration = (now[0] - last.velocity) / period
            jerk = (acceleration - last.acceleration) / period
            memory.append(Motion(now[0], acceleration, jerk))
        return state[0], tuple(memory)

    def motion(self, state: Any, ys: tuple[Measured, ...]) -> tuple[Motion, ...]:
        return state[1]
