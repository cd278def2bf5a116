"""Residuals: the one engine, sampled where the logs were read, less the readings."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import batch, simulate
from jaxsim.batch import Batch
from jaxsim.errors import InputError
from jaxsim.hybrid import Deadzone, Exact
from jaxsim.signals.samples import Samples
from jaxsim.signals.table import Table
from jaxsim.status import Status
from tuning.identification.experiment import Experiment, Model, Sensor, model_of
from tuning.identification.unknowns import Free, Unknowns, with_values

# The rate of a signal, where a run has it: angles are read between ticks by cubics.
_RATES = {"theta_L": "omega_L", "theta_M": "omega_M", "theta_B": "omega_B"}
# A reading counts as taken at a tick when it is this close to one, as a share of dt.
_ON_TICK = 1e-6
# Runs in one portion: enough for two cores; what the rest of a portion costs is soon more than
# what a larger one saves.
_LANES = 128
_KEPT = 16  # portions whose arrays stay on the device


class Readings(eqx.Module):
    """The readings of one experiment as arrays (signals, samples), filled up to a common length."""

    times: Any
    values: Any
    noise: Any
    used: Any


class Evaluation(NamedTuple):
    """Residuals of a batch of fits, in standard deviations of the noise.

    residuals: (F, E, signals, samples), 0 where masked; jacobian: the same with a last axis of
    len(free), by scaled values; both nan from where a run failed. status: (F, E) of the runs.
    contact: (F, E, 2) shares of a run in positive and negative contact (of the first axis).
    """

    residuals: np.ndarray
    jacobian: np.ndarray
    status: np.ndarray
    contact: np.ndarray


class Problem:
    """Experiments and free parameters, ready to be simulated side by side.

    `evaluate` gives residuals and their forward-mode derivatives for many fits at once: each fit
    is one value per column of `unknowns`. `who` (F, E') says which experiments a fit looks at;
    without it all fits look at all. Rows of `who` may differ and repeat: bootstrap samples, or
    many independent logs, each with a fit of its own.

    dt: integration step, s; the durations are rounded up to it. width: fits side by side. All
    runs go through one program in portions of equal size: it is compiled once, whatever is asked.
    exact: how much room for events the runs have.

    Raises: InputError where the experiments do not have the same components and signals.
    """

    def __init__(
        self, experiments: Sequence[Experiment], free: Sequence[Free], *, dt: float,
        width: int = 1, exact: Exact | None = None,
    ) -> None:  # fmt: skip
        if not experiments:
            raise InputError("experiments", "must hold at least one", "none", "add a log")
        if not free:
            raise InputError("free", "must name a parameter", "none", "free at least one")
        kinds = {e.signals for e in experiments}
        if len(kinds) > 1:
            fix = "fit them apart"
            raise InputError("experiments", "must measure the same signals", sorted(kinds), fix)
        self.experiments, self.dt, self.exact = tuple(experiments), dt, exact or Exact()
        self._kept: dict[Any, tuple[Batch, Batch]] = {}
        self.lanes = min(width * len(self.experiments), _LANES)
        self.unknowns = Unknowns(tuple(free), tuple(e.name for e in experiments))
        self.models, self.axes = _stacked(_alike([model_of(e) for e in experiments], dt))
        self.readings = _readings(self.experiments)
        self.ends = self.readings.times.max(axis=(1, 2))
        own_delay = any(f.paths[0].endswith(".delay") for f in free)
        self.store = 1 if own_delay else _stride(self.experiments, dt)

    @property
    def signals(self) -> tuple[str, ...]:
        return self.experiments[0].signals

    def narrowed(self, lanes: int) -> Problem:
        """The same with portions of at most so many runs, and nothing on a device: to be sent."""
        other = copy.copy(self)
        other.lanes, other._kept = min(lanes, self.lanes), {}
        return other

    def initial(self) -> np.ndarray:
        """(P,) the values that the experiments hold: where a fit starts if nothing else is said."""
        return self.unknowns.initial(self.experiments)

    def everyone(self, fits: int) -> np.ndarray:
        """`who` for fits that all look at all experiments."""
        return np.tile(np.arange(len(self.experiments)), (fits, 1))

    def reweigh(self, factor: np.ndarray) -> None:
        """Multiply the noise that is assumed of each signal by a factor (signals,)."""
        self._kept.clear()
        noise = self.readings.noise * factor
        self.readings = Readings(
            self.readings.times, self.readings.values, noise, self.readings.used
        )

    def evaluate(
        self, values: np.ndarray, scale: np.ndarray | None = None, *,
        who: np.ndarray | None = None, deadzone: Deadzone | None = None, horizon: float = 1.0,
    ) -> Evaluation:  # fmt: skip
        """Residuals and Jacobian at values (F, P); scale (F, P) multiplies the derivatives.

        horizon: share of the duration whose readings count.
        """
        values = np.atleast_2d(np.asarray(values, float))
        scale = np.ones_like(values) if scale is None else np.broadcast_to(scale, values.shape)
        who = self.everyone(len(values)) if who is None else who
        how = _How(
            self.unknowns.free, self.signals, self.dt, self.store,
            self.exact if deadzone is None else deadzone,
        )  # fmt: skip
        columns = self.unknowns.columns()[who]  # (F, E, len(free))
        fits = np.arange(len(values))[:, None, None]
        own, sizes = (v[fits, columns].reshape(-1, columns.shape[-1]) for v in (values, scale))
        parts = self._members(how, who.ravel(), own, sizes, horizon)
        residuals, jacobian, status, contact = (v.reshape(*who.shape, *v.shape[1:]) for v in parts)
        return Evaluation(residuals, np.moveaxis(jacobian, 2, -1), status, contact)

    def _portion(self, who: np.ndarray, horizon: float) -> tuple[Batch, Batch]:
        """Trees and readings of some runs, on the device.

        The last ones are kept: a fit asks for the same ones in every iteration, and to move some
        thirty small arrays takes as long as to simulate a short log.
        """
        key = (who.tobytes(), horizon)
        if key not in self._kept:
            end = horizon * self.ends[who]
            mine = _until(jax.tree.map(lambda v: v[who], self.readings), end)
            # A reading between two stored instants needs the one after it.
            whole = mine, end + self.store * self.dt
            trees = _picked(self.models, self.axes, who), Batch(whole, (True,) * 5, len(who))
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            self._kept[key] = jax.tree.map(jnp.asarray, trees)
        return self._kept[key]

    def _members(
        self, how: _How, who: np.ndarray, values: np.ndarray, scale: np.ndarray, horizon: float
    ) -> list[np.ndarray]:
        """The parts of an evaluation, one row per run, in portions of `lanes` runs."""
        pieces = []
        for at in range(0, len(who), self.lanes):
            rows = np.minimum(np.arange(at, at + self.lanes), len(who) - 1)
            kept = min(self.lanes, len(who) - at)
            own = (Batch(v[rows], (True,), self.lanes) for v in (values, scale))
            piece = batch.gathered(_members(how, *self._portion(who[rows], horizon), *own))
            pieces.append([np.asarray(v)[:kept] for v in piece])
        return [np.concatenate(v) for v in zip(*pieces, strict=True)]


class _How(eqx.Module):
    """All that is static in a member's evaluation."""

    free: tuple[Free, ...] = eqx.field(static=True)
    signals: tuple[str, ...] = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    store: int = eqx.field(static=True)
    deadzone: Deadzone


@eqx.filter_jit
def _members(how: _How, *members: Batch) -> Any:
    return batch.map_members(lambda *own: _member(how, *own), *members)


def _member(how: _How, model: Model, read: tuple[Readings, Any], values: Any, scale: Any) -> Any:
    """Residuals (signals, samples), their derivatives (len(free), ...) and status of one run."""
    readings, until = read

    def residuals(v: Any) -> tuple[Any, Any]:
        own = with_values(model, how.free, v)
        run = simulate(
            own.drive, own.law, own.scenario,
            dt=how.dt, deadzone=how.deadzone, metrics=(), store=how.store, throw=False, until=until,
        )  # fmt: skip
        rows, known = zip(
            *(
                reading(run.signals, name, sensor, readings.times[i], how.store * how.dt)
                for i, (name, sensor) in enumerate(zip(how.signals, own.sensors, strict=True))
            ),
            strict=True,
        )
        found = (jnp.stack(rows) - readings.values) / readings.noise[:, None]
        found = jnp.where(jnp.stack(known), found, 0.0)
        # An invalid member (a broken rule) still runs; its numbers must not count.
        found = jnp.where(run.status == Status.INVALID.value, jnp.nan, found)
        return jnp.where(readings.used, found, 0.0), (run.status, _contact(run.signals))

    def push(direction: Any) -> Any:
        found, moved, (status, contact) = jax.jvp(residuals, (values,), (direction,), has_aux=True)
        return found, moved, status, contact

    return jax.vmap(push, out_axes=(None, 0, None, None))(jnp.diag(scale))


def _contact(signals: Any) -> Any:
    """Shares of the stored instants in positive and in negative contact, of the first axis."""
    sides = signals["contact"]
    sides = sides if sides.ndim == 1 else sides[:, 0]
    reached = jnp.sum(jnp.isfinite(sides))
    return jnp.stack([jnp.sum(sides > 0.0), jnp.sum(sides < 0.0)]) / jnp.maximum(reached, 1)


def reading(signals: Any, name: str, sensor: Sensor, times: Any, h: float) -> tuple[Any, Any]:
    """What a sensor reads at `times` (s) of stored signals with a spacing of h (s), and if it does.

    Between the stored instants: cubics for angles, whose rates are stored too, else straight lines.
    Not known is a torque between two instants of which one is in contact and one is not: it jumps
    at an impact, and a straight line is off by thirty times the noise of the bench's sensor.
    """
    base, index = signal_name(name)
    values = _axis(signals[base], index)
    at = (times - sensor.delay) / h
    left = jnp.clip(jnp.floor(jax.lax.stop_gradient(at) + _ON_TICK), 0.0, 1.0 * values.shape[0] - 2)
    u = jnp.maximum(at - left, 0.0)
    i = left.astype(jnp.int32)
    a, b = values[i], values[i + 1]
    if base in _RATES:
        rates = _axis(signals[_RATES[base]], index)
        da, db = h * rates[i], h * rates[i + 1]
        bend = u * (1.0 - u)
        found = a + u * (b - a) + bend * ((1.0 - u) * (da - b + a) + u * (b - a - db))
    else:
        found = a + u * (b - a)
    known = jnp.full(times.shape, True)
    if base == "T_s":
        side = _axis(signals["contact"], index)
        known = (side[i] == side[i + 1]) | (u <= _ON_TICK)
    return sensor.scale * found + sensor.offset, known


def signal_name(name: str) -> tuple[str, int | None]:
    """Name and axis: theta_L[1] is ("theta_L", 1); None stands for the only axis."""
    base, _, index = name.partition("[")
    return base, int(index.rstrip("]")) if index else None


def _axis(values: Any, index: int | None) -> Any:
    return values if index is None else values[:, index]


def _stride(experiments: Sequence[Experiment], dt: float) -> int:
    """The coarsest spacing, in ticks, on which all readings lie; 1 where they lie between ticks."""
    delayed = any(float(m.sensor.delay) != 0.0 for e in experiments for m in e.measurements)
    ticks = np.concatenate([m.times / dt for e in experiments for m in e.measurements])
    whole = np.round(ticks)
    if delayed or np.abs(ticks - whole).max() > _ON_TICK * max(1.0, whole.max() * 1e-3):
        return 1
    stride = int(np.gcd.reduce(whole.astype(int)))
    ends = [int(np.ceil(e.scenario.duration / dt - _ON_TICK)) for e in experiments]
    return max(1, int(np.gcd(stride, max(ends))))


def _alike(models: list[Model], dt: float) -> list[Model]:
    """The same durations (the longest, in whole steps), and tables of the same lengths."""
    ticks = max(int(np.ceil(m.scenario.duration / dt - _ON_TICK)) for m in models)
    models = [
        eqx.tree_at(lambda m: m.scenario, m, _lasting(m.scenario, ticks * dt)) for m in models
    ]
    leaves = [jax.tree.flatten(m, is_leaf=_is_table) for m in models]
    structures = {str(structure) for _, structure in leaves}
    if len(structures) > 1:
        fix = "fit them apart"
        raise InputError("experiments", "must have the same components", "several kinds", fix)
    columns = [_same_length(list(column)) for column in zip(*(v for v, _ in leaves), strict=True)]
    return [
        jax.tree.unflatten(structure, list(row))
        for row, (_, structure) in zip(zip(*columns, strict=True), leaves, strict=True)
    ]


def _lasting(scenario: Any, duration: float) -> Any:
    parts = scenario.reference, scenario.load_torque, scenario.start
    return type(scenario)(*parts, duration=duration)


def _is_table(node: Any) -> bool:
    return isinstance(node, Table | Samples)


def _same_length(tables: list[Any]) -> list[Any]:
    """Tables filled up with their last value, as they are read beyond their end anyway."""
    if not _is_table(tables[0]):
        return tables
    longest = max(np.shape(t.values)[-1] for t in tables)
    return [_filled(t, longest - np.shape(t.values)[-1]) for t in tables]


def _filled(table: Any, more: int) -> Any:
    if more == 0:
        return table
    values = np.pad(np.asarray(table.values), (0, more), mode="edge")
    if isinstance(table, Samples):
        return Samples(values, table.period, table.between, table.on_ticks)
    times = np.asarray(table.times)
    # Beyond any run: breakpoints there are never met.
    later = times[-1] + 1e6 * np.arange(1, more + 1)
    return Table(np.concatenate([times, later]), values, table.between)


def _stacked(models: list[Model]) -> tuple[Model, tuple[bool, ...]]:
    """All trees in one, and which leaves differ and so carry a leading axis of experiments."""
    flat = [jax.tree.flatten(m) for m in models]
    columns = [
        [np.asarray(v) for v in column] for column in zip(*(v for v, _ in flat), strict=True)
    ]
    own = tuple(any(not np.array_equal(v, column[0]) for v in column) for column in columns)
    merged = [np.stack(c) if differ else c[0] for c, differ in zip(columns, own, strict=True)]
    return jax.tree.unflatten(flat[0][1], merged), own


def _picked(models: Model, own: tuple[bool, ...], rows: np.ndarray) -> Batch:
    leaves, structure = jax.tree.flatten(models)
    picked = [v[rows] if mine else v for v, mine in zip(leaves, own, strict=True)]
    return Batch(jax.tree.unflatten(structure, picked), own, len(rows))


def _readings(experiments: Sequence[Experiment]) -> Readings:
    longest = max(len(m.times) for e in experiments for m in e.measurements)

    def filled(name: str) -> np.ndarray:
        return np.array(
            [
                [_tail(np.asarray(getattr(m, name)), longest) for m in e.measurements]
                for e in experiments
            ]
        )

    noise = np.array([[m.noise for m in e.measurements] for e in experiments])
    return Readings(filled("times"), filled("values"), noise, filled("used"))


def _until(readings: Readings, end: np.ndarray) -> Readings:
    """Only the readings up to an instant of each experiment count."""
    used = readings.used & (readings.times <= end[:, None, None])
    return Readings(readings.times, readings.values, readings.noise, used)


def _tail(values: np.ndarray, length: int) -> np.ndarray:
    """Filled up to a length: unused, zero, at time 0."""
    return np.pad(values, (0, length - len(values)))
