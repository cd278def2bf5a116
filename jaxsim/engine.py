"""The engine: one function advances a drive, by micro-steps that land on events.

A micro-step tries the rest of the present tick in the carried modes. If a surface is crossed on
the way it is REJECTED, and the next one tries to land on the earliest crossing; on landing the
state is corrected once more by a Newton step that is differentiable (the implicit function
theorem: it carries the saltation term), the mode flips, and the rest of the tick goes on in the
new mode. Each batch member keeps its own clock, so there is no limit on events per tick.

Rejected alternatives: one location inside each step (costs every step, and allows one event
each); differentiating through the rejected trials (wrong: they never happened).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.hermite import Cubic
from jaxsim.loop import ClosedLoop, Outputs, State, When
from jaxsim.status import Status

Scalar = Any

# A landing counts when the Newton correction left is below this share of dt; the correction is
# first order, so what remains is its square: (1e-5*dt*frequency)^2, far below the step's error.
_LANDED = 1e-5
# Micro-steps per event: the rejected trial, the landing, and sometimes a second landing.
_PER_EVENT = 3
# Reverse mode keeps one carry per chunk and recomputes inside it.
_CHUNK = 64


class Carry(NamedTuple):
    """All that one run knows between two micro-steps."""

    tick: Scalar
    elapsed: Scalar
    x: State
    held: Any
    modes: tuple[Scalar, ...]
    trial: Scalar
    target: Scalar
    events: Scalar
    status: Scalar
    folds: Any


class Piece(NamedTuple):
    """One accepted micro-step of one axis, as the metrics see it.

    Signals and their rates at both ends, in the modes of the piece; rates are total time
    derivatives. `cubic(name)` interpolates a signal.
    """

    t: Scalar
    h: Scalar
    before: Outputs
    before_rate: Outputs
    after: Outputs
    after_rate: Outputs

    def cubic(self, name: str) -> Cubic:
        return hermite.cubic(
            getattr(self.before, name),
            getattr(self.before_rate, name),
            getattr(self.after, name),
            getattr(self.after_rate, name),
            self.h,
        )


class Mark(NamedTuple):
    """What one micro-step leaves behind when trajectories are stored."""

    t: Scalar
    ticked: Scalar
    event: Scalar
    rate: Scalar
    outputs: tuple[Outputs, ...]


def budget(loop: ClosedLoop, ticks: int) -> int:
    """Micro-steps that a run of so many ticks may take."""
    if not loop.deadzone.located:
        return ticks + loop.breaks
    most = loop.deadzone.max_events  # type: ignore[attr-defined]
    events = 40 + ticks // 20 if most is None else most
    return ticks + loop.breaks + _PER_EVENT * events


def start(loop: ClosedLoop, folds: Any) -> Carry:
    """The state of a run at t = 0, after the sampled law's first turn."""
    x, held = loop.start()
    zero = jnp.zeros_like(x.drive[0].theta_L)
    modes = tuple(zero for _ in loop.surfaces)
    when = When(zero, zero)
    # Twice: surfaces that depend on the mode are read again in the modes of the first reading.
    # Without location no mode is carried: they stay 0.
    for _ in range(2 if loop.deadzone.located else 0):
        modes = _settled(loop, when, x, modes, held)
    count = jnp.zeros((), jnp.int32)
    held = loop.on_tick(count, when, x, modes, held)
    status = jnp.where(loop.valid(), Status.OK.value, Status.INVALID.value).astype(jnp.int32)
    return Carry(count, zero, x, held, modes, zero + jnp.inf, count - 1, count, status, folds)


def advance(
    loop: ClosedLoop, carry: Carry, until: int, steps: int, metrics: Any, stored: bool = False
) -> tuple[Carry, Mark | None]:
    """Advance one run by up to `steps` micro-steps, idling once it has reached tick `until`.

    This is the only loop that moves a drive. Its status says whether it arrived.
    """
    chunks = -(-steps // _CHUNK)

    def micro(c: Carry, _: None) -> tuple[Carry, Mark | None]:
        return _micro_step(loop, c, until, metrics, stored)

    def chunk(c: Carry, _: None) -> tuple[Carry, Mark | None]:
        return jax.lax.scan(jax.checkpoint(micro), c, None, length=_CHUNK)

    carry, marks = jax.lax.scan(jax.checkpoint(chunk), carry, None, length=chunks)
    late = (carry.status == Status.OK.value) & (carry.tick < until)
    carry = carry._replace(status=jnp.where(late, Status.EVENTS.value, _cause(loop, carry)))
    if stored:
        marks = jax.tree.map(lambda v: v.reshape(-1, *v.shape[2:]), marks)
    return carry, marks


def _cause(loop: ClosedLoop, c: Carry) -> Scalar:
    """The status, with a mass matrix that is not positive definite told from other divergence.

    Asked once, of the last state that was accepted, so that it costs the steps nothing.
    """
    t = c.tick.astype(c.elapsed.dtype) * loop.dt + c.elapsed
    rest = loop.dt - c.elapsed
    rates = loop.field(When(t, t + 0.5 * rest), c.x, c.modes, c.held)
    singular = (c.status == Status.DIVERGED.value) & ~loop.definite(c.x, rates, rest)
    return jnp.where(singular, Status.SINGULAR.value, c.status)


def _settled(
    loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any
) -> tuple[Scalar, ...]:
    """Modes that are still 0 (guard identically zero so far) take the sign of value, then rate."""
    if not modes:
        return modes
    rates = loop.field(when, x, modes, held)
    values, slopes = _guards_and_rates(loop, when, x, modes, held, rates)
    settled = []
    for surface, mode, g, rate in zip(loop.surfaces, modes, values, slopes, strict=True):
        clear = jnp.abs(g) > surface.tolerance(g.dtype)
        sign = jnp.where(clear, jnp.sign(g), jnp.sign(rate))
        settled.append(jax.lax.stop_gradient(jnp.where(mode == 0.0, sign, mode)))
    return tuple(settled)


def _along(when: When, rates: State) -> tuple[When, State]:
    """The tangent of time and state along the flow."""
    return When(jnp.ones_like(when.t), jnp.zeros_like(when.t)), rates


def _guards_and_rates(
    loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any, rates: State
) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
    return jax.jvp(lambda w, s: loop.guards(w, s, modes, held), (when, x), _along(when, rates))


def _outputs_and_rates(
    loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any, rates: State
) -> tuple[tuple[Outputs, ...], tuple[Outputs, ...]]:
    return jax.jvp(lambda w, s: loop.outputs(w, s, modes, held), (when, x), _along(when, rates))


def _shift(x: State, rates: State, h: Scalar) -> State:
    return jax.tree.map(lambda a, b: a + h * b, x, rates)


def _runge_kutta(
    loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any, h: Scalar
) -> tuple[State, State]:
    """One classical fourth-order step; also the rates at its start."""
    middle, end = when._replace(t=when.t + 0.5 * h), when._replace(t=when.t + h)
    k1 = loop.field(when, x, modes, held)
    k2 = loop.field(middle, _shift(x, k1, 0.5 * h), modes, held)
    k3 = loop.field(middle, _shift(x, k2, 0.5 * h), modes, held)
    k4 = loop.field(end, _shift(x, k3, h), modes, held)
    mean = jax.tree.map(lambda a, b, c, d: (a + 2.0 * (b + c) + d) / 6.0, k1, k2, k3, k4)
    return _shift(x, mean, h), k1


class _Exit(NamedTuple):
    """The earliest surface left on a trial: whether any, which, and at what share of the trial."""

    any: Scalar
    surface: Scalar
    share: Scalar


def _earliest_exit(
    loop: ClosedLoop, modes: tuple[Scalar, ...], cubics: list[Cubic], h: Scalar, ignore: Scalar
) -> _Exit:
    """Which surface is left first.

    The share is polished for the surface chosen only: a wrong choice among several shows on the
    landing trial, which is then rejected in turn. A surface that is already left at the start (its
    guard jumped, as that of a stick does when a slip ends) is left at once.
    """
    best, chosen = _Exit(jnp.asarray(False), jnp.asarray(-1, jnp.int32), jnp.inf), None
    for i, (surface, mode, c) in enumerate(zip(loop.surfaces, modes, cubics, strict=True)):
        c = c.scaled(jnp.where(mode == 0.0, 0.0, mode))
        tolerance = surface.tolerance(c.c0.dtype)
        leaves, s_out = hermite.leaves_positive(c, tolerance)
        # What a landing leaves behind is far below the distance covered in _LANDED * dt.
        residue = _LANDED * loop.dt * jnp.abs(c.c1) / jnp.where(h > 0.0, h, 1.0)
        jumped = (c.c0 < -tolerance - residue) & (h > 0.0)
        s_out = jnp.where(jumped, 0.0, s_out)
        leaves = (leaves | jumped) & (ignore != i)
        inside = jnp.maximum(c.c0, 0.0)
        rough = jnp.where(leaves, s_out * inside / (inside - c.value(s_out) + 1e-300), jnp.inf)
        first = leaves & (rough < best.share)
        best = _Exit(
            best.any | leaves, jnp.where(first, i, best.surface), jnp.where(first, rough, best.share)
        )
        now = (*c, s_out, jnp.full_like(s_out, tolerance))
        chosen = now if chosen is None else _choose(first, now, chosen)
    if chosen is None:
        return best
    *coefficients, s_out, tolerance = chosen
    return best._replace(share=hermite.first_root(Cubic(*coefficients), s_out, tolerance))


def _choose(condition: Scalar, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _pick(values: tuple[Scalar, ...], index: Scalar, otherwise: Scalar) -> Scalar:
    for i, value in enumerate(values):
        otherwise = jnp.where(index == i, value, otherwise)
    return otherwise


class _Landing(NamedTuple):
    """Whether the trial hit its target surface, and the Newton correction of time left."""

    landed: Scalar
    correction: Scalar
    ahead: Scalar


def _landing(
    c: Carry, values: tuple[Scalar, ...], slopes: tuple[Scalar, ...], h: Scalar, rest: Scalar,
    dt: float,
) -> _Landing:
    """delta = -g/(dg/dt) at the end of the trial; its derivative is that of the event time."""
    g = _pick(values, c.target, jnp.zeros_like(h))
    slope = jax.lax.stop_gradient(_pick(slopes, c.target, jnp.zeros_like(h)))
    known = jnp.abs(slope) > 0.0
    delta = jnp.where(known, -g / jnp.where(known, slope, 1.0), 0.0)
    aimed = c.target >= 0
    close = jnp.abs(delta) <= _LANDED * dt
    # A trial of no length cannot be corrected; it flips the mode where it stands.
    stuck = h <= _LANDED * dt * 1e-3
    landed = aimed & ((close & (h + delta <= rest)) | stuck)
    # Clipping acts on the value only; the derivative of the event time stays whole.
    bounded = jnp.clip(jax.lax.stop_gradient(delta), -h, _LANDED * dt)
    correction = jnp.where(landed & close, delta + jax.lax.stop_gradient(bounded - delta), 0.0)
    ahead = jax.lax.stop_gradient(jnp.where(aimed & (delta > 0.0), delta, jnp.inf))
    return _Landing(landed, correction, ahead)


def _micro_step(
    loop: ClosedLoop, c: Carry, until: int, metrics: Any, stored: bool
) -> tuple[Carry, Mark | None]:
    dt = loop.dt
    active = (c.tick < until) & (c.status == Status.OK.value)
    t = c.tick.astype(c.elapsed.dtype) * dt + c.elapsed
    to_tick, to_break = _distances(loop, t, c.elapsed)
    rest = jnp.minimum(to_tick, to_break)
    whole = c.trial >= rest
    h = jnp.where(whole, rest, jax.lax.stop_gradient(c.trial))
    when = When(t, jax.lax.stop_gradient(t + 0.5 * h))
    end = when._replace(t=t + h)

    modes = _settled(loop, when, c.x, c.modes, c.held) if loop.deadzone.located else c.modes
    x, rates = _runge_kutta(loop, when, c.x, modes, c.held, h)
    end_rates = loop.field(end, x, modes, c.held)

    landing = _Landing(jnp.asarray(False), jnp.zeros_like(h), jnp.zeros_like(h) + jnp.inf)
    exit_ = _Exit(jnp.asarray(False), jnp.asarray(-1, jnp.int32), jnp.ones_like(h))
    slopes: tuple[Scalar, ...] = ()
    if loop.deadzone.located and modes:
        before = _guards_and_rates(loop, when, c.x, modes, c.held, rates)
        values, slopes = _guards_and_rates(loop, end, x, modes, c.held, end_rates)
        landing = _landing(c, values, slopes, h, rest, dt)
        cubics = [
            hermite.cubic(g0, r0, g1, r1, h)
            for g0, r0, g1, r1 in zip(*before, values, slopes, strict=True)
        ]
        ignored = jnp.where(landing.landed, c.target, -1)
        exit_ = jax.lax.stop_gradient(_earliest_exit(loop, modes, cubics, h, ignored))

    finite = _all_finite(x)
    accept = active & finite & ~exit_.any
    landed = accept & landing.landed
    reject = active & finite & exit_.any

    shift = jnp.where(landed, landing.correction, 0.0)
    x_new = _shift(x, end_rates, shift)
    length = h + shift
    ticked = accept & ~landed & whole & (to_tick <= to_break)

    new_modes = tuple(
        jnp.where(landed & (c.target == i), -m, m) for i, m in enumerate(modes)
    )
    tick = c.tick + ticked.astype(c.tick.dtype)
    elapsed = jnp.where(ticked, 0.0, c.elapsed + length)
    held = c.held
    if loop.sampled:
        now = When(t + length, t + length)
        turned = loop.on_tick(tick, now, x_new, new_modes, c.held)
        held = _choose(ticked, turned, c.held)

    folds = _fold(loop, metrics, c, when, x_new, modes, rates, end_rates, length, accept)
    missed = accept & ~landed & ~whole
    moved = _choose(accept, (x_new, new_modes, elapsed, tick), (c.x, c.modes, c.elapsed, c.tick))
    new = Carry(
        tick=moved[3],
        elapsed=moved[2],
        x=moved[0],
        held=held,
        modes=moved[1],
        trial=jnp.where(
            reject, exit_.share * jax.lax.stop_gradient(h), jnp.where(missed, landing.ahead, jnp.inf)
        ),
        target=jnp.where(reject, exit_.surface, jnp.where(missed, c.target, -1)),
        events=c.events + landed.astype(c.events.dtype),
        status=jnp.where(active & ~finite, Status.DIVERGED.value, c.status),
        folds=folds,
    )
    new = new._replace(trial=jnp.where(active, new.trial, c.trial))
    mark = None
    if stored:
        mark = _mark(loop, new, c.target, ticked, landed, slopes)
    return new, mark


def _distances(loop: ClosedLoop, t: Scalar, elapsed: Scalar) -> tuple[Scalar, Scalar]:
    """Time to the end of the tick and to the next breakpoint of a signal.

    Breakpoints within rounding of the present instant, or of the tick, count as met there.
    """
    snap = 1e-6 * loop.dt + 4.0 * jnp.finfo(t.dtype).eps * t
    to_tick = loop.dt - elapsed
    if not loop.breaks:
        return to_tick, jnp.full_like(t, jnp.inf)
    to_break = loop.next_break(t + snap) - t
    return to_tick, jnp.where(jnp.abs(to_break - to_tick) <= snap, jnp.inf, to_break)


def _all_finite(x: State) -> Scalar:
    finite = jnp.asarray(True)
    for leaf in jax.tree.leaves(x):
        finite = finite & jnp.isfinite(leaf)
    return finite


def _fold(
    loop: ClosedLoop, metrics: Any, c: Carry, when: When, x: State, modes: tuple[Scalar, ...],
    rates: State, end_rates: State, length: Scalar, accept: Scalar,
) -> Any:
    """Update the metrics by an accepted piece."""
    if not metrics:
        return c.folds
    end = when._replace(t=when.t + length)
    before, before_rate = _outputs_and_rates(loop, when, c.x, modes, c.held, rates)
    after, after_rate = _outputs_and_rates(loop, end, x, modes, c.held, end_rates)
    folds = []
    for axis, own in enumerate(c.folds):
        piece = Piece(
            when.t, length, before[axis], before_rate[axis], after[axis], after_rate[axis]
        )
        updated = tuple(m.update(f, piece) for m, f in zip(metrics[axis], own, strict=True))
        folds.append(_choose(accept, updated, own))
    return tuple(folds)


def _mark(
    loop: ClosedLoop, c: Carry, target: Scalar, ticked: Scalar, landed: Scalar,
    slopes: tuple[Scalar, ...],
) -> Mark:
    t = c.tick.astype(c.elapsed.dtype) * loop.dt + c.elapsed
    outputs = loop.outputs(When(t, t + 1e-6 * loop.dt), c.x, c.modes, c.held)
    event = jnp.where(landed, target, -1)
    return Mark(t, ticked, event, _pick(slopes, event, jnp.zeros_like(t)), outputs)


__all__ = ["Carry", "Mark", "Piece", "advance", "budget", "start"]

