"""Many drives, laws or scenarios in one run: a leading axis on some of the leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import tree
from jaxsim.errors import InputError


class Batch(eqx.Module):
    """A tree in which some leaves carry a leading axis of `size` members; the rest are shared."""

    members: Any
    axes: tuple[bool, ...] = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def __getitem__(self, index: int) -> Any:
        """The tree of one member."""
        leaves, structure = jax.tree.flatten(self.members)
        chosen = [v[index] if own else v for v, own in zip(leaves, self.axes, strict=True)]
        return jax.tree.unflatten(structure, chosen)


def stack(members: Sequence[Any]) -> Batch:
    """A batch of trees of the same structure, one member each.

    Raises: InputError when the list is empty or the structures differ.
    """
    if not members:
        raise InputError("members", "must hold at least one tree", "an empty list", "add members")
    structures = {jax.tree.structure(m) for m in members}
    if len(structures) > 1:
        raise InputError(
            "members",
            "must all have the same components",
            f"{len(structures)} structures",
            "run the kinds apart",
        )
    stacked = jax.tree.map(lambda *v: jnp.stack([jnp.asarray(x) for x in v]), *members)
    return Batch(stacked, (True,) * len(jax.tree.leaves(stacked)), len(members))


def spread(base: Any, **values: Any) -> Batch:
    """A batch around `base`: each named parameter takes the values of a (size,) array.

    Names are parameter names ("half_gap") or dotted paths with "__" for the dot.
    Values are not checked here: a member that breaks a rule is reported by index in the run.

    Raises: InputError for unknown or ambiguous names, and for arrays of different lengths.
    """
    if not values:
        raise InputError("values", "must name a parameter", "none", "e.g. half_gap=[...]")
    arrays = {name.replace("__", "."): np.asarray(v, float) for name, v in values.items()}
    sizes = {name: v.shape for name, v in arrays.items()}
    if len(set(sizes.values())) > 1 or any(len(shape) != 1 for shape in sizes.values()):
        raise InputError("values", "must be arrays of one common length", sizes, "same length")
    members = tree.replace(base, arrays)
    axes = tuple(
        np.ndim(new) > np.ndim(old)
        for new, old in zip(jax.tree.leaves(members), jax.tree.leaves(base), strict=True)
    )
    return Batch(members, axes, next(iter(sizes.values()))[0])


def size_of(*trees: Any) -> int | None:
    """The common number of members of the batches among `trees`; None where there is none.

    Raises: InputError when two batches differ in size.
    """
    sizes = {t.size for t in trees if isinstance(t, Batch)}
    if len(sizes) > 1:
        raise InputError("batch", "must have one size", sorted(sizes), "give equal sizes")
    return sizes.pop() if sizes else None


def map_members(function: Callable[..., Any], *trees: Any) -> Any:
    """`function(*trees)` for every member of the batches among the trees, by one `jax.vmap`."""
    shared, own, rebuild = [], [], []
    for item in trees:
        leaves, structure = jax.tree.flatten(item.members if isinstance(item, Batch) else item)
        flags = item.axes if isinstance(item, Batch) else (False,) * len(leaves)
        own.append([v for v, flag in zip(leaves, flags, strict=True) if flag])
        shared.append([v for v, flag in zip(leaves, flags, strict=True) if not flag])
        rebuild.append((structure, flags))

    def one(own_leaves: Any, shared_leaves: Any) -> Any:
        built = []
        for (structure, flags), mine, ours in zip(
            rebuild, own_leaves, shared_leaves, strict=True
        ):
            mine, ours = iter(mine), iter(ours)
            built.append(
                jax.tree.unflatten(structure, [next(mine) if f else next(ours) for f in flags])
            )
        return function(*built)

    return jax.vmap(one, in_axes=(0, None))(own, shared)
