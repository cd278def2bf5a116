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

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from jaxsim import events, integrate
from jaxsim.events import Exit, Landing, choose
from jaxsim.hermite import Cubic, Segment, any_member
from jaxsim.loop import ClosedLoop, Outputs, State, When
from jaxsim.status import Status

Scalar = Any

# Micro-steps per event: the rejected trial, the landing, and sometimes a second landing.
_PER_EVENT = 3
# Reverse mode keeps one carry per chunk and recomputes the chunk. A second checkpoint around each
# micro-step saves no memory at this size and makes gradients a third slower.
_CHUNK = 64
# A sampled law reads signals so much after its tick, as a share of a step.
_AFTER = 1e-3


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
    derivatives. `cubic(name)` interpolates a signal; `segment(name)` is for what rarely needs that.
    """

    t: Scalar
    h: Scalar
    before: Outputs
    before_rate: Outputs
    after: Outputs
    after_rate: Outputs

    def cubic(self, name: str) -> Cubic:
        return self.segment(name).cubic()

    def segment(self, name: str) -> Segment:
        return Segment(
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
    when = When(zero, zero)
    # Without location no mode is carried: they stay 0.
    modes = tuple(zero for _ in loop.surfaces)
    if loop.deadzone.located:
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
    chunks = -(-steps // _CHUNK)

    def micro(c: Carry, _: None) -> tuple[Carry, Mark | None]:
        return _micro_step(loop, c, until, metrics, stored)

    def chunk(c: Carry) -> tuple[Carry, Mark | None]:
        return jax.lax.scan(micro, c, None, length=-(-steps // chunks))

    def idle(c: Carry) -> tuple[Carry, Mark | None]:
        marks = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(chunk, c)[1])
        return c, marks._replace(event=marks.event - 1) if stored else None

    def going(c: Carry, _: None) -> tuple[Carry, Mark | None]:
        return jax.lax.cond(any_member(_active(c, until)), chunk, idle, c)

    carry, marks = jax.lax.scan(jax.checkpoint(going), carry, None, length=chunks)
    if stored:
        marks = jax.tree.map(lambda v: v.reshape(-1, *v.shape[2:]), marks)
    return carry, marks


@functools.partial(jax.custom_jvp, nondiff_argnums=(4,))
def _arrived(loop: ClosedLoop, carry: Carry, until: Any, metrics: Any, steps: int) -> Carry:
    """Micro-steps until all members of a batch have arrived or failed: their values only.

    Room for events is rarely used up: a period of an environment has room for 15, and mostly none.
    """

    def going(state: tuple[Carry, Scalar]) -> Scalar:
        c, count = state
        return any_member(_active(c, until)) & (count < steps)

    def micro(state: tuple[Carry, Scalar]) -> tuple[Carry, Scalar]:
        c, count = state
        return _micro_step(loop, c, until, metrics, False)[0], count + 1

    return jax.lax.while_loop(going, micro, (carry, jnp.zeros((), jnp.int32)))[0]


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


def _active(c: Carry, until: Any) -> Scalar:
    return (c.tick < until) & (c.status == Status.OK.value)


def _cause(loop: ClosedLoop, c: Carry) -> Scalar:
    """The status, with a mass matrix that is not positive definite told from other divergence.

    Asked once, of the last state that was accepted, so that it costs the steps nothing.
    """
    t, rest = _now(loop, c), loop.dt - c.elapsed
    rates = events.field(loop, When(t, t + 0.5 * rest), c.x, c.modes, c.held)
    singular = (c.status == Status.DIVERGED.value) & ~loop.definite(c.x, rates, rest)
    return jnp.where(singular, Status.SINGULAR.value, c.status)


def _outputs_and_rates(
    loop: ClosedLoop, when: When, x: State, modes: tuple[Scalar, ...], held: Any, rates: State
) -> tuple[tuple[Outputs, ...], tuple[Outputs, ...]]:
    return jax.jvp(
        lambda w, s: loop.outputs(w, s, modes, held), (when, x), events.along(when, rates)
    )


def _shift(x: State, rates: State, h: Scalar) -> State:
    return jax.tree.map(lambda a, b: a + h * b, x, rates)


class _Trial(NamedTuple):
    """The rest of the tick, or the way to an event, tried in the carried modes."""

    when: When
    end: When
    h: Scalar
    rest: Scalar
    whole: Scalar  # reaches the end of the tick or a breakpoint
    to_tick: Scalar  # reaches the end of the tick
    modes: tuple[Scalar, ...]
    x: State
    rates: State
    end_rates: State


def _try(loop: ClosedLoop, c: Carry) -> _Trial:
    t = _now(loop, c)
    to_tick, to_break = _distances(loop, t, c.elapsed)
    rest = jnp.minimum(to_tick, to_break)
    whole = c.trial >= rest
    h = jnp.where(whole, rest, jax.lax.stop_gradient(c.trial))
    when = When(t, jax.lax.stop_gradient(t + 0.5 * h))
    end = when._replace(t=t + h)
    located = loop.deadzone.located
    modes = events.settled(loop, when, c.x, c.modes, c.held) if located else c.modes

    def field(at: Scalar, x: State) -> State:
        return events.field(loop, when._replace(t=at), x, modes, c.held)

    x, rates = integrate.step(field, t, c.x, h)
    end_rates = field(end.t, x)
    ends_tick = whole & (to_tick <= to_break)
    return _Trial(when, end, h, rest, whole, ends_tick, modes, x, rates, end_rates)


class _Verdict(NamedTuple):
    """What a trial turned out to be."""

    accept: Scalar
    reject: Scalar  # a surface is left on the way
    landed: Scalar  # accepted, on the surface aimed at
    failed: Scalar  # not finite
    landing: Landing
    exit: Exit
    slopes: tuple[Scalar, ...]  # rates of the guards at the end


def _judge(loop: ClosedLoop, c: Carry, trial: _Trial, active: Scalar) -> _Verdict:
    no = jnp.asarray(False)
    landing = Landing(no, jnp.zeros_like(trial.h), jnp.full_like(trial.h, jnp.inf))
    exit_ = Exit(no, jnp.asarray(-1, jnp.int32), jnp.ones_like(trial.h))
    slopes: tuple[Scalar, ...] = ()
    if loop.deadzone.located and trial.modes:
        start = events.guards(loop, trial.when, c.x, trial.modes, c.held, trial.rates)
        end = events.guards(loop, trial.end, trial.x, trial.modes, c.held, trial.end_rates)
        landing = events.landing(loop.surfaces, c.target, end, trial.h, trial.rest, loop.dt)
        ignored = jnp.where(landing.landed, c.target, -1)
        exit_ = events.earliest_exit(loop, trial.modes, start, end, trial.h, ignored)
        slopes = end.rates
    finite = _all_finite(trial.x)
    accept = active & finite & ~exit_.any
    reject = active & finite & exit_.any
    landed = accept & landing.landed
    return _Verdict(accept, reject, landed, active & ~finite, landing, exit_, slopes)


def _micro_step(
    loop: ClosedLoop, c: Carry, until: Any, metrics: Any, stored: bool
) -> tuple[Carry, Mark | None]:
    """Try, judge, and go on from there; a run that has arrived or failed stays as it is."""
    active = _active(c, until)
    trial = _try(loop, c)
    verdict = _judge(loop, c, trial, active)
    shift = jnp.where(verdict.landed, verdict.landing.correction, 0.0)
    x, length = _shift(trial.x, trial.end_rates, shift), trial.h + shift
    ticked = verdict.accept & ~verdict.landed & trial.to_tick
    new = _moved(c, trial, verdict, x, length, ticked)
    if loop.clocked:
        end = trial.when.t + length
        # The piece that begins here: rounding of `end` must not leave it on the one before.
        now = When(end, end + _AFTER * loop.dt)
        turned = loop.on_tick(new.tick, now, x, new.modes, c.held)
        new = new._replace(held=choose(ticked, turned, c.held))
    new = new._replace(folds=_fold(loop, metrics, c, trial, x, length, verdict.accept))
    new = _aimed(c, new, trial, verdict, active)
    mark = _mark(loop, new, c.target, ticked, verdict) if stored else None
    return new, mark


def _moved(
    c: Carry, trial: _Trial, verdict: _Verdict, x: State, length: Scalar, ticked: Scalar
) -> Carry:
    """Clock, state and modes after the trial."""
    modes = tuple(
        jnp.where(verdict.landed & (c.target == i), -m, m) for i, m in enumerate(trial.modes)
    )
    elapsed = jnp.where(ticked, 0.0, c.elapsed + length)
    x, modes, elapsed = choose(verdict.accept, (x, modes, elapsed), (c.x, c.modes, c.elapsed))
    tick = c.tick + ticked.astype(c.tick.dtype)
    return c._replace(tick=tick, elapsed=elapsed, x=x, modes=modes)


def _aimed(c: Carry, new: Carry, trial: _Trial, verdict: _Verdict, active: Scalar) -> Carry:
    """What to try next: an exit found, the rest of the way to one that was missed, or all."""
    missed = verdict.accept & ~verdict.landed & ~trial.whole
    way = jnp.where(missed, verdict.landing.ahead, jnp.inf)
    way = jnp.where(verdict.reject, verdict.exit.share * jax.lax.stop_gradient(trial.h), way)
    target = jnp.where(missed, c.target, -1)
    return new._replace(
        trial=jnp.where(active, way, c.trial),
        target=jnp.where(verdict.reject, verdict.exit.surface, target),
        events=c.events + verdict.landed.astype(c.events.dtype),
        status=jnp.where(verdict.failed, Status.DIVERGED.value, c.status),
    )


def _now(loop: ClosedLoop, c: Carry) -> Scalar:
    return c.tick.astype(c.elapsed.dtype) * loop.dt + c.elapsed


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
    loop: ClosedLoop, metrics: Any, c: Carry, trial: _Trial, x: State, length: Scalar,
    accept: Scalar,
) -> Any:  # fmt: skip
    """Update the metrics by an accepted piece."""
    if not metrics:
        return c.folds
    when, modes = trial.when, trial.modes
    end = when._replace(t=when.t + length)
    before, before_rate = _outputs_and_rates(loop, when, c.x, modes, c.held, trial.rates)
    after, after_rate = _outputs_and_rates(loop, end, x, modes, c.held, trial.end_rates)
    folds = []
    for axis, own in enumerate(c.folds):
        piece = Piece(
            when.t, length, before[axis], before_rate[axis], after[axis], after_rate[axis]
        )
        updated = tuple(m.update(f, piece) for m, f in zip(metrics[axis], own, strict=True))
        folds.append(choose(accept, updated, own))
    return tuple(folds)


def _mark(loop: ClosedLoop, c: Carry, target: Scalar, ticked: Scalar, verdict: _Verdict) -> Mark:
    t = _now(loop, c)
    outputs = loop.outputs(When(t, t + 1e-6 * loop.dt), c.x, c.modes, c.held)
    event = jnp.where(verdict.landed, target, -1)
    rate = events.pick(verdict.slopes, event, jnp.zeros_like(t))
    return Mark(t, ticked, event, rate, outputs)


__all__ = ["Carry", "Mark", "Piece", "advance", "budget", "start"]
