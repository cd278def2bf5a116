"""Whole episodes of a policy in one compiled scan: what validates and what measures it."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from envs.environment import Environment
from jaxsim import batch
from jaxsim.laws.policy import Network

# Seeds of the three kinds of episodes; training draws from keys folded in with its own seed.
_TRAINING, _VALIDATION, _TEST = 0, 1, 2


class Scores(NamedTuple):
    """Of each episode: minus the return, the task's cost, its metrics, and the run's status."""

    loss: np.ndarray
    cost: np.ndarray
    numbers: dict[str, np.ndarray]
    status: np.ndarray


def training_keys(seed: int, iteration: Any, count: int) -> Any:
    """Keys of the episodes of one iteration, (count,)."""
    own = jax.random.fold_in(jax.random.key(seed), _TRAINING)
    return jax.random.split(jax.random.fold_in(own, iteration), count)


def validation_keys(count: int) -> Any:
    """Keys of the episodes that choose among policies: the same for every training."""
    return jax.random.split(jax.random.fold_in(jax.random.key(0xA11), _VALIDATION), count)


def unseen_keys(count: int) -> Any:
    """Keys of the episodes that nothing was trained or chosen on."""
    return jax.random.split(jax.random.fold_in(jax.random.key(0xA11), _TEST), count)


def episode(env: Environment, network: Network, key: Any) -> tuple[Any, Any]:
    """One episode: the last state, and the reward of each step."""

    def one(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], Any]:
        state, observation = carry
        step = env.step(state, network(observation))
        return (step.state, step.observation), (step.reward, step.info)

    (last, _), (rewards, infos) = jax.lax.scan(one, env.reset(key), None, length=env.steps)
    return last, (rewards, jax.tree.map(lambda v: v[-1], infos))


def score(env: Environment, network: Network, keys: Any) -> Scores:
    """Run one episode per key, over all cores; policy and drive go through one scan.

    A run that fails stays failed and pays its price at every step that is left.
    """
    words = jax.random.key_data(keys)
    many = batch.Batch(words, (True,), len(words))
    network = jax.tree.map(lambda v: jnp.asarray(v, env.dtype), network)
    return Scores(*jax.tree.map(np.asarray, _scored(env, network, many)))


@eqx.filter_jit
def _scored(env: Environment, network: Network, words: batch.Batch) -> Any:
    def one(own: Any, shared: Network) -> Any:
        key = jax.random.wrap_key_data(own, impl="threefry2x32")
        last, (rewards, info) = episode(env, shared, key)
        return -jnp.sum(rewards), last.cost, info.numbers, info.status

    return batch.map_members(one, words, network)


__all__ = ["Scores", "episode", "score", "training_keys", "unseen_keys", "validation_keys"]
