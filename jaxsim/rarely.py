"""What is dear and rarely needed: done for a whole batch where one member needs it, else not."""

from __future__ import annotations

import contextvars
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

Scalar = Any

# The margins met so far by a step that is traced as one in which nothing rare happens.
_met: contextvars.ContextVar[list[Scalar] | None] = contextvars.ContextVar("met", default=None)


@jax.custom_batching.custom_vmap
def any_member(condition: Scalar) -> Scalar:
    """Whether a condition holds for any member of the batch that a run is in.

    vmap alone turns a cond into a select, and does both.
    """
    return condition


@any_member.def_vmap
def _(size: int, batched: list[bool], conditions: Any) -> tuple[Any, bool]:
    return jnp.any(conditions), False


@jax.custom_batching.custom_vmap
def how_many(condition: Scalar) -> Scalar:
    """For how many members of the batch that a run is in a condition holds."""
    return condition.astype(jnp.int32)


@how_many.def_vmap
def _(size: int, batched: list[bool], conditions: Any) -> tuple[Any, bool]:
    return jnp.sum(conditions, dtype=jnp.int32), False


def rarely(
    margin: Scalar, inside: Callable[..., Any], outside: Callable[..., Any], *operands: Any
) -> Any:
    """inside(*operands) if the margin of any member of the batch is negative, else outside(...).

    `inside` must give what `outside` gives to the members that have a margin. It is a number and
    no truth value because the least of many takes a third of the time that `or` does.
    """
    met = _met.get()
    if met is None:
        return jax.lax.cond(any_member(margin < 0.0), inside, outside, *operands)
    met.append(margin)
    return outside(*operands)


def hurried(step: Callable[[], Any]) -> tuple[Any, list[Scalar]]:
    """step() as if nothing rare happened in it, and its margins: wrong where one is negative.

    For steps that then branch once: each branch ends a loop over the members and writes what
    crosses it to memory; those of three metrics take half the time of a step.
    """
    met: list[Scalar] = []
    token = _met.set(met)
    try:
        return step(), met
    finally:
        _met.reset(token)


__all__ = ["any_member", "how_many", "hurried", "rarely"]
