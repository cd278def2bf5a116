"""Signals: references and disturbances as pytrees, piecewise smooth in time."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxsim.parameters import Parameters

Scalar = Any


class Signal(Parameters):
    """A function of time that is smooth between its breakpoints.

    `value(t, inside)` takes the time and any instant strictly inside the present step: the
    instant decides the piece, so that a step ending ON a breakpoint does not see what comes
    after it. Runs end their steps on breakpoints, so every piece is integrated at full order.
    """

    @abc.abstractmethod
    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        """The value at t (s) on the piece that holds `inside` (s)."""

    def next_break(self, t: Scalar) -> Scalar:
        """The first breakpoint after t, s; infinity if there is none."""
        return jnp.full_like(t, jnp.inf)

    @property
    def breaks(self) -> int:
        """How many breakpoints it has at most (room for them is reserved in a run)."""
        return 0

    def onset(self) -> Scalar:
        """When it first departs from its initial value, s; infinity if it never does."""
        return jnp.asarray(0.0)

    def __add__(self, other: Signal) -> Sum:
        return Sum((self, other))


class Sum(Signal):
    """The sum of several signals."""

    parts: tuple[Signal, ...] = eqx.field(converter=tuple)

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        return sum((p.value(t, inside) for p in self.parts[1:]), self.parts[0].value(t, inside))

    def next_break(self, t: Scalar) -> Scalar:
        first = self.parts[0].next_break(t)
        for part in self.parts[1:]:
            first = jnp.minimum(first, part.next_break(t))
        return first

    @property
    def breaks(self) -> int:
        return sum(p.breaks for p in self.parts)

    def onset(self) -> Scalar:
        first = self.parts[0].onset()
        for part in self.parts[1:]:
            first = jnp.minimum(first, part.onset())
        return first
