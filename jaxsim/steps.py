"""Micro-steps: the one way in which a drive moves, with events located and without.

Both try a piece of the present tick with the same field, clock, metrics and marks. A located one
judges what it tried: a surface that is left rejects it, a landing corrects it and flips a mode. One
without location has nothing to wait for: its clock depends on no state, so that all members of a
batch share it, and what diverges is found once per block of steps (`sound`), not in each.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxsim import events, integrate
from jaxsim.events import Exit, Guards, Landing, choose
from jaxsim.hermite import Cubic, Segment, lesser
from jaxsim.loop import ClosedLoop, Outputs, State, When
from jaxsim.rarely import any_member, hurried, rarely
from jaxsim.status import Status

Scalar = Any
Field = Callable[[Scalar, State], State]

# A sampled law reads signals so much after its tick, as a share of a step.
_AFTER = 1e-3
# Of the Taylor series, where modes are affine. On the bench at dt = 2e-4 s a run takes a fifth less
# time than with Dormand and Prince's method, and ends with a sixth of its error.
_ORDER = 6


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
    modes: tuple[Scalar, ...]
    x: State
    rates: State
    end_rates: State


class _Aim(NamedTuple):
    """How far a located step goes."""

    h: Scalar
    rest: Scalar  # to the end of the tick or a breakpoint
    whole: Scalar  # reaches it
    ticked: Scalar  # reaches the end of the tick


def _try(loop: ClosedLoop, c: Carry, t: Scalar, h: Scalar) -> _Trial:
    when = When(t, jax.lax.stop_gradient(t + 0.5 * h))
    end = when._replace(t=t + h)
    modes = events.settled(loop, when, c.x, c.modes, c.held) if loop.located else c.modes

    def field(at: Scalar, x: State) -> State:
        return events.field(loop, when._replace(t=at), x, modes, c.held)

    x, rates = _flow(loop, field, t, c.x, h)
    return _Trial(when, end, h, modes, x, rates, field(end.t, x))


def _flow(loop: ClosedLoop, field: Field, t: Scalar, x: State, h: Scalar) -> tuple[State, State]:
    """x(t + h), and the rates at t."""
    if not loop.deadzone.located:
        # The error of a step across an unseen event is O(dt): more would be for nothing.
        return integrate.step(integrate.CLASSICAL, field, t, x, h)
    if integrate.affine(field, t, x):
        return integrate.taylor(_ORDER, field, t, x, h)
    return integrate.step(integrate.DORMAND_PRINCE, field, t, x, h)


class _Verdict(NamedTuple):
    """What a trial turned out to be."""

    accept: Scalar
    reject: Scalar  # a surface is left on the way
    landed: Scalar  # accepted, on the surface aimed at
    failed: Scalar  # not finite
    landing: Landing
    exit: Exit


def _ends(loop: ClosedLoop, c: Carry, trial: _Trial) -> tuple[Guards, Guards]:
    """The guards at both ends of a trial."""
    start = events.guards(loop, trial.when, c.x, trial.modes, c.held, trial.rates)
    return start, events.guards(loop, trial.end, trial.x, trial.modes, c.held, trial.end_rates)


def _clearance(loop: ClosedLoop, c: Carry, trial: _Trial) -> Scalar:
    """Negative where a trial may leave a surface, or goes to one."""
    clear = events.clearance(loop.surfaces, trial.modes, *_ends(loop, c, trial), trial.h)
    return lesser(clear, -0.5 - c.target.astype(trial.h.dtype))


def _judge(loop: ClosedLoop, c: Carry, trial: _Trial, rest: Scalar, active: Scalar) -> _Verdict:
    def found() -> tuple[Landing, Exit]:
        # Evaluated again: what a branch takes from outside is written to memory in every step.
        start, end = _ends(loop, c, trial)
        landing = events.landing(loop.surfaces, c.target, end, trial.h, rest, loop.dt)
        ignored = jnp.where(landing.landed, c.target, -1)
        return landing, events.earliest_exit(loop, trial.modes, start, end, trial.h, ignored)

    def nothing() -> tuple[Landing, Exit]:
        return Landing.none(trial.h), Exit.none(trial.h)

    landing, exit_ = rarely(_clearance(loop, c, trial), found, nothing)
    finite = _finite(trial.x)
    accept = active & finite & ~exit_.any
    reject = active & finite & exit_.any
    landed = accept & landing.landed
    return _Verdict(accept, reject, landed, active & ~finite, landing, exit_)


def micro_step(
    loop: ClosedLoop, c: Carry, until: Any, metrics: Any, stored: bool
) -> tuple[Carry, Mark | None]:
    """One micro-step towards tick `until`; a run that has arrived stays as it is."""
    if not loop.located:
        return _open_step(loop, c, until, metrics, stored)
    if stored:
        return located_step(loop, c, until, metrics, stored)
    quick, rare = quick_step(loop, c, running(c, until), metrics)

    def located(quick: Carry) -> Carry:
        return choose(rare, located_step(loop, quick, until, metrics)[0], quick)

    return jax.lax.cond(any_member(rare), located, lambda quick: quick, quick), None


def running(c: Carry, until: Any) -> Scalar:
    """Whether a run is still on its way to tick `until`."""
    return (c.tick < until) & (c.status == Status.OK.value)


def quick_step(loop: ClosedLoop, c: Carry, moves: Scalar, metrics: Any) -> tuple[Carry, Scalar]:
    """A step of members to which nothing happens in it; and which of those that move are left.

    Nineteen of twenty steps of a member are such ones.
    """
    t = now(loop, c)
    to_tick, to_break = _distances(loop, t, c.elapsed)
    ticked, rest = to_tick <= to_break, jnp.minimum(to_tick, to_break)
    (new, trial), margins = hurried(lambda: _gone_on(loop, c, metrics, t, rest, ticked))
    least = _clearance(loop, c, trial)
    for margin in margins:
        least = lesser(margin, least)  # in this order: a metric without a task has a margin of nan
    fine = (least >= 0.0) & _finite(trial.x)
    return choose(moves & fine, new, c), moves & ~fine


def _open_step(
    loop: ClosedLoop, c: Carry, until: Any, metrics: Any, stored: bool
) -> tuple[Carry, Mark | None]:
    """The rest of the tick, or of the signals' piece; of no length where a run has arrived.

    It also moves what has diverged: `sound` undoes that.
    """
    going = c.tick < until
    t = now(loop, c)
    to_tick, to_break = _distances(loop, t, c.elapsed)
    h = jnp.where(going, jnp.minimum(to_tick, to_break), 0.0)
    ticked = going & (to_tick <= to_break)

    def step() -> tuple[Carry, _Trial]:
        return _gone_on(loop, c, metrics, t, h, ticked)

    new, _ = hurried(step)[0] if loop.deadzone.rough else step()
    if loop.drive.load.turns_singular:
        new = sound(c, new)  # the angles before the failure tell its cause
    if not stored:
        return new, None
    fine = new.status == Status.OK.value
    return new, _mark(loop, new, jnp.full_like(c.tick, -1), jnp.zeros_like(t), ticked & fine)


def _gone_on(
    loop: ClosedLoop, c: Carry, metrics: Any, t: Scalar, h: Scalar, ticked: Scalar
) -> tuple[Carry, _Trial]:
    """All that a run knows after a trial that is taken as it is."""
    trial = _try(loop, c, t, h)
    tick = c.tick + ticked.astype(c.tick.dtype)
    elapsed = jnp.where(ticked, 0.0, c.elapsed + trial.h)
    new = c._replace(tick=tick, elapsed=elapsed, x=trial.x, modes=trial.modes)
    new = new._replace(held=_turned(loop, c, new, trial.end.t, ticked))
    return new._replace(folds=_fold(loop, metrics, c, trial, trial.x, trial.h)), trial


def sound(c: Carry, new: Carry) -> Carry:
    """`new` where it is finite; else, and after an earlier failure, the state of `c`.

    Once per block of open steps: in each it would cost a fifth of the step.
    """
    fine = c.status == Status.OK.value
    finite = _finite(new.x)
    kept = choose(fine & finite, (new.x, new.held, new.folds), (c.x, c.held, c.folds))
    status = jnp.where(fine & ~finite, Status.DIVERGED.value, new.status)
    return new._replace(x=kept[0], held=kept[1], folds=kept[2], status=status)


def located_step(
    loop: ClosedLoop, c: Carry, until: Any, metrics: Any, stored: bool = False
) -> tuple[Carry, Mark | None]:
    """Try, judge, and go on from there; a run that has arrived or failed stays as it is."""
    active = running(c, until)
    t = now(loop, c)
    aim = _aim(loop, c, t)
    trial = _try(loop, c, t, aim.h)
    verdict = _judge(loop, c, trial, aim.rest, active)
    shift = jnp.where(verdict.landed, verdict.landing.correction, 0.0)
    x, length = _shift(trial.x, trial.end_rates, shift), trial.h + shift
    ticked = verdict.accept & ~verdict.landed & aim.ticked
    new = _moved(c, trial, verdict, x, length, ticked)
    new = new._replace(held=_turned(loop, c, new, t + length, ticked))
    folds = _fold(loop, metrics, c, trial, x, length)
    new = new._replace(folds=choose(verdict.accept, folds, c.folds))
    new = _aimed(c, new, aim, verdict, active)
    if not stored:
        return new, None
    event = jnp.where(verdict.landed, c.target, -1)
    return new, _mark(loop, new, event, verdict.landing.rate, ticked)


def _aim(loop: ClosedLoop, c: Carry, t: Scalar) -> _Aim:
    to_tick, to_break = _distances(loop, t, c.elapsed)
    rest = jnp.minimum(to_tick, to_break)
    whole = c.trial >= rest
    h = jnp.where(whole, rest, jax.lax.stop_gradient(c.trial))
    return _Aim(h, rest, whole, whole & (to_tick <= to_break))


def _turned(loop: ClosedLoop, c: Carry, new: Carry, end: Scalar, ticked: Scalar) -> Any:
    """What a sampled law holds after its turn, if this step ends a tick."""
    if not loop.clocked:
        return c.held
    # The piece that begins here: rounding of `end` must not leave it on the one before.
    now = When(end, end + _AFTER * loop.dt)
    return choose(ticked, loop.on_tick(new.tick, now, new.x, new.modes, c.held), c.held)


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


def _aimed(c: Carry, new: Carry, aim: _Aim, verdict: _Verdict, active: Scalar) -> Carry:
    """What to try next: an exit found, the rest of the way to one that was missed, or all."""
    missed = verdict.accept & ~verdict.landed & ~aim.whole
    way = jnp.where(missed, verdict.landing.ahead, jnp.inf)
    way = jnp.where(verdict.reject, verdict.exit.share * jax.lax.stop_gradient(aim.h), way)
    target = jnp.where(missed, c.target, -1)
    return new._replace(
        trial=jnp.where(active, way, c.trial),
        target=jnp.where(verdict.reject, verdict.exit.surface, target),
        events=c.events + verdict.landed.astype(c.events.dtype),
        status=jnp.where(verdict.failed, Status.DIVERGED.value, c.status),
    )


def now(loop: ClosedLoop, c: Carry) -> Scalar:
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


def _finite(x: State) -> Scalar:
    """Whether all is finite: a sum is not, if a term of it is not."""
    return jnp.isfinite(sum(jax.tree.leaves(x)))


def _fold(loop: ClosedLoop, metrics: Any, c: Carry, trial: _Trial, x: State, length: Scalar) -> Any:
    """The metrics updated by a piece."""
    if not c.folds:
        return c.folds
    when, modes = trial.when, trial.modes
    end = when._replace(t=when.t + length)
    before, before_rate = _outputs_and_rates(loop, when, c.x, modes, c.held, trial.rates)
    after, after_rate = _outputs_and_rates(loop, end, x, modes, c.held, trial.end_rates)
    pieces = (
        Piece(when.t, length, *ends)
        for ends in zip(before, before_rate, after, after_rate, strict=True)
    )
    return tuple(
        tuple(m.update(fold, piece) for m, fold in zip(own, folds, strict=True))
        for own, folds, piece in zip(metrics, c.folds, pieces, strict=True)
    )


def still(loop: ClosedLoop, c: Carry) -> Mark:
    """The mark of a run that does not move."""
    zero = jnp.zeros_like(c.elapsed)
    return _mark(loop, c, jnp.full_like(c.tick, -1), zero, jnp.zeros_like(c.tick, bool))


def _mark(loop: ClosedLoop, c: Carry, event: Scalar, slope: Scalar, ticked: Scalar) -> Mark:
    t = now(loop, c)
    outputs = loop.outputs(When(t, t + 1e-6 * loop.dt), c.x, c.modes, c.held)
    return Mark(t, ticked, event, jnp.where(event >= 0, slope, 0.0), outputs)


__all__ = [
    "Carry", "Mark", "Piece", "located_step", "micro_step", "now", "quick_step", "running",
    "sound", "still",
]  # fmt: skip
