"""What an agent is told of an axis, and how: one definition for environments and policies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxsim import tree
from jaxsim.errors import InputError
from jaxsim.law import Control, Measured

Scalar = Any


class Channel(eqx.Module):
    """One entry of an observation: a quantity over its full scale, clipped to the box.

    name: of a quantity in `quantities`, or any where `state` is given: the index of a number in
    the state of the classical law at work.
    """

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    full_scale: float = eqx.field(static=True)
    low: float = eqx.field(static=True, default=-1.0)
    high: float = eqx.field(static=True, default=1.0)
    state: int | None = eqx.field(static=True, default=None)


class Action(eqx.Module):
    """One entry of an action in [-1, 1]: parameter = centre + full_scale * action.

    parameter: of the law at work, by its path or an unambiguous tail of it.
    """

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    full_scale: float = eqx.field(static=True)
    parameter: str = eqx.field(static=True)
    centre: float = eqx.field(static=True, default=0.0)


class Memory(NamedTuple):
    """What there is to remember of the samples so far, SI units.

    count: samples; initial: the reference before anything happened; largest, smallest: of T_s;
    beyond: overshoot; square: integral of the squared error.
    """

    count: Scalar
    initial: Scalar
    largest: Scalar
    smallest: Scalar
    beyond: Scalar
    square: Scalar


class Seen(NamedTuple):
    """All that an observation is made of.

    y: readings of the sensors; motor, law: states of the motor and of the law at work, trees;
    action: the one until now, in the box.
    """

    y: Measured
    motor: Any
    law: Any
    action: tuple[Scalar, ...]
    memory: Memory


class Horizon(NamedTuple):
    """What turns samples into time: the control period and the length of an episode, s.

    unit: of the reference, rad or Nm.
    """

    period: float
    duration: float
    unit: str


def first_memory(y: Measured) -> Memory:
    """Before the first sample, at readings y."""
    zero = jnp.zeros_like(y.theta_L)
    return Memory(jnp.zeros((), jnp.int32), zero + y.reference, zero, zero, zero, zero)


def remember(memory: Memory, y: Measured, horizon: Horizon) -> Memory:
    """The memory after one more sample.

    Maxima are those of the samples: what a computer at the drive can know. Between them the
    torque may be a little larger.
    """
    error = y.reference - _followed(y, horizon)
    passed = jnp.sign(y.reference - memory.initial) * -error
    return Memory(
        memory.count + 1,
        memory.initial,
        jnp.maximum(memory.largest, y.T_s),
        jnp.minimum(memory.smallest, y.T_s),
        jnp.maximum(memory.beyond, passed),
        memory.square + horizon.period * error**2,
    )


def _followed(y: Measured, horizon: Horizon) -> Scalar:
    return y.T_s if horizon.unit == "Nm" else y.theta_L


def quantities(seen: Seen, horizon: Horizon) -> dict[str, Scalar]:
    """Everything that a channel may name, SI units."""
    y, memory = seen.y, seen.memory
    size = jnp.abs(y.reference - memory.initial)
    steps = size > 0.0
    positive = memory.square > 0.0  # the root has no derivative at zero
    mean_square = jnp.where(positive, memory.square, 1.0) / horizon.duration
    # The count is that of the sample being looked at, from 1.
    elapsed = (memory.count - 1).astype(y.theta_L.dtype) * (horizon.period / horizon.duration)
    share = memory.beyond / jnp.where(steps, size, 1.0)
    found = {
        "reference": y.reference,
        "error": y.reference - _followed(y, horizon),
        "theta_L": y.theta_L,
        "theta_B": y.theta_B,
        "omega_L": y.omega_L,
        "omega_M": y.omega_M,
        "omega_B": y.omega_B,
        "T_s": y.T_s,
        "remaining": jnp.maximum(1.0 - elapsed, 0.0),
        "T_s max": memory.largest,
        "-T_s max": -memory.smallest,
        "rms error": jnp.where(positive, jnp.sqrt(mean_square), 0.0),
    }
    if horizon.unit == "Nm":
        found["overshoot"] = jnp.where(steps, 100.0 * share, 0.0)
    else:
        found["overshoot"] = memory.beyond
    motor = jax.tree.leaves(seen.motor)
    return found | ({"current": motor[0]} if motor else {}) | _previous(seen.action)


def _previous(action: tuple[Scalar, ...]) -> dict[str, Scalar]:
    if len(action) == 1:
        return {"previous action": action[0]}
    return {f"previous action[{i}]": value for i, value in enumerate(action)}


def observe(channels: Sequence[Channel], seen: Seen, horizon: Horizon) -> Any:
    """The observation: values over their full scales, clipped to the box; (channels,) array.

    Raises: InputError for a channel that is not among `quantities`, with the nearest, or a state
    that the law does not have.
    """
    known, states = quantities(seen, horizon), jax.tree.leaves(seen.law)
    values = []
    for c in channels:
        if c.state is not None and not 0 <= c.state < len(states):
            rule = f"must be below {len(states)}, the numbers in the law's state"
            raise InputError(f"channels.{c.name}.state", rule, c.state, "correct the index")
        if c.state is None and c.name not in known:
            raise InputError.unknown("channels.name", c.name, known)
        value = known[c.name] if c.state is None else states[c.state]
        values.append(jnp.clip(value / c.full_scale, c.low, c.high))
    return jnp.stack(values)


def act(actions: Sequence[Action], law: Control, values: Sequence[Scalar]) -> Any:
    """The law with its parameters where the values, in the box, put them.

    Raises: InputError for a parameter that the law does not have.
    """
    pairs = zip(actions, values, strict=True)
    return tree.replace(law, {a.parameter: a.centre + a.full_scale * v for a, v in pairs})


__all__ = [
    "Action",
    "Channel",
    "Horizon",
    "Memory",
    "Seen",
    "act",
    "first_memory",
    "observe",
    "quantities",
    "remember",
]
