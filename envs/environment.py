"""Environments as pure functions on the engine: reset(key), step(state, action)."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from envs.task import TASKS, Episode, Task
from jaxsim import engine
from jaxsim.catalog import METRICS
from jaxsim.errors import InputError, called
from jaxsim.hybrid import Deadzone, Exact, Plain
from jaxsim.law import Measured, as_joint_law
from jaxsim.loop import ClosedLoop, When
from jaxsim.metric import choose, task_of
from jaxsim.observation import Horizon, Memory, Seen, act, first_memory, observe, remember
from jaxsim.pruned import prune
from jaxsim.sampled import Encoders, Noisy, Sensors, TrueSpeeds
from jaxsim.status import Status
from jaxsim.tree import cast

Scalar = Any

# Room for events in one control period; a drive that has more of them does not arrive, and the
# episode ends as failed. Rest against a wall of the gap makes one or two per millisecond.
_EVENTS = 15


class State(NamedTuple):
    """One episode between two control periods.

    sensors: of this episode; seen: their newest readings; told: those that the observation is made
    of; late: whether those are of one period ago. age: episodes before this one since the seed;
    key: that of the NEXT episode.
    """

    loop: ClosedLoop
    carry: engine.Carry
    sensors: Sensors
    seen: Measured
    told: Measured
    late: Scalar
    memory: Memory
    action: tuple[Scalar, ...]
    cost: Scalar
    age: Scalar
    key: Any


class Info(NamedTuple):
    """status: `jaxsim.status.Status`; numbers: the metrics of the cost so far, SI units."""

    status: Scalar
    numbers: dict[str, Scalar]


class Step(NamedTuple):
    """What one step gives; terminated: the run failed; truncated: the time is over."""

    state: State
    observation: Any
    reward: Scalar
    terminated: Scalar
    truncated: Scalar
    info: Info


class Environment(eqx.Module):
    """A task on the engine. Everything is for ONE environment and pure: jit and vmap at will.

    The reward of a step is minus the increment of the task's cost, so the sum of an episode's
    rewards IS minus the cost of the metrics of the whole run (plus the action rate).

    task: a `Task`. dt: integration step, s; must divide the task's period. deadzone: `Exact()`
    (default) or `Plain()`. sensors: `Encoders()` by default, with the noise and the delay that an
    episode draws; `Differences()` the same without rounding, for gradients; `TrueSpeeds()` for
    exact readings, without noise and delay. dtype: of state and observation, float32 by default.

    Raises: InputError when dt does not divide the period.
    """

    task: Task
    dt: float = eqx.field(static=True, default=2e-4)
    deadzone: Deadzone = eqx.field(default_factory=lambda: Exact(_EVENTS))
    sensors: Sensors = eqx.field(default_factory=Encoders)
    dtype: str = eqx.field(static=True, default="float32")

    def __check_init__(self) -> None:
        if not self.dt > 0.0 or abs(self.ticks * self.dt - self.task.period) > 1e-6 * self.dt:
            raise InputError(
                "dt", f"must divide the control period {self.task.period:g} s", self.dt, "e.g. 2e-4"
            )

    @property
    def ticks(self) -> int:
        """Integration steps in one control period."""
        return max(1, round(self.task.period / self.dt)) if self.dt > 0.0 else 0

    @property
    def steps(self) -> int:
        """Control periods in one episode."""
        return round(self.task.duration / self.task.period)

    def reset(self, key: Any, age: Scalar = 0) -> tuple[State, Any]:
        """A fresh episode: its state and first observation.

        key: of jax.random; age: episodes before this one. The state carries on a new key, to be
        passed to the next reset together with `state.age + 1`.
        """
        following, own, noise = jax.random.split(key, 3)
        age = jnp.asarray(age, jnp.int32)
        episode = self.task.draw(own, age)
        sensors, late = self._equipment(episode, noise)
        law = as_joint_law(self.task.law(), episode.drive.axes)
        drive, law, scenario = cast((episode.drive, law, episode.scenario), self.dtype)
        loop = ClosedLoop(drive, law, scenario, self.deadzone, self.dt)
        metrics = self._metrics(loop)
        carry = engine.start(loop, tuple(tuple(m.start() for m in own) for own in metrics))
        before = _measured(loop, carry, -1.0)
        # Read twice: the drive has been at rest, rounding is no speed.
        rest = self._read(loop, sensors, before, before, 0)
        seen = self._read(loop, sensors, _measured(loop, carry), rest, 1)
        told = _told(late, rest, seen)
        memory = remember(first_memory(rest), told, self._horizon(loop))
        zero = jnp.zeros((), self.dtype)
        numbers = _numbers(self.task, metrics, carry)
        action = (zero,) * len(self.task.actions)
        cost = self.task.cost(numbers)
        readings = sensors, seen, told, late
        state = State(loop, carry, *readings, memory, action, cost, age, following)
        return state, self._observe(state)

    def _equipment(self, episode: Episode, key: Any) -> tuple[Sensors, Scalar]:
        """The sensors of an episode, and whether their readings come late."""
        if isinstance(self.sensors, TrueSpeeds):
            return self.sensors, jnp.zeros((), self.dtype)
        angle, torque, late = cast(episode[2:], self.dtype)
        seed = jax.random.randint(key, (), 0, 2**31 - 1)
        return Noisy(self.sensors, angle, torque, seed), late

    def step(self, state: State, action: Any) -> Step:
        """Hold an action over one control period.

        action: (actions,) in [-1, 1]. It is not checked here; Gymnasium and SB3 doors do.
        """
        actions = tuple(jnp.asarray(action[i], self.dtype) for i in range(len(self.task.actions)))
        law = act(self.task.actions, state.loop.law, actions)
        loop = eqx.tree_at(lambda v: v.law, state.loop, law)
        metrics = self._metrics(loop)
        until = state.carry.tick + self.ticks
        steps = engine.budget(loop, self.ticks)
        carry, _ = engine.advance(loop, state.carry, until, steps, metrics)
        numbers = _numbers(self.task, metrics, carry)
        cost = self.task.cost(numbers)
        number = carry.tick // self.ticks + 1
        seen = self._read(loop, state.sensors, _measured(loop, carry), state.seen, number)
        told = _told(state.late, state.seen, seen)
        memory = remember(state.memory, told, self._horizon(loop))
        new = state._replace(
            loop=loop, carry=carry, seen=seen, told=told, memory=memory, action=actions, cost=cost
        )
        failed = carry.status != Status.OK.value
        over = ~failed & (carry.tick >= self.ticks * self.steps)
        reward = self._reward(state, new, failed)
        info = Info(carry.status, numbers)
        return Step(new, self._observe(new), reward, failed, over, info)

    def _reward(self, old: State, new: State, failed: Scalar) -> Scalar:
        pairs = zip(new.action, old.action, strict=True)
        rate = self.task.action_rate * sum((a - b) ** 2 for a, b in pairs)
        return -jnp.where(failed, self.task.failure, new.cost - old.cost + rate)

    def _metrics(self, loop: ClosedLoop) -> tuple[tuple[Any, ...], ...]:
        names = tuple(self.task.terms)
        groups = choose(METRICS.all(), names)
        whole = (group(task_of(loop, 0, group.reference_unit)) for group in groups)
        return (tuple(prune(metric, names) for metric in whole),)

    def _read(
        self, loop: ClosedLoop, sensors: Sensors, y: Measured, last: Measured, number: Scalar
    ) -> Measured:
        return sensors.read(y, last, loop.ratios[0], self.task.period, number)

    def _horizon(self, loop: ClosedLoop) -> Horizon:
        unit = loop.law.reference_unit or "rad"
        return Horizon(self.task.period, self.task.duration, unit)

    def _observe(self, state: State) -> Any:
        x = state.carry.x
        seen = Seen(state.told, x.drive[0].motor, x.law, state.action, state.memory)
        scaled = observe(self.task.channels, seen, self._horizon(state.loop))
        # A failed run is not finite; its observation must stay in the box all the same.
        return jnp.nan_to_num(scaled.astype(jnp.float32))


def _told(late: Scalar, before: Measured, now: Measured) -> Measured:
    """The readings that an observation is made of; the reference needs no sensor."""
    chosen = jax.tree.map(lambda a, b: jnp.where(late > 0.0, a, b), before, now)
    return chosen._replace(reference=now.reference)


def _measured(loop: ClosedLoop, carry: engine.Carry, after: float = 1e-6) -> Measured:
    """What there is to measure at a tick; after the events there, of a reference as it is now.

    after: the instant at which the reference is looked up, in steps from the tick.
    """
    t = carry.tick.astype(carry.elapsed.dtype) * loop.dt
    (outputs,) = loop.outputs(When(t, t + after * loop.dt), carry.x, carry.modes, carry.held)
    return Measured(*(getattr(outputs, name) for name in Measured._fields))


def _numbers(task: Task, metrics: Any, carry: engine.Carry) -> dict[str, Scalar]:
    found: dict[str, Scalar] = {}
    for metric, fold in zip(metrics[0], carry.folds[0], strict=True):
        found |= metric.finish(fold)
    return {name: found[name] for name in task.terms}


def build(
    task: str, *, plain: bool = False, dt: float = 2e-4, true_speeds: bool = False, **options: Any
) -> Environment:
    """The environment that the doors of Gymnasium and stable-baselines3 open, in float32.

    task: its name, or "module:Class". plain: events are not located. true_speeds: exact readings,
    without noise and delay, in place of encoders. options: fields of the task.

    Raises: InputError for an unknown task or option.
    """
    with called("task"):
        kind = TASKS.find(task)
    fields = {f.name for f in dataclasses.fields(kind)}
    for name in options:
        if name not in fields:
            raise InputError.unknown("option", name, {*fields, "plain", "dt", "true_speeds"})
    deadzone = Plain() if plain else Exact(_EVENTS)
    sensors = TrueSpeeds() if true_speeds else Encoders()
    return Environment(kind(**options), dt, deadzone, sensors)


__all__ = ["Environment", "Info", "State", "Step", "build"]
