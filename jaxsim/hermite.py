"""Cubic Hermite interpolation of one accepted step, on the fraction s in [0, 1]."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxsim.rarely import rarely

Scalar = Any

_POLISH = 7  # safeguarded Newton iterations; a cubic on a bracket converges to rounding in 5-6


class Cubic(NamedTuple):
    """c(s) = c0 + c1 s + c2 s^2 + c3 s^3."""

    c0: Scalar
    c1: Scalar
    c2: Scalar
    c3: Scalar

    def value(self, s: Scalar) -> Scalar:
        return self.c0 + s * (self.c1 + s * (self.c2 + s * self.c3))

    def slope(self, s: Scalar) -> Scalar:
        return self.c1 + s * (2.0 * self.c2 + s * (3.0 * self.c3))

    def area(self, s: Scalar) -> Scalar:
        """The integral of c from 0 to s."""
        third, quarter = (1.0 / 3.0) * self.c2, 0.25 * self.c3
        return s * (self.c0 + s * (0.5 * self.c1 + s * (third + s * quarter)))

    def moment(self, s: Scalar) -> Scalar:
        """The integral of s c(s) from 0 to s."""
        rest = (1.0 / 3.0) * self.c1 + s * (0.25 * self.c2 + s * (0.2 * self.c3))
        return s * s * (0.5 * self.c0 + s * rest)

    def scaled(self, factor: Scalar) -> Cubic:
        return Cubic(*(factor * c for c in self))

    def shifted(self, offset: Scalar) -> Cubic:
        return self._replace(c0=self.c0 + offset)


class Segment(NamedTuple):
    """A signal over a step of length h: values, and rates per second, at both ends.

    What is looked at rarely takes this form, not the cubic's: a branch that is not taken then
    costs no arithmetic, and hardly any memory.
    """

    start: Scalar
    start_rate: Scalar
    end: Scalar
    end_rate: Scalar
    h: Scalar

    def cubic(self) -> Cubic:
        """The cubic through both ends."""
        d0, d1, rise = self.h * self.start_rate, self.h * self.end_rate, self.end - self.start
        return Cubic(self.start, d0, 3.0 * rise - 2.0 * d0 - d1, d0 + d1 - 2.0 * rise)

    def controls(self) -> tuple[Scalar, Scalar]:
        """The inner control points: the cubic lies between the least and largest of all four."""
        third = (1.0 / 3.0) * self.h
        return self.start + third * self.start_rate, self.end - third * self.end_rate

    def minus(self, other: Segment) -> Segment:
        return Segment(
            self.start - other.start,
            self.start_rate - other.start_rate,
            self.end - other.end,
            self.end_rate - other.end_rate,
            self.h,
        )


def _safe_divide(a: Scalar, b: Scalar) -> Scalar:
    return a / jnp.where(b == 0.0, 1.0, b) * (b != 0.0)


def turning_points(c: Cubic) -> tuple[Scalar, Scalar]:
    """The fractions of zero slope inside (0, 1); 0 where there is none. Not differentiable."""
    c = jax.lax.stop_gradient(c)
    disc = c.c2 * c.c2 - 3.0 * c.c3 * c.c1
    root = jnp.sqrt(jnp.maximum(disc, 0.0))
    # The stable pair: never subtract nearly equal numbers.
    q = -(c.c2 + jnp.where(c.c2 >= 0.0, root, -root))
    candidates = _safe_divide(q, 3.0 * c.c3), _safe_divide(c.c1, q)
    inside = [(disc > 0.0) & (s > 0.0) & (s < 1.0) for s in candidates]
    first, second = (jnp.where(ok, s, 0.0) for s, ok in zip(candidates, inside, strict=True))
    return first, second


def lesser(a: Scalar, b: Scalar) -> Scalar:
    """The lesser of two numbers, b where either is nan.

    One instruction; jnp.minimum, which hands on every nan, takes four.
    """
    return jnp.where(a < b, a, b)


def greater(a: Scalar, b: Scalar) -> Scalar:
    """The greater of two numbers, as `lesser`."""
    return jnp.where(a > b, a, b)


def widened(low: Scalar, high: Scalar, s: Segment) -> tuple[Scalar, Scalar]:
    """The range from low to high, extended to all values of a segment.

    Its derivative is that of the segment at the extremes (envelope). Turning points are looked for
    only where the control points allow one beyond the range.
    """
    low, high = lesser(low, lesser(s.start, s.end)), greater(high, greater(s.start, s.end))
    a, b = s.controls()
    margin = lesser(lesser(a, b) - low, high - greater(a, b))

    def inside(low: Scalar, high: Scalar, s: Segment) -> tuple[Scalar, Scalar]:
        c = s.cubic()
        first, second = (c.value(at) for at in turning_points(c))
        return (
            jnp.minimum(low, jnp.minimum(first, second)),
            jnp.maximum(high, jnp.maximum(first, second)),
        )

    return rarely(margin, inside, lambda low, high, s: (low, high), low, high, s)


def raised(record: Scalar, s: Segment, way: Scalar, origin: Scalar) -> Scalar:
    """The larger of a record and the maximum of way*(c - origin), way +1 or -1; as `widened`."""
    record = greater(record, greater(way * (s.start - origin), way * (s.end - origin)))
    a, b = s.controls()
    margin = record - greater(way * (a - origin), way * (b - origin))

    def inside(record: Scalar, s: Segment) -> Scalar:
        c = s.cubic()
        first, second = (way * (c.value(at) - origin) for at in turning_points(c))
        return jnp.maximum(record, jnp.maximum(first, second))

    return rarely(margin, inside, lambda record, s: record, record, s)


def leaves_positive(c: Cubic, tolerance: Scalar) -> tuple[Scalar, Scalar]:
    """Whether c falls below -tolerance on (0, 1], and a fraction at which it is negative.

    The fraction is that of the lowest interior point (a dip that both ends do not show) or 1.
    A dip that begins at zero with zero slope is none: it is the error of the interpolation of what
    rises from rest as t^4 or later (the load behind a spring), and c returns.
    """
    a, b = turning_points(c)
    value_a, value_b = c.value(a), c.value(b)
    s_dip = jnp.where(value_a < value_b, a, b)
    dips = (s_dip > 0.0) & (jnp.minimum(value_a, value_b) < -tolerance)
    ends = c.value(1.0) < -tolerance
    from_rest = (jnp.abs(c.c0) <= tolerance) & (jnp.abs(c.c1) <= tolerance)
    dips = dips & (ends | ~from_rest)
    return dips | ends, jnp.where(dips, s_dip, 1.0)


def first_root(c: Cubic, s_negative: Scalar, tolerance: Scalar, wanted: Scalar) -> Scalar:
    """The root of c between 0, where c >= 0, and `s_negative`, where c < 0, if it is `wanted`.

    A step that starts ON the surface has the trivial root s = 0: it is divided out, so that a
    return to the surface within the same step is found. Not differentiable: callers that need
    the derivative of the crossing use `crossing`.
    """
    c = jax.lax.stop_gradient(c)
    on_surface = c.c0 <= jnp.maximum(tolerance, 1e-6 * jnp.abs(c.c1))
    zero = jnp.zeros_like(c.c0)
    f = Cubic(*(jnp.where(on_surface, d, k) for d, k in zip((*c[1:], zero), c, strict=True)))
    low, high = jnp.zeros_like(s_negative), s_negative
    s = rarely(jnp.where(wanted, -1.0, 1.0), _polished, lambda f, high: high, f, high)
    return jnp.where(f.value(low) <= 0.0, 0.0, s)


def _polished(f: Cubic, high: Scalar) -> Scalar:
    """The root of f on [0, high] by safeguarded Newton iterations from that of the chord."""
    low = jnp.zeros_like(high)
    start, end = f.value(low), f.value(high)
    s = high * jnp.clip(_safe_divide(start, start - end), 0.0, 1.0)
    for _ in range(_POLISH):
        value = f.value(s)
        low, high = jnp.where(value >= 0.0, s, low), jnp.where(value >= 0.0, high, s)
        newton = s - _safe_divide(value, f.slope(s))
        s = jnp.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
    return s


def crossing(c: Cubic) -> tuple[Scalar, Scalar]:
    """Whether c rises through zero on (0, 1], and where; the fraction is differentiable.

    The derivative of the fraction is that of the implicit function c(s) = 0.
    """
    crosses = (c.c0 < 0.0) & (c.value(1.0) >= 0.0)
    one = jnp.ones_like(c.c0)

    def located(c: Cubic) -> tuple[Scalar, Scalar]:
        s = first_root(c.scaled(-1.0), one, 0.0, crosses)
        return s, _safe_divide(one, c.slope(s))

    def none(c: Cubic) -> tuple[Scalar, Scalar]:
        return 0.5 * one, jnp.zeros_like(one)

    margin = jnp.where(crosses, -1.0, 1.0)
    s, steep = rarely(margin, located, none, jax.lax.stop_gradient(c))
    s = s - c.value(s) * steep
    return crosses, jnp.where(crosses, s, one)


# Gauss-Legendre with three points integrates polynomials up to degree 5 exactly: enough for a
# cubic times a linear weight, and for the square of a cubic to O(h^6).
_NODES = (0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5)
_WEIGHTS = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)


def integral(function: Any, a: Scalar, b: Scalar) -> Scalar:
    """The integral of `function(s)` from a to b by three-point Gauss-Legendre quadrature."""
    total = sum(w * function(a + n * (b - a)) for n, w in zip(_NODES, _WEIGHTS, strict=True))
    return (b - a) * total
