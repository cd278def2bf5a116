"""Events of one trial step: which surface is left first, and landing on it."""

from __future__ import annotations

import functools
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.hermite import Cubic, lesser
from jaxsim.hybrid import Surface
from jaxsim.loop import ClosedLoop, State, When
from jaxsim.rarely import rarely

Scalar = Any

# A landing counts when the Newton correction left is below this share of dt; the correction is
# first order, so what remains is its square: (1e-5*dt*frequency)^2, far below the step's error.
_LANDED = 1e-5


class Guards(NamedTuple):
    """Values of all guards and their rates along the flow, at one instant."""

    values: tuple[Scalar, ...]
    rates: tuple[Scalar, ...]


class Exit(NamedTuple):
    """The earliest surface left on a trial: whether any, which, and at what share of the trial."""

    any: Scalar
    surface: Scalar
    share: Scalar

    @staticmethod
    def none(like: Scalar) -> Exit:
        return Exit(jnp.asarray(False), jnp.asarray(-1, jnp.int32), jnp.ones_like(like))


class Landing(NamedTuple):
    """Whether the trial hit its target surface, the Newton correction, and the time left to it.

    rate: of that surface's guard at the end, per second.
    """

    landed: Scalar
    correction: Scalar
    ahead: Scalar
    rate: Scalar

    @staticmethod
    def none(like: Scalar) -> Landing:
        zero = jnp.zeros_like(like)
        return Landing(jnp.asarray(False), zero, zero + jnp.inf, zero)


def along(when: When, rates: State) -> tuple[When, State]:
    """The tangent of time and state along the flow."""
    return When(jnp.ones_like(when.t), jnp.zeros_like(when.t)), rates


@jax.jit
def field(loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any) -> State:
    """Rates of the state, as a function of its own in the program.

    So all stages of a step are traced, differentiated and transposed once: the gradient of the
    arm by reverse mode takes 13 s of CPU before it runs, and 18 s without.
    """
    return loop.field(when, x, modes, held)


def guards(
    loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any, rates: State
) -> Guards:
    """All guards at an instant, given the rates of the state there."""
    return Guards(
        *jax.jvp(lambda w, s: loop.guards(w, s, modes, held), (when, x), along(when, rates))
    )


def choose(condition: Scalar, yes: Any, no: Any) -> Any:
    """jnp.where over trees."""
    return jax.tree.map(lambda a, b: a if a is b else jnp.where(condition, a, b), yes, no)


def pick(values: tuple[Scalar, ...], index: Scalar, otherwise: Scalar) -> Scalar:
    """values[index]; a chain of selects, because stacking scalars costs ten times as much."""
    for i, value in enumerate(values):
        otherwise = jnp.where(index == i, value, otherwise)
    return otherwise


def first_modes(loop: ClosedLoop, when: When, x: State, held: Any) -> tuple[Scalar, ...]:
    """The modes at the start: signs of the guards, and of their rates where a guard is zero.

    Values come first, in two passes (guards may depend on modes). Rates are those of the modes
    found so far: with all modes at 0 both sides of the gap would touch, and their torque would
    decide the signs of the speeds.
    """
    modes = tuple(jnp.zeros_like(when.t) for _ in loop.surfaces)
    for _ in range(2):
        values = loop.guards(when, x, modes, held)
        modes = _signs(loop.surfaces, modes, values, (jnp.zeros_like(when.t),) * len(values))
    return settled(loop, when, x, modes, held)


def settled(
    loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any
) -> tuple[Scalar, ...]:
    """Modes that are still 0 (guard identically zero so far) take the sign of value, then rate."""
    if not modes:
        return modes

    # Only at the start of a run and after rest is any of them 0.
    loop, when, x, held = jax.lax.stop_gradient((loop, when, x, held))
    rates = field(loop, when, x, modes, held)

    def signs(known: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        return _signs(loop.surfaces, known, *guards(loop, when, x, known, held, rates))

    known = functools.reduce(operator.mul, (mode * mode for mode in modes))
    # What rests stays undecided: nothing changes a sign that was not found before.
    motion = sum(jnp.abs(rate) for rate in jax.tree.leaves(rates))
    return rarely((known - 1.0) * motion, signs, lambda known: known, modes)


def _signs(
    surfaces: tuple[Surface, ...], modes: tuple[Scalar, ...], values: Any, rates: Any
) -> tuple[Scalar, ...]:
    found = []
    for surface, mode, g, rate in zip(surfaces, modes, values, rates, strict=True):
        clear = jnp.abs(g) > surface.tolerance(g.dtype)
        sign = jnp.where(clear, jnp.sign(g), jnp.sign(rate))
        found.append(jax.lax.stop_gradient(jnp.where(mode == 0.0, sign, mode)))
    return tuple(found)


def landing(
    surfaces: tuple[Surface, ...], target: Scalar, end: Guards, h: Scalar, rest: Scalar, dt: float
) -> Landing:
    """delta = -g/(dg/dt) at the end of a trial of length h towards surface `target` (-1: none).

    The derivative of delta is that of the event time. rest: time left that a landing may take.
    """
    g = pick(end.values, target, jnp.zeros_like(h))
    rate = pick(end.rates, target, jnp.zeros_like(h))
    slope = jax.lax.stop_gradient(rate)
    known = jnp.abs(slope) > 0.0
    delta = jnp.where(known, -g / jnp.where(known, slope, 1.0), 0.0)
    aimed = target >= 0
    close = jnp.abs(delta) <= _LANDED * dt
    # A trial of no length cannot be corrected; it flips the mode where it stands.
    stuck = h <= _LANDED * dt * 1e-3
    # One that creeps towards its surface is there when rounding alone tells it from zero: the time
    # left is g/(dg/dt) with nothing known of g, and no trial would ever bring it down.
    tolerances = tuple(jnp.full_like(h, s.tolerance(h.dtype)) for s in surfaces)
    there = jnp.abs(g) <= pick(tolerances, target, jnp.zeros_like(h))
    landed = aimed & ((close & (h + delta <= rest)) | stuck | (there & ~close))
    # Clipping acts on the value only; the derivative of the event time stays whole.
    bounded = jnp.clip(jax.lax.stop_gradient(delta), -h, _LANDED * dt)
    correction = jnp.where(landed & close, delta + jax.lax.stop_gradient(bounded - delta), 0.0)
    ahead = jax.lax.stop_gradient(jnp.where(aimed & (delta > 0.0), delta, jnp.inf))
    return Landing(landed, correction, ahead, rate)


def clearance(
    surfaces: tuple[Surface, ...], modes: tuple[Scalar, ...], start: Guards, end: Guards, h: Scalar
) -> Scalar:
    """Negative where `earliest_exit` has to look: a cubic is above the least of its control points.

    By half the tolerance, so that rounding makes no difference to what is found.
    """
    least = jnp.full_like(h, jnp.inf)
    rows = zip(surfaces, modes, *start, *end, strict=True)
    for surface, mode, g0, r0, g1, r1 in rows:
        points = (g0, g1, *hermite.Segment(g0, r0, g1, r1, h).controls())
        lowest = functools.reduce(lesser, (mode * v for v in points))
        least = lesser(least, lowest + 0.5 * surface.tolerance(h.dtype))
    return least


class _Candidate(NamedTuple):
    """A surface as a trial sees it: its guard times its mode, and where that is negative."""

    cubic: Cubic
    negative_at: Scalar
    tolerance: Scalar
    leaves: Scalar
    rough: Scalar  # share of the trial at which it is left, by a straight line


def earliest_exit(
    loop: ClosedLoop, modes: tuple[Scalar, ...], start: Guards, end: Guards, h: Scalar,
    ignore: Scalar,
) -> Exit:  # fmt: skip
    """Which surface is left first on a trial of length h; `ignore` is the one just landed on.

    The share is polished for the surface chosen only: a wrong choice among several shows on the
    landing trial, which is then rejected in turn. Not differentiable.
    """
    best, chosen = Exit.none(h), None
    rows = zip(loop.surfaces, modes, *start, *end, strict=True)
    for i, (surface, mode, g0, r0, g1, r1) in enumerate(rows):
        cubic = hermite.Segment(*jax.lax.stop_gradient((g0, r0, g1, r1, h))).cubic().scaled(mode)
        now = _candidate(surface, cubic, h, _LANDED * loop.dt, ignore == i)
        first = now.leaves if chosen is None else now.leaves & (now.rough < chosen.rough)
        best = best._replace(any=best.any | now.leaves, surface=jnp.where(first, i, best.surface))
        chosen = now if chosen is None else choose(first, now, chosen)
    if chosen is None:
        return best
    share = hermite.first_root(chosen.cubic, chosen.negative_at, chosen.tolerance, best.any)
    return best._replace(share=share)


def _candidate(surface: Surface, c: Cubic, h: Scalar, near: float, ignored: Scalar) -> _Candidate:
    """One surface; `near`: the time within which a landing ends, s.

    A surface that is already left at the start (its guard jumped, as that of a stick does when a
    slip ends) is left at once.
    """
    tolerance = jnp.full_like(h, surface.tolerance(h.dtype))
    leaves, s_out = hermite.leaves_positive(c, tolerance)
    # What a landing leaves behind is far below the distance covered in the time `near`.
    residue = near * jnp.abs(c.c1) / jnp.where(h > 0.0, h, 1.0)
    jumped = (c.c0 < -tolerance - residue) & (h > 0.0)
    s_out = jnp.where(jumped, 0.0, s_out)
    leaves = (leaves | jumped) & ~ignored
    inside = jnp.maximum(c.c0, 0.0)
    fall = jnp.where(leaves, inside - c.value(s_out), 1.0)
    rough = jnp.where(leaves, s_out * inside / fall, jnp.inf)
    return _Candidate(c, s_out, tolerance, leaves, rough)
