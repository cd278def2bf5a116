"""A metric that carries only what some of its numbers need.

Metrics come in groups that carry passages, contacts and settling along; a cost needs two or three
of their numbers. Carrying all of them made a step of 1024 environments eight times slower than a
step without metrics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxsim.engine import Piece
from jaxsim.loop import Outputs
from jaxsim.metric import Metric, Scalar


class Pruned(eqx.Module):
    """`metric` with the leaves `kept` of its fold; `finish` is right for the numbers kept for."""

    metric: Metric
    kept: tuple[int, ...] = eqx.field(static=True)

    def start(self) -> tuple[Scalar, ...]:
        return self._kept(self.metric.start())

    def update(self, fold: tuple[Scalar, ...], piece: Piece) -> tuple[Scalar, ...]:
        return self._kept(self.metric.update(self._whole(fold), piece))

    def finish(self, fold: tuple[Scalar, ...]) -> dict[str, Scalar]:
        return self.metric.finish(self._whole(fold))

    def _kept(self, fold: Any) -> tuple[Scalar, ...]:
        leaves = jax.tree.leaves(fold)
        return tuple(leaves[i] for i in self.kept)

    def _whole(self, fold: tuple[Scalar, ...]) -> Any:
        """The fold with what is not carried as it was at the start; nothing kept looks at it."""
        leaves, structure = jax.tree.flatten(self.metric.start())
        for i, value in zip(self.kept, fold, strict=True):
            leaves[i] = value
        return jax.tree.unflatten(structure, leaves)


def prune(metric: Metric, names: Sequence[str]) -> Pruned:
    """The metric reduced to those of the named numbers that it has."""
    leaves, structure = jax.tree.flatten(metric.start())
    zero = jnp.zeros_like(leaves[0])
    outputs = Outputs(*(zero for _ in Outputs._fields))
    piece = Piece(zero, zero, outputs, outputs, outputs, outputs)

    def numbers(*fold: Scalar) -> list[Scalar]:
        found = metric.finish(jax.tree.unflatten(structure, fold))
        return [found[name] for name in names if name in found]

    def update(*fold: Scalar) -> list[Scalar]:
        return jax.tree.leaves(metric.update(jax.tree.unflatten(structure, fold), piece))

    kept = _behind(jax.make_jaxpr(numbers)(*leaves).jaxpr, None)
    before = jax.make_jaxpr(update)(*leaves).jaxpr
    while not kept >= (more := kept | _behind(before, kept)):
        kept = more
    return Pruned(metric, tuple(sorted(kept)))


def _behind(jaxpr: Any, outputs: set[int] | None) -> set[int]:
    """Which inputs stand behind some outputs (None: all); an equation needs all of its own."""
    wanted = {id(v) for i, v in enumerate(jaxpr.outvars) if outputs is None or i in outputs}
    for equation in reversed(jaxpr.eqns):
        if any(id(v) in wanted for v in equation.outvars):
            wanted |= {id(v) for v in equation.invars}
    return {i for i, v in enumerate(jaxpr.invars) if id(v) in wanted}


__all__ = ["Pruned", "prune"]
