"""Environments compiled for a batch, behind NumPy arrays: what all doors are made of.

For code that stays inside JAX (analytic policy gradients, fused evaluation) this is the wrong
door. Use the pure functions of `envs.environment.Environment` themselves; they are for ONE
environment and compose with jit, vmap, scan and grad:

    env = Environment(TASKS.find("backlash_position")(), deadzone=Smoothed(), sensors=TrueSpeeds())
    state, observation = env.reset(jax.random.key(0))       # observation: (channels,) float32
    step = env.step(state, action)                          # action: (actions,) in [-1, 1]
    step.state, step.observation, step.reward, step.truncated, step.info.numbers

- Everything random in an episode comes from the key; the next one of a chain is
  `env.reset(state.key, state.age + 1)`: its gap has worn a little.
- `env.steps` steps make an episode; nothing resets by itself, that is `Runner`'s doing.
- The reward is differentiable with respect to actions and state. Of the modes, `Smoothed()` is
  for gradients over whole episodes, `Exact()` gives right values and event times; gradients in
  `Plain()` are wrong. Encoders round, and their derivative is that of the angle itself, so that
  gradients through them are not those of the steps: use `Differences()`, which have noise and delay
  all the same, or `TrueSpeeds()`, which have neither.
- `env.task.channels` and `env.task.actions` give names, units, full scales and bounds.
- `jaxsim.observation.act(env.task.actions, law, action)` is what an action does to the law;
  `state.loop` and `state.carry` are the engine's, for those who need the drive or its state.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.environment import Environment, Step
from jaxsim.errors import InputError

# Members that are moved together: more than these do not stay in the cache.
_LANES = 256


class Outcome(NamedTuple):
    """One step of all members, as fresh NumPy arrays with a leading axis of members.

    observation is that of the new episode where the old one is over; final is that before the
    reset. numbers: (members, terms), the metrics so far.
    """

    observation: np.ndarray
    final: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    status: np.ndarray
    numbers: np.ndarray


class Runner:
    """`size` environments whose state stays inside.

    restarts: a member whose episode is over begins a new one within the same step; the others
    go on. Each member draws its episodes from a chain of keys of its own, so it goes through
    the same episodes whatever the batch it is in.
    """

    def __init__(self, env: Environment, size: int, *, restarts: bool) -> None:
        if size < 1:
            raise InputError("num_envs", "must be >= 1", size, "give a count")
        self.env, self.size = env, size
        # Alone, a member would be compiled as scalars and rounded otherwise than in a batch (1e-8
        # apart after 19 steps); a second lane, which repeats it, costs 2 to 6 %.
        self._lanes = np.minimum(np.arange(max(size, 2)), size - 1)
        self._reset, self._again, self._step, self._look = _compiled(env, restarts)
        self._state: Any = None
        self._over = np.zeros(size, bool)
        self._restarts = restarts

    @property
    def started(self) -> bool:
        return self._state is not None

    def reset(self, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Fresh episodes: the first ones of these seeds, or the next of the present chains."""
        if seeds is None:
            self._state, observation = self._again(self._state)
        else:
            self._state, observation = self._reset(_keys([seeds[i] for i in self._lanes]))
        self._over[:] = False
        return np.array(observation[: self.size])

    def step(self, actions: Any) -> Outcome:
        """One control period under actions of shape (members, actions) in the box.

        Raises: InputError for actions of another shape, not finite or outside the box, and for a
        step before the first reset or after the end.
        """
        checked = self._checked(actions)
        if not self.started or self._over.any():
            raise InputError("step", "must come after a reset", "no running episode", "reset first")
        self._state, rows = self._step(self._state, checked[self._lanes])
        outcome = self._outcome(np.asarray(rows)[: self.size])
        if not self._restarts:
            self._over = outcome.terminated | outcome.truncated
        return outcome

    def _outcome(self, rows: np.ndarray) -> Outcome:
        """The columns of `_columns`, copied: what comes out of JAX cannot be written to."""
        wide = len(self.env.task.channels)
        observation, final = rows[:, :wide], rows[:, wide : 2 * wide]
        reward, terminated, truncated, status = rows[:, 2 * wide : 2 * wide + 4].T
        return Outcome(
            observation.astype(np.float32),
            final.astype(np.float32),
            reward.copy(),
            terminated != 0.0,
            truncated != 0.0,
            status.astype(np.int32),
            rows[:, 2 * wide + 4 :].copy(),
        )

    def state(self) -> Any:
        """The `State` of all members, for pictures and tests; a copy.

        Raises: InputError before the first reset.
        """
        if not self.started:
            raise InputError("state", "must come after a reset", "no episode", "reset first")
        return jax.tree.map(lambda v: v[: self.size], self._look(self._state))

    def _checked(self, actions: Any) -> np.ndarray:
        shape = (self.size, len(self.env.task.actions))
        values = np.asarray(actions, np.float32)
        if values.shape != shape:
            raise InputError("action", f"must have shape {shape}", values.shape, "one row per env")
        fine = (np.abs(values) <= 1.0).all(axis=1)  # a comparison with nan is false
        if not fine.all():
            where = int(np.argmin(fine))
            raise InputError(
                "action", "must be finite and in [-1, 1]",
                f"{values[where].tolist()} (env {where})",
                "scale it to the box, np.clip(action, -1, 1) if that is what you mean",
            )  # fmt: skip
        return values


def _keys(seeds: Sequence[int]) -> Any:
    """One key per seed, of any size; the raw words, which jit passes faster than typed keys."""
    words = [np.random.SeedSequence(seed).generate_state(2, np.uint32) for seed in seeds]
    return jnp.asarray(np.stack(words))


@functools.cache
def _compiled(env: Environment, restarts: bool) -> tuple[Any, Any, Any, Any]:
    """reset(keys), again(state), step(state, actions), look(state) of all runners of one kind.

    again: the next episodes of the chains; look: the state as a tree.

    Between calls a state is (words of the keys, one array per dtype with members in its LAST
    axis): to hand over 45 small arrays costs 60 us, more than a step of one environment takes.
    """
    layout: Any = None

    def packed(state: Any) -> tuple[Any, dict[str, Any]]:
        nonlocal layout
        words = jax.random.key_data(state.key)
        leaves, structure = jax.tree.flatten(state._replace(key=()))
        layout = structure, tuple((v.dtype.name, v.shape[1:]) for v in leaves)
        return words, _rows(leaves)

    def unpacked(state: tuple[Any, dict[str, Any]]) -> Any:
        key = jax.random.wrap_key_data(state[0], impl="threefry2x32")
        leaves = _leaves(layout[1], state[1])
        return jax.tree.unflatten(layout[0], leaves)._replace(key=key)

    def reset(words: Any) -> Any:
        keys = jax.random.wrap_key_data(words, impl="threefry2x32")
        state, observation = jax.vmap(env.reset)(keys)
        return packed(state), observation

    def again(state: Any) -> Any:
        following, observation = _next(env, unpacked(state))
        return packed(following), observation

    def step(state: Any, actions: Any) -> Any:
        old = unpacked(state)
        done = _stepped(env, old, actions)
        after, observation = _restarted(env, done) if restarts else (done.state, done.observation)
        return packed(after), _columns(env, done, observation)

    return jax.jit(reset), jax.jit(again), jax.jit(step), unpacked


def _stepped(env: Environment, state: Any, actions: Any) -> Step:
    """One step of all members, `_LANES` of them at a time."""
    if actions.shape[0] <= _LANES:
        return jax.vmap(env.step)(state, actions)
    return jax.lax.map(lambda each: env.step(*each), (state, actions), batch_size=_LANES)


def _next(env: Environment, state: Any) -> tuple[Any, Any]:
    """The next episodes of the chains of all members."""
    return jax.vmap(env.reset)(state.key, state.age + 1)


def _columns(env: Environment, done: Step, observation: Any) -> Any:
    """One array of all that a step tells; to fetch seven would take 12 us more."""
    # By name: dictionaries come out of vmap in alphabetical order.
    numbers = (done.info.numbers[name] for name in env.task.terms)
    single = done.reward, done.terminated, done.truncated, done.info.status, *numbers
    dtype = jnp.promote_types(done.reward.dtype, jnp.float32)
    columns = observation, done.observation, jnp.stack([v.astype(dtype) for v in single], -1)
    return jnp.concatenate([v.astype(dtype) for v in columns], axis=-1)


def _rows(leaves: list[Any]) -> dict[str, Any]:
    """One array of rows per dtype; each leaf (members, ...) gives a row per element."""
    rows: dict[str, list[Any]] = {}
    for v in leaves:
        rows.setdefault(v.dtype.name, []).append(v.reshape(v.shape[0], -1).T)
    return {name: jnp.concatenate(parts) for name, parts in rows.items()}


def _leaves(kinds: tuple[tuple[str, tuple[int, ...]], ...], rows: dict[str, Any]) -> list[Any]:
    """The leaves that `_rows` was given, by their dtype and shape without members."""
    taken = dict.fromkeys(rows, 0)
    leaves = []
    for name, shape in kinds:
        first, count = taken[name], math.prod(shape)
        leaves.append(rows[name][first : first + count].T.reshape(-1, *shape))
        taken[name] += count
    return leaves


def _restarted(env: Environment, done: Step) -> tuple[Any, Any]:
    """States and observations with new episodes where the old ones are over."""
    over = jnp.logical_or(done.terminated, done.truncated)

    def one(over: Any, new: Any, old: Any) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(over, a, b), new, old)

    def fresh(state: Any, observation: Any) -> tuple[Any, Any]:
        new = _next(env, state)
        return jax.vmap(one)(over, new, (state, observation))

    # Most steps end no episode, and drawing drives for all would cost as much as the step.
    return jax.lax.cond(jnp.any(over), fresh, lambda *same: same, done.state, done.observation)


__all__ = ["Outcome", "Runner"]
