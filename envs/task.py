"""What an agent is asked to do: drive and scenario of an episode, action, observation, cost."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxsim.catalog import Catalog
from jaxsim.drive import Drive
from jaxsim.law import Control
from jaxsim.observation import Action, Channel
from jaxsim.scenario import Scenario

Scalar = Any

TASKS = Catalog("tasks", "envs.tasks", "envs.task:Task")


class Range(NamedTuple):
    """A uniform distribution. Drawn in float32 always: the same episodes in every precision."""

    low: float
    high: float

    def draw(self, key: Any) -> Scalar:
        return jax.random.uniform(key, (), jnp.float32, self.low, self.high)


class Episode(NamedTuple):
    """What is drawn for one episode.

    angle_noise, rad, torque_noise, Nm: standard deviations of the readings; late: > 0
    where an observation is made of the readings of one control period ago.
    """

    drive: Drive
    scenario: Scenario
    angle_noise: Scalar
    torque_noise: Scalar
    late: Scalar


def drawn(conditions: Any, key: Any) -> Any:
    """Conditions, a NamedTuple of `Range`s, with a number drawn from each."""
    keys = jax.random.split(key, len(conditions))
    return type(conditions)(*(r.draw(k) for r, k in zip(conditions, keys, strict=True)))


def either_way(sign: Scalar, size: Scalar) -> Scalar:
    """`size` up or down, as the sign of the first number says."""
    return jnp.where(sign < 0.0, -size, size)


class Task(eqx.Module):
    """One task of one axis; a concrete subclass in `envs/tasks/` is all that a new one needs.

    Its fields are static, so that all environments of one kind share a compiled program.

    period, duration: of control and of an episode, s. terms: the metrics in the cost, each over
    the value it has under the classical law in the nominal case, so that the law costs 1 there.
    action_rate: cost of one unit of squared change of the action. failure: the price of a run
    that fails, above what the worst actions cost.
    """

    period: ClassVar[float]
    duration: ClassVar[float]
    terms: ClassVar[Mapping[str, float]]
    action_rate: ClassVar[float]
    failure: ClassVar[float]
    actions: ClassVar[tuple[Action, ...]]
    channels: ClassVar[tuple[Channel, ...]]

    @abc.abstractmethod
    def draw(self, key: Any, age: Scalar) -> Episode:
        """One episode; everything random in it comes from the key.

        age: how many episodes the drive has behind it; what wears drifts with it.
        """

    @abc.abstractmethod
    def law(self) -> Control:
        """The law that commands the motor before the first action."""

    def cost(self, numbers: dict[str, Scalar]) -> Scalar:
        """The mean of the terms, each over its nominal value."""
        parts = [numbers[name] / nominal for name, nominal in self.terms.items()]
        return sum(parts[1:], parts[0]) / len(parts)


__all__ = ["TASKS", "Episode", "Range", "Task", "drawn", "either_way"]
