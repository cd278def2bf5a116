"""Analytic policy gradients: a policy trained by derivatives of whole episodes.

The simulator is differentiable, so the gradient of an episode's return with respect to the
weights is one reverse pass through drive, contact and policy; there is nothing to explore.

What keeps it from diverging, each found to be needed:
- contact is smoothed in training (`Smoothed`): speeds are differences of exact angles, as
  rounding has no useful derivative; what is kept is chosen in exact mode, with encoders;
- the gradient through the state is multiplied by 0.99 per control period: through 300 periods
  of impacts it grows without bound, and its variance drowns the signal;
- each episode's gradient is clipped before the mean: one rattling episode outweighs all others;
- where the validation becomes much worse than the best, it goes back there with half the rate.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from envs.environment import Environment, State
from envs.task import TASKS
from jaxsim.hybrid import Smoothed
from jaxsim.laws.policy import Network
from jaxsim.sampled import Differences
from rl import arrays
from rl.episodes import training_keys
from rl.networks import first_network
from rl.regret import alone, nominal_of, regret
from rl.spec import APGSpec
from rl.trainer import Trainer

Scalar = Any

_NOMINAL = 1  # folded into the key of an episode: whether it is the nominal one
_WORSE = 1.5  # times the best validation loss: go back
_ADAM = optax.scale_by_adam()


class _Memory(NamedTuple):
    """All that one iteration hands to the next; `best` is where to go back to."""

    network: Network
    moments: Any
    best: Network
    factor: Scalar
    iteration: Scalar


@functools.partial(jax.custom_vjp, nondiff_argnums=(1,))
def _decayed(state: Any, decay: float) -> Any:
    """The identity, whose cotangent is multiplied by `decay`."""
    return state


def _forward(state: Any, decay: float) -> tuple[Any, None]:
    return state, None


def _backward(decay: float, _: None, cotangent: Any) -> tuple[Any]:
    def one(v: Any) -> Any:
        return v if v.dtype == jax.dtypes.float0 else decay * v

    return (jax.tree.map(one, cotangent),)


_decayed.defvjp(_forward, _backward)


def _damped(state: State, decay: float) -> State:
    """Only what moves is damped: sums and maxima of the cost carry their gradient undamped."""
    damped: Any = _decayed((state.carry.x, state.seen), decay)
    x, seen = damped
    return state._replace(carry=state.carry._replace(x=x), seen=seen)


def _loss(env: Environment, spec: APGSpec, network: Network, key: Any) -> Scalar:
    """Minus the return of one episode, and its regret; reverse mode keeps one state per period."""

    @jax.checkpoint
    def one(carry: tuple[State, Any], _: None) -> tuple[tuple[State, Any], Any]:
        state, observation = carry
        step = env.step(_damped(state, spec.decay), network(observation))
        return (step.state, step.observation), (step.reward, step.info.numbers)

    first = _first(env, spec.nominal, key)
    rewards, numbers = jax.lax.scan(one, first, None, length=env.steps)[1]
    loss = -jnp.sum(rewards)
    if not spec.regret:
        return loss
    last = jax.tree.map(lambda v: v[-1], numbers)
    return loss + spec.regret * regret(env.task, last, alone(env, first[0]), spec.margin)


def _first(env: Environment, share: float, key: Any) -> tuple[State, Any]:
    """A fresh episode; a share of them is the task's nominal one."""
    if not share:
        return env.reset(key)
    named = nominal_of(env).reset(key)
    drawn = jax.random.uniform(jax.random.fold_in(key, _NOMINAL)) < share
    return jax.tree.map(lambda a, b: jnp.where(drawn, a, b), named, env.reset(key))


def _clipped_mean(gradients: Any, losses: Any, clip: float) -> Any:
    """The mean of the members' gradients, each at most `clip` long; members that fail give none."""
    squares = [jnp.sum(v.reshape(len(losses), -1) ** 2, 1) for v in jax.tree.leaves(gradients)]
    norm = jnp.sqrt(sum(squares[1:], squares[0]))
    sound = jnp.isfinite(norm) & jnp.isfinite(losses)
    share = jnp.where(sound, jnp.minimum(1.0, clip / jnp.maximum(norm, 1e-12)), 0.0)

    def mean(v: Any) -> Any:
        weight = share.reshape(-1, *(1,) * (v.ndim - 1))
        return jnp.mean(jnp.where(weight > 0.0, weight * v, 0.0), 0)

    return jax.tree.map(mean, gradients)


class _Program(eqx.Module):
    """What is compiled: static, so that one program serves all seeds."""

    env: Environment
    spec: APGSpec = eqx.field(static=True)

    @eqx.filter_jit
    def iterate(self, memory: _Memory, seed: Scalar) -> tuple[_Memory, Scalar]:
        keys = training_keys(seed, memory.iteration, self.spec.batch)
        layers = memory.network.layers

        def loss(layers: Any, key: Any) -> Scalar:
            network = eqx.tree_at(lambda v: v.layers, memory.network, layers)
            return _loss(self.env, self.spec, network, key)

        losses, gradients = jax.vmap(jax.value_and_grad(loss), (None, 0))(layers, keys)
        gradient = _clipped_mean(gradients, losses, self.spec.clip)
        change, moments = _ADAM.update(gradient, memory.moments)
        rate = memory.factor * self._rate(memory.iteration)
        moved = jax.tree.map(lambda v, d: v - rate * d, layers, change)
        network = eqx.tree_at(lambda v: v.layers, memory.network, moved)
        following = memory.iteration + 1
        new = memory._replace(network=network, moments=moments, iteration=following)
        return new, jnp.mean(losses)

    def _rate(self, iteration: Scalar) -> Scalar:
        spec = self.spec
        return optax.cosine_decay_schedule(spec.rate, spec.iterations, spec.final)(iteration)


class APG(Trainer):
    """The training of one policy; `advance` goes to the next validation."""

    def __init__(self, spec: APGSpec) -> None:
        self._spec = spec
        task = TASKS.find(spec.task)()
        smooth = Smoothed(spec.width, spec.speed_width)
        env = Environment(task, deadzone=smooth, sensors=Differences())
        self._program = _Program(env, spec.model_copy(update={"seed": 0}))
        network = first_network(env, spec.hidden, jax.random.key(spec.seed))
        network = jax.tree.map(lambda v: jnp.asarray(v, env.dtype), network)
        one, zero = jnp.ones((), env.dtype), jnp.zeros((), jnp.int32)
        self._memory = _Memory(network, _ADAM.init(network.layers), network, one, zero)

    @property
    def done(self) -> int:
        return int(self._memory.iteration)

    @property
    def steps(self) -> int:
        return self.done * self._spec.batch * self._program.env.steps

    def advance(self) -> float:
        left = self._spec.iterations - self.done
        losses = []
        for _ in range(min(left, self._spec.validate_every)):
            self._memory, loss = self._program.iterate(self._memory, self._spec.seed)
            losses.append(float(loss))
        return float(np.mean(losses))

    def network(self) -> Network:
        return self._memory.network

    def judged(self, loss: float, best: float) -> None:
        memory = self._memory
        if loss <= best:
            self._memory = memory._replace(best=memory.network)
        elif not loss < _WORSE * best:
            # Moments of where it diverged are of no use where it goes back to.
            moments = _ADAM.init(memory.network.layers)
            factor = 0.5 * memory.factor
            self._memory = memory._replace(network=memory.best, moments=moments, factor=factor)

    def save(self, folder: Path) -> None:
        arrays.save(folder / "memory.npz", self._memory)

    def load(self, folder: Path) -> None:
        self._memory = arrays.load(folder / "memory.npz", self._memory)


__all__ = ["APG"]
