"""Networks to start a training from: random, small actions, observations normalised."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from envs.environment import Environment
from envs.task import Task
from jaxsim import tree
from jaxsim.hybrid import Plain
from jaxsim.laws.policy import Layer, Network

_EPISODES = 32  # that normalise the observation
_NOISE = 0.3  # standard deviation of the actions there
_PERSISTENCE = 0.95  # of these actions, per control period
_LEAST = 1e-3  # of a channel's scale: one that never moved says nothing of its size
_MOST = 0.95  # of a first action; tanh^-1(1) is not finite


def first_network(env: Environment, hidden: Sequence[int], key: Any) -> Network:
    """A network that leaves the classical law at work nearly alone.

    Biases of the last layer give the parameters the values they have; weights are orthogonal
    but for the last, which are a hundredth of it.
    """
    task = env.task
    mean, scale = jax.tree.map(np.asarray, _spread(env, key))
    sizes = len(task.channels), *hidden, len(task.actions)
    keys = jax.random.split(key, len(sizes))
    layers = [
        Layer(np.asarray(jax.nn.initializers.orthogonal(gain)(k, (b, a), jnp.float32)), np.zeros(b))
        for (a, b), k, gain in zip(
            itertools.pairwise(sizes), keys[1:], [1.0] * len(hidden) + [0.01], strict=True
        )
    ]
    layers[-1] = eqx.tree_at(lambda v: v.bias, layers[-1], np.arctanh(neutral(task)))
    return Network(layers, mean, np.maximum(scale, _LEAST))


def idle_network(env: Environment) -> Network:
    """A network that leaves the law at work alone, whatever it sees."""
    size, action = len(env.task.channels), neutral(env.task)
    layer = Layer(np.zeros((len(action), size)), action)
    return Network((layer,), np.zeros(size), np.ones(size), squash="clip")


def neutral(task: Task) -> np.ndarray:
    """The action under which the law is as the task gives it."""
    law = task.law()
    own = [(float(tree.get(law, a.parameter)) - a.centre) / a.full_scale for a in task.actions]
    return np.clip(own, -_MOST, _MOST)


@eqx.filter_jit
def _spread(env: Environment, key: Any) -> tuple[Any, Any]:
    """Mean and standard deviation of the observations under wandering actions."""
    plain = eqx.tree_at(lambda v: v.deadzone, env, Plain(), is_leaf=lambda v: v is env.deadzone)
    at_rest = jnp.asarray(neutral(env.task), env.dtype)

    def one(key: Any) -> Any:
        own, noise = jax.random.split(key)
        shocks = jax.random.normal(noise, (env.steps, len(at_rest)), env.dtype)

        def step(carry: Any, shock: Any) -> Any:
            state, wander = carry
            wander = _PERSISTENCE * wander + (1.0 - _PERSISTENCE**2) ** 0.5 * shock
            action = jnp.clip(at_rest + _NOISE * wander, -1.0, 1.0)
            done = plain.step(state, action)
            return (done.state, wander), done.observation

        state, _ = plain.reset(own)
        return jax.lax.scan(step, (state, jnp.zeros_like(at_rest)), shocks)[1]

    seen = jax.vmap(one)(jax.random.split(key, _EPISODES)).reshape(-1, len(env.task.channels))
    return jnp.mean(seen, 0), jnp.std(seen, 0)
