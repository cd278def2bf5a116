"""The engine: one function advances a drive, by micro-steps that land on events.

A micro-step tries the rest of the present tick in the carried modes. If a surface is crossed on
the way it is REJECTED, and the next one tries to land on the earliest crossing; on landing the
state is corrected once more by a Newton step that is differentiable (the implicit function
theorem: it carries the saltation term), the mode flips, and the rest of the tick goes on in the
new mode. Each batch member keeps its own clock, so there is no limit on events per tick. The
micro-steps themselves, with and without location, are in `jaxsim/steps.py`.

Rejected alternatives: one location inside each step (costs every step, and allows one event
each); differentiating through the rejected trials (wrong: they never happened).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from jaxsim import events
from jaxsim.events import choose
from jaxsim.loop import ClosedLoop, When
from jaxsim.rarely import any_member, how_many
from jaxsim.reverse import thrifty
from jaxsim.status import Status
from jaxsim.steps import (
    Carry,
    Mark,
    Piece,
    located_step,
    micro_step,
    now,
    quick_step,
    running,
    sound,
    still,
)

Scalar = Any

# Micro-steps per event: the rejected trial, the landing, and sometimes a second landing.
_PER_EVENT = 3
# Quick steps for which a member waits to be located with others.
_PATIENCE = 8
# Steps whose carries are few enough to be kept.
_FEW = 48


def budget(loop: ClosedLoop, ticks: int) -> int:
    """Micro-steps that a run of so many ticks may take."""
    if not loop.located:
        return ticks + loop.breaks
    most = loop.deadzone.max_events  # type: ignore[attr-defined]
    events = 40 + ticks // 20 if most is None else most
    return ticks + loop.breaks + _PER_EVENT * events


def start(loop: ClosedLoop, folds: Any) -> Carry:
    """The state of a run at t = 0, after the sampled law's first turn."""
    x, held = loop.start()
    zero = jnp.zeros_like(x.drive[0].theta_L)
    when = When(zero, zero)
    # Without location no mode is carried: they stay 0.
    modes = tuple(zero for _ in loop.surfaces)
    if loop.located:
        modes = events.first_modes(loop, when, x, held)
    count = jnp.zeros((), jnp.int32)
    held = loop.on_tick(count, when, x, modes, held)
    status = jnp.where(loop.valid(), Status.OK.value, Status.INVALID.value).astype(jnp.int32)
    return Carry(count, zero, x, held, modes, zero + jnp.inf, count - 1, count, status, folds)


def advance(
    loop: ClosedLoop, carry: Carry, until: Any, steps: int, metrics: Any, stored: bool = False
) -> tuple[Carry, Mark | None]:
    """Advance one run to tick `until` by at most `steps` micro-steps.

    This is the only loop that moves a drive. Its status says whether it arrived. Members of a
    batch that have arrived idle until the last one has.
    """
    marks = None
    if stored:
        carry, marks = _scanned(loop, carry, until, metrics, steps, stored)
    else:
        carry = _arrived(loop, carry, until, metrics, steps)
    late = (carry.status == Status.OK.value) & (carry.tick < until)
    return carry._replace(status=jnp.where(late, Status.EVENTS.value, _cause(loop, carry))), marks


def _scanned(
    loop: ClosedLoop, carry: Carry, until: Any, metrics: Any, steps: int, stored: bool
) -> tuple[Carry, Mark | None]:
    """`steps` micro-steps, or a few more: a loop that both modes of differentiation can take.

    Chunks after the last arrival are skipped: a fifth of a run's steps is room for events.
    """
    chunks, stretches, length = _cut(loop, steps)

    def micro(c: Carry, _: None) -> tuple[Carry, Mark | None]:
        return micro_step(loop, c, until, metrics, stored)

    def stretch(c: Carry, _: None) -> tuple[Carry, Mark | None]:
        return jax.lax.scan(thrifty(micro, loop.located, "step"), c, None, length=length)

    def chunk(c: Carry) -> tuple[Carry, Mark | None]:
        if stretches == 1:
            new, marks = stretch(c, None)
        else:
            kept = thrifty(stretch, loop.located, "stretch")
            new, marks = _joined(jax.lax.scan(kept, c, None, length=stretches))
        return new if loop.located else sound(c, new), marks

    def idle(c: Carry) -> tuple[Carry, Mark | None]:
        # Rejected: eval_shape(chunk) for the marks, which traces all of a step once more.
        mark, count = still(loop, c) if stored else None, stretches * length
        return c, jax.tree.map(lambda v: jnp.broadcast_to(v, (count, *v.shape)), mark)

    def going(c: Carry, _: None) -> tuple[Carry, Mark | None]:
        return jax.lax.cond(any_member(running(c, until)), chunk, idle, c)

    kept = thrifty(going, loop.located, "chunk")
    return _joined(jax.lax.scan(kept, carry, None, length=chunks))


def _joined(scanned: tuple[Carry, Mark | None]) -> tuple[Carry, Mark | None]:
    """The marks of a scan of scans, one after the other."""
    carry, marks = scanned
    return carry, jax.tree.map(lambda v: v.reshape(-1, *v.shape[2:]), marks)


class _Cut(NamedTuple):
    """Chunks of so many stretches of so many steps."""

    chunks: int
    stretches: int
    steps: int


def _cut(loop: ClosedLoop, steps: int) -> _Cut:
    """How a run is cut: reverse mode keeps a carry for each chunk, stretch of one, and step of one.

    A third level costs reverse mode another run, and a third of compilation. It is worth that
    where events are located and many steps are taken: 3000 of 64 drives keep 0.5 MB, not 0.9.
    Without events to locate, what diverged is put back to where its chunk began.
    """
    if not loop.located or steps <= _FEW**2:
        length = max(_FEW, math.isqrt(steps))
        return _even(steps, 1, min(length, steps))
    side = math.ceil(steps ** (1 / 3))
    return _even(steps, side, side)


def _even(steps: int, stretches: int, length: int) -> _Cut:
    """At least so many steps in chunks of about one size."""
    chunks = -(-steps // (stretches * length))
    return _Cut(chunks, stretches, -(-steps // (chunks * stretches)))


@functools.partial(jax.custom_jvp, nondiff_argnums=(4,))
def _arrived(loop: ClosedLoop, carry: Carry, until: Any, metrics: Any, steps: int) -> Carry:
    """Micro-steps until all members of a batch have arrived or failed: their values only.

    Room for events is rarely used up: a period of an environment has room for 15, and mostly none.
    """

    advanced = _located if loop.located else _open
    return advanced(loop, carry, until, metrics, steps)


def _open(loop: ClosedLoop, carry: Carry, until: Any, metrics: Any, steps: int) -> Carry:
    """Micro-steps in blocks of those after which one looks for what has diverged."""

    def going(state: tuple[Carry, Scalar]) -> Scalar:
        return any_member(running(state[0], until)) & (state[1] < steps)

    def micro(state: tuple[Carry, Scalar]) -> tuple[Carry, Scalar]:
        c, count = state
        return micro_step(loop, c, until, metrics, False)[0], count + 1

    def block(state: tuple[Carry, Scalar]) -> tuple[Carry, Scalar]:
        last = jnp.minimum(state[1] + _cut(loop, steps).steps, steps)

        def inside(state: tuple[Carry, Scalar]) -> Scalar:
            return any_member(state[0].tick < until) & (state[1] < last)

        new, count = jax.lax.while_loop(inside, micro, state)
        return sound(state[0], new), count

    return jax.lax.while_loop(going, block, (carry, jnp.zeros((), jnp.int32)))[0]


class _Under(NamedTuple):
    """A run under way: whether it waits to be located, and the micro-steps it has left."""

    c: Carry
    waits: Scalar
    left: Scalar


def _located(loop: ClosedLoop, carry: Carry, until: Any, metrics: Any, steps: int) -> Carry:
    """Quick steps of those to which nothing happens, located ones of those that wait for them."""

    def going(s: _Under) -> Scalar:
        return running(s.c, until) & (s.left > 0)

    def quick(s: _Under) -> _Under:
        moves = going(s) & ~s.waits
        c, rare = quick_step(loop, s.c, moves, metrics)
        return _Under(c, s.waits | rare, s.left - (moves & ~rare).astype(s.left.dtype))

    def locating(s: _Under) -> _Under:
        s = _hurried(going, quick, s)
        c = choose(s.waits, located_step(loop, s.c, until, metrics)[0], s.c)
        return _Under(c, jnp.zeros_like(s.waits), s.left - s.waits.astype(s.left.dtype))

    waits = jnp.zeros_like(carry.tick, bool)
    first = _Under(carry, waits, jnp.full_like(carry.tick, steps))
    return jax.lax.while_loop(lambda s: any_member(going(s)), locating, first).c


def _hurried(
    going: Callable[[_Under], Scalar], quick: Callable[[_Under], _Under], s: _Under
) -> _Under:
    """Quick steps until a quarter of the members wait, or some have waited for a few steps.

    Each has its own clock. With no patience a batch of drives that differ at random locates in
    every step: 4096 of them take 100 ms, and with it 60; in order of half_gap 33, and 38. Without
    an end to it the few that are late go on alone: 48.
    """
    every = how_many(going(s))

    def more(state: tuple[_Under, Scalar, Scalar]) -> Scalar:
        _, free, patience = state
        return (4 * free > 3 * every) & (patience > 0)

    def step(state: tuple[_Under, Scalar, Scalar]) -> tuple[_Under, Scalar, Scalar]:
        s = quick(state[0])
        free = how_many(going(s) & ~s.waits)
        return s, free, state[2] - (free < every).astype(jnp.int32)

    return jax.lax.while_loop(more, step, (s, every, jnp.asarray(_PATIENCE, jnp.int32)))[0]


@functools.partial(_arrived.defjvp, symbolic_zeros=True)
def _(steps: int, primals: Any, tangents: Any) -> tuple[Carry, Carry]:
    """A loop without a fixed length has no reverse mode: where derivatives are asked for, scan.

    Only what has a tangent is differentiated: zeros would be carried through all the steps.
    """
    leaves, structure = jax.tree.flatten(primals)
    slopes = jax.tree.leaves(tangents, is_leaf=lambda v: isinstance(v, SymbolicZero))
    moves = [not isinstance(v, SymbolicZero) for v in slopes]

    def scanned(*moving: Any) -> Carry:
        following = iter(moving)
        own = [next(following) if m else v for m, v in zip(moves, leaves, strict=True)]
        loop, carry, until, metrics = jax.tree.unflatten(structure, own)
        return _scanned(loop, carry, until, metrics, steps, False)[0]

    return jax.jvp(
        scanned,
        [v for v, m in zip(leaves, moves, strict=True) if m],
        [v for v, m in zip(slopes, moves, strict=True) if m],
    )


def _cause(loop: ClosedLoop, c: Carry) -> Scalar:
    """The status, with a mass matrix that is not positive definite told from other divergence.

    Asked once, of the last state that was accepted, so that it costs the steps nothing.
    """
    t, rest = now(loop, c), loop.dt - c.elapsed
    rates = events.field(loop, When(t, t + 0.5 * rest), c.x, c.modes, c.held)
    singular = (c.status == Status.DIVERGED.value) & ~loop.definite(c.x, rates, rest)
    return jnp.where(singular, Status.SINGULAR.value, c.status)


__all__ = ["Carry", "Mark", "Piece", "advance", "budget", "start"]
