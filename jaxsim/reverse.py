"""What reverse mode keeps of a run: the carry of some steps, in a few packed arrays.

Left alone, a scan writes for its reverse every intermediate result of every step, an array each:
1500 steps of the bench with 64 drives then cost 115 runs. Where a step keeps its carry alone, and
is run again before it is gone back over, that is 16 runs with an array for each leaf of the carry,
and 6 with one for each kind of number. How many steps do so, `engine` decides.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jax.flatten_util import ravel_pytree

from jaxsim.steps import Carry

Step = Callable[[Carry, None], tuple[Carry, Any]]


def thrifty(step: Step, located: bool, name: str) -> Step:
    """`step(carry, None)`, of which reverse mode keeps no more than the carry.

    name: of its own for each of several thrifty loops inside one another.
    """

    def again(c: Carry, _: None) -> tuple[Carry, Any]:
        return step(_kept(c, located, name), None)

    policy = jax.checkpoint_policies.save_only_these_names(name)
    return jax.checkpoint(again, policy=policy, prevent_cse=False)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1, 2))
def _kept(c: Carry, located: bool, name: str) -> Carry:
    return _packed(c, located, name)


@functools.partial(_kept.defjvp, symbolic_zeros=True)
def _(located: bool, name: str, primals: Any, tangents: Any) -> tuple[Carry, Any]:
    """Tangents are not packed: what has none would get one, and forward mode keeps nothing."""
    return _packed(primals[0], located, name), tangents[0]


def _packed(c: Carry, located: bool, name: str) -> Carry:
    """The carry, after a way through the arrays that are kept of it.

    Without location only the drive moves: members share the clock, and it must stay shared.
    """
    if not located:
        x, held, folds = _through_arrays((c.x, c.held, c.folds), name)
        return c._replace(x=x, held=held, folds=folds)
    # Whole numbers below 128; and nothing that is differentiated looks at the count of events.
    small = c.modes, c.target, c.status
    bytes_ = jax.tree.map(lambda v: v.astype(jnp.int8), small)
    rest = c._replace(modes=(), target=(), status=(), events=())
    rest, bytes_ = _through_arrays((rest, bytes_), name)
    modes, target, status = jax.tree.map(lambda v, old: v.astype(old.dtype), bytes_, small)
    return rest._replace(modes=modes, target=target, status=status, events=c.events)


def _through_arrays(tree: Any, name: str) -> Any:
    """The tree, out of one array for each dtype in it."""
    leaves, structure = jax.tree.flatten(tree)
    for dtype in sorted({v.dtype.name for v in leaves}):
        where = [i for i, v in enumerate(leaves) if v.dtype.name == dtype]
        array, parts = ravel_pytree([leaves[i] for i in where])
        for i, v in zip(where, parts(checkpoint_name(array, name)), strict=True):
            leaves[i] = v
    return jax.tree.unflatten(structure, leaves)


__all__ = ["thrifty"]
