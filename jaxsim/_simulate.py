"""simulate(drive, law, scenario) -> Run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import batch, engine
from jaxsim.batch import Batch
from jaxsim.catalog import METRICS
from jaxsim.criterion import Criterion, Subject, chosen
from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.hybrid import Deadzone, Exact
from jaxsim.loop import ClosedLoop, Outputs, When
from jaxsim.metric import Metric, choose, task_of
from jaxsim.parameters import is_concrete, violations
from jaxsim.pruned import prune
from jaxsim.run import Run
from jaxsim.scenario import Scenario
from jaxsim.status import Status
from jaxsim.tree import cast


class RunError(RuntimeError):
    """A run did not complete; the message names the members and why, `run` holds the results."""

    def __init__(self, message: str, run: Run) -> None:
        super().__init__(message)
        self.run = run


class _Options(eqx.Module):
    """All that is static in a run."""

    ticks: int = eqx.field(static=True)
    store: int | None = eqx.field(static=True)
    groups: tuple[type[Metric], ...] = eqx.field(static=True)
    names: tuple[str, ...] | None = eqx.field(static=True)
    criteria: tuple[type[Criterion], ...] = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    deadzone: Deadzone


def simulate(
    drive: Drive | Batch,
    law: Any,
    scenario: Scenario | Batch,
    *,
    dt: float = 2e-4,
    deadzone: Deadzone | None = None,
    metrics: tuple[str, ...] | None = None,
    store: int | None = 1,
    dtype: Any = None,
    throw: bool = True,
    until: Any = None,
) -> Run:
    """Run a drive under a law through a scenario.

    drive, law, scenario: single, or `Batch` (then everything in the result has a leading axis).
    dt: integration step, s; a sampled law's period must be a multiple of it. deadzone: `Exact()`
    (default), `Smoothed(...)` or `Plain()`. metrics: names to compute, of metrics and of stability
    criteria; None for all metrics, () for none.
    store: keep the signals every so many ticks, None keeps no trajectory. dtype: float32 or
    float64, default JAX's. throw: raise when a run does not complete (never inside jit). until: an
    earlier end than the scenario's, s; unlike that one it may be traced: what is compiled serves
    all ends, and signals after it are nan.

    Works under jit and vmap, and in forward and reverse mode with respect to every parameter.

    Returns: `Run`. Raises: InputError for arguments that do not fit together, before anything
    runs; RunError (with the results of the members that completed in it) after the run.
    """
    options = _options(scenario, dt, deadzone, metrics, store)
    size = batch.size_of(drive, law, scenario)
    dtype = jnp.dtype(jax.dtypes.canonicalize_dtype(float) if dtype is None else dtype)
    trees = tuple(cast(t, dtype) for t in (drive, law, scenario))
    single = [t[0] if isinstance(t, Batch) else t for t in trees]
    loop = ClosedLoop(single[0], single[1], single[2], options.deadzone, dt)
    end = options.ticks if until is None else _ticks(until, options)
    found = (_run if size is None else _run_batch)(options, end, *trees)
    arrays = found if size is None else batch.gathered(found)
    # jit hands dictionaries back in alphabetical order; people read them by group.
    every = tuple(v for group in options.groups for v in group.values)
    order = every if metrics is None else tuple(metrics)
    arrays["metrics"] = {name: arrays["metrics"][name] for name in order}
    problems = _problems(arrays["status"], (drive, law, scenario))
    run = Run(**arrays, surfaces=loop.surface_names(), units=loop.units, problems=problems)
    if throw and is_concrete(run.status):
        _raise_failures(run)
    return run


def _options(
    scenario: Any,
    dt: float,
    deadzone: Deadzone | None,
    metrics: tuple[str, ...] | None,
    store: int | None,
) -> _Options:
    if store is not None and store < 1:
        raise InputError("store", "must be >= 1 or None", store, "e.g. 1 for every tick")
    ticks = (scenario.members if isinstance(scenario, Batch) else scenario).ticks(dt)
    known = METRICS.all()
    every = tuple(v for group in known.values() for v in group.values)
    wanted = every if metrics is None else tuple(metrics)
    criteria = chosen(wanted, every)
    own = tuple(name for name in wanted if name in every)
    names = None if metrics is None else own
    deadzone = Exact() if deadzone is None else deadzone
    return _Options(ticks, store, choose(known, own), names, criteria, dt, deadzone)


def _ticks(until: Any, options: _Options) -> Any:
    """The tick at or after an instant (to rounding), at most the last one."""
    return jnp.clip(jnp.ceil(until / options.dt - 1e-6), 0, options.ticks).astype(jnp.int32)


@eqx.filter_jit
def _run(options: _Options, end: Any, drive: Drive, law: Any, scenario: Scenario) -> dict[str, Any]:
    """One run to tick `end`, as a dictionary of arrays."""
    loop = ClosedLoop(drive, law, scenario, options.deadzone, options.dt)
    metrics = tuple(_axis_metrics(loop, options, axis) for axis in range(drive.axes))
    folds = tuple(tuple(m.start() for m in own) for own in metrics)
    carry = engine.start(loop, folds if options.groups else ())
    steps = engine.budget(loop, options.ticks)
    stored = options.store is not None
    last, marks = engine.advance(loop, carry, end, steps, metrics, stored)
    arrays = _trajectory(loop, options, carry, marks) if marks is not None else _no_trajectory()
    numbers = _metrics(options, metrics, last) | _criteria(options, loop)
    bad = last.status == Status.INVALID.value
    numbers = {k: jnp.where(bad, jnp.nan, v) for k, v in numbers.items()}
    return {**arrays, "metrics": numbers, "status": last.status, "event_count": last.events}


def _axis_metrics(loop: ClosedLoop, options: _Options, axis: int) -> tuple[Any, ...]:
    """The metrics of one axis, carrying only what the numbers asked for stand on."""
    whole = tuple(group(task_of(loop, axis, group.reference_unit)) for group in options.groups)
    return whole if options.names is None else tuple(prune(m, options.names) for m in whole)


@eqx.filter_jit
def _run_batch(options: _Options, end: Any, *trees: Any) -> dict[str, Any]:
    def one(end: Any, *single: Any) -> dict[str, Any]:
        return _run(options, end, *single)

    return batch.map_members(one, end, *trees, located=options.deadzone.located)


def _metrics(options: _Options, metrics: Any, carry: engine.Carry) -> dict[str, Any]:
    if not options.groups:
        return {}
    per_axis = []
    for own, folds in zip(metrics, carry.folds, strict=True):
        numbers: dict[str, Any] = {}
        for metric, fold in zip(own, folds, strict=True):
            numbers |= metric.finish(fold)
        per_axis.append(numbers)
    names = options.names if options.names is not None else tuple(per_axis[0])
    if len(per_axis) == 1:
        return {name: per_axis[0][name] for name in names}
    return {name: jnp.stack([axis[name] for axis in per_axis]) for name in names}


def _criteria(options: _Options, loop: ClosedLoop) -> dict[str, Any]:
    """The numbers of the stability criteria, one per axis where there are several."""

    def again(scenario: Scenario, names: tuple[str, ...]) -> dict[str, Any]:
        groups = choose(METRICS.all(), names)
        own = replace(options, store=None, groups=groups, names=names, criteria=())
        found = _run(own, own.ticks, loop.drive, loop.law, scenario)
        completed = found["status"] == Status.OK.value
        return {k: jnp.where(completed, v, jnp.nan) for k, v in found["metrics"].items()}

    numbers: dict[str, Any] = {}
    subject = Subject(loop, again)
    for criterion in options.criteria:
        numbers |= criterion().measure(subject)
    axes = loop.drive.axes
    shape = () if axes == 1 else (axes,)
    return {k: jnp.broadcast_to(v.reshape(-1), (axes,)).reshape(shape) for k, v in numbers.items()}


def _no_trajectory() -> dict[str, Any]:
    none = jnp.zeros((0,))
    codes = jnp.zeros((0,), jnp.int32)
    return {
        "time": none,
        "signals": {},
        "event_times": none,
        "event_surfaces": codes,
        "event_rates": none,
    }


def _trajectory(
    loop: ClosedLoop, options: _Options, first: engine.Carry, marks: engine.Mark
) -> dict[str, Any]:
    """Signals at the ticks, out of the marks of all micro-steps; nan after a failure."""
    wanted = np.arange(options.store, options.ticks + 1, options.store)  # type: ignore[arg-type]
    reached = jnp.cumsum(marks.ticked)
    where = jnp.searchsorted(reached, jnp.asarray(wanted))
    known = where < reached.shape[0]
    where = jnp.minimum(where, reached.shape[0] - 1)
    zero = jnp.zeros_like(first.elapsed)
    initial = loop.outputs(When(zero, zero), first.x, first.modes, first.held)

    def column(start: Any, values: Any) -> Any:
        picked = jnp.where(known, values[where], jnp.nan)
        return jnp.concatenate([jnp.asarray(start)[None], picked])

    axes = [
        Outputs(*(column(s, v) for s, v in zip(begin, rest, strict=True)))
        for begin, rest in zip(initial, marks.outputs, strict=True)
    ]
    signals = {
        name: getattr(axes[0], name)
        if len(axes) == 1
        else jnp.stack([getattr(a, name) for a in axes], axis=-1)
        for name in Outputs._fields
    }
    time = jnp.concatenate([jnp.zeros(1), jnp.asarray(wanted) * loop.dt]).astype(zero.dtype)
    return {
        "time": time,
        "signals": signals,
        "event_times": marks.t,
        "event_surfaces": marks.event,
        "event_rates": marks.rate,
    }


def _problems(status: Any, trees: tuple[Any, ...]) -> dict[int, str]:
    """Which parameter of which member breaks its rule, in words; looked up only if any does."""
    if not is_concrete(status):
        return {}
    bad = np.flatnonzero(np.atleast_1d(np.asarray(status)) == Status.INVALID.value)
    found = {}
    for i in bad.tolist():
        single = tuple(t[i] if isinstance(t, Batch) else t for t in trees)
        words = [v for tree in single for v in violations(tree)]
        found[i] = "; ".join(words)
    return found


def _raise_failures(run: Run) -> None:
    failures = run.failures()
    if not failures:
        return
    listed = "; ".join(
        (f"member {i}: {why}" if run.batched else why) for i, why in list(failures.items())[:5]
    )
    more = f" (and {len(failures) - 5} more)" if len(failures) > 5 else ""
    raise RunError(f"{listed}{more}", run)
