"""What a policy makes worse than the law that it works with, in the same episode."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from envs.environment import Environment, Info, State
from envs.task import Task
from jaxsim.errors import InputError
from rl.networks import neutral

Scalar = Any


def nominal_of(env: Environment) -> Environment:
    """The environment whose every episode is the task's nominal one.

    Raises: InputError where the task has none.
    """
    if "nominal" not in {f.name for f in dataclasses.fields(env.task)}:
        rule, fix = "must be 0: the task has no nominal case", "leave it out"
        raise InputError("training.nominal", rule, type(env.task).__name__, fix)
    return dataclasses.replace(env, task=dataclasses.replace(env.task, nominal=True))  # type: ignore[call-arg]


def alone(env: Environment, state: State) -> dict[str, Scalar]:
    """The metrics of the cost at the end of an episode in which the law is left alone.

    No derivative goes through them: they are what a policy is measured against.
    """
    action = jnp.asarray(neutral(env.task), env.dtype)

    def one(carry: tuple[State, Info], _: None) -> tuple[tuple[State, Info], None]:
        step = env.step(carry[0], action)
        return (step.state, step.info), None

    first = env.step(state, action)
    rest = env.steps - 1
    (_, info), _ = jax.lax.scan(one, (first.state, first.info), None, length=rest)
    return jax.lax.stop_gradient(info.numbers)


def regret(
    task: Task, numbers: Mapping[str, Scalar], own: Mapping[str, Scalar], margin: float
) -> Scalar:
    """mean over the terms of max(0, m - (1 - margin) m_law)/m_nominal.

    numbers, own: the metrics m of the policy and m_law of the law alone, in the same episodes;
    margin: by what share a policy has to be better before it counts as no worse.

    It is zero at the start of a training, as the policy leaves the law alone (but for the margin),
    so that none is ever asked for what cannot be done in its episode.
    """
    parts = [
        jax.nn.relu(numbers[name] - (1.0 - margin) * own[name]) / nominal
        for name, nominal in task.terms.items()
    ]
    return sum(parts[1:], parts[0]) / len(parts)


__all__ = ["alone", "nominal_of", "regret"]
