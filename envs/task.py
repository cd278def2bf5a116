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
    def draw(self, key: Any) -> tuple[Drive, Scenario]:
        """The drive and scenario of one episode; everything random in it comes from the key."""

    @abc.abstractmethod
    def law(self) -> Control:
        """The law that commands the motor before the first action."""

    def cost(self, numbers: dict[str, Scalar]) -> Scalar:
        """The mean of the terms, each over its nominal value."""
        parts = [numbers[name] / nominal for name, nominal in self.terms.items()]
        return sum(parts[1:], parts[0]) / len(parts)


__all__ = ["TASKS", "Range", "Task"]
