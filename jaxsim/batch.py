"""Many drives, laws or scenarios in one run: a leading axis on some of the leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec

from jaxsim import tree
from jaxsim._configure import native_loops
from jaxsim.errors import InputError
from jaxsim.parameters import is_concrete

# Members that go through the loop together, as bytes of one number of each: the state of so many
# stays in the innermost cache. 4096 runs of the bench in exact mode, CPU time of two cores: float64
# 36 ms by 64, 38 by 128, 47 by 256; float32 23 by 64, 20 by 128, 22 by 256.
_LANES = 512
# Where events are not located there is less of it: 14.6, 13.9, 14.6 and 8.5, 7.8, 7.0 ms.
_LANES_OPEN = 1024
# Members that are worth a core: 64 runs with four gradients take 28 ms of one, 18 ms of two.
_LEAST = 32
_VECTOR = 16  # float32 numbers of one 512-bit instruction, and float64 of two


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


def map_members(function: Callable[..., Any], *trees: Any, located: bool = True) -> Any:
    """`function(*trees)` for every member of the batches among the trees.

    With the options of `jaxsim.configure()` in force, members go through in chunks, and the
    chunks over the cores; else, and on other hardware than a CPU, by one `jax.vmap`. A member's
    numbers are the same to the bit in every batch of two and more; alone, where lanes and a second
    core would only cost time (four times as much), to rounding.

    located: whether runs in it locate their events, and so carry more from step to step.
    """
    own, shared, one = _separated(function, trees)
    chunk = jax.vmap(one, in_axes=(0, None))
    size = size_of(*trees) or 0
    if size == 1 or not native_loops() or jax.default_backend() != "cpu":
        return chunk(own, shared)
    layout = _layout(size, _cores(), (_LANES if located else _LANES_OPEN) // _bytes(own))
    rows = np.minimum(np.arange(layout.padded), size - 1).reshape(-1, layout.width)

    def chunks(own_leaves: Any, shared_leaves: Any) -> Any:
        return jax.lax.map(lambda leaves: chunk(leaves, shared_leaves), own_leaves)

    results = _over_cores(chunks, layout.cores)([v[rows] for v in own], shared)
    return jax.tree.map(lambda v: v.reshape(layout.padded, *v.shape[2:])[:size], results)


def gathered(arrays: Any) -> Any:
    """Results that lie spread over the cores, brought together as any other array of JAX."""

    def one(v: Any) -> Any:
        apart = is_concrete(v) and len(v.sharding.device_set) > 1
        return jnp.asarray(np.asarray(v)) if apart else v

    return jax.tree.map(one, arrays)


def _bytes(leaves: list[Any]) -> int:
    """The size of one number."""
    return max(
        (v.dtype.itemsize for v in leaves if jnp.issubdtype(v.dtype, jnp.inexact)), default=8
    )


def _separated(function: Callable[..., Any], trees: tuple[Any, ...]) -> tuple[Any, Any, Any]:
    """Leaves with and without a leading axis, and `function` of one member's of each."""
    shared, own, rebuild = [], [], []
    for item in trees:
        leaves, structure = jax.tree.flatten(item.members if isinstance(item, Batch) else item)
        flags = item.axes if isinstance(item, Batch) else (False,) * len(leaves)
        own += [jnp.asarray(v) for v, flag in zip(leaves, flags, strict=True) if flag]
        shared += [v for v, flag in zip(leaves, flags, strict=True) if not flag]
        rebuild.append((structure, flags))

    def one(own_leaves: Any, shared_leaves: Any) -> Any:
        mine, ours = iter(own_leaves), iter(shared_leaves)
        return function(
            *(
                jax.tree.unflatten(structure, [next(mine) if f else next(ours) for f in flags])
                for structure, flags in rebuild
            )
        )

    return own, shared, one


class _Layout(NamedTuple):
    """How a batch is cut: chunks of `width` members, `padded` in all, over so many cores."""

    width: int
    padded: int
    cores: int


def _layout(size: int, cores: int, lanes: int) -> _Layout:
    """Equal chunks of at most `lanes` members, and as many chunks for each core.

    Small batches take two cores where there are two: what is compiled for one core alone is fused,
    and so rounded, in another way, and a member's numbers would depend on its batch.
    """
    cores = min(cores, max(2, size // _LEAST))
    chunks = cores * -(-size // (lanes * cores))
    width = -(-size // (chunks * _VECTOR)) * _VECTOR
    return _Layout(width, chunks * width, cores)


def _cores() -> int:
    """JAX devices to spread over: one per core after `configure()`; 1 inside a user's mesh."""
    return jax.local_device_count() if jax.sharding.get_abstract_mesh().empty else 1


def _over_cores(function: Callable[..., Any], cores: int) -> Callable[..., Any]:
    """`function(own, shared)` with the leading axis of `own` and of the result over cores.

    Rejected: threads over compiled calls (not under a user's jit or grad); one loop per core in
    one program (compiles once per core).
    """
    if cores == 1:
        return function
    axis = (jax.sharding.AxisType.Auto,)
    mesh = jax.make_mesh((cores,), ("core",), axis, devices=jax.local_devices()[:cores])
    split, whole = PartitionSpec("core"), PartitionSpec()
    return jax.shard_map(
        function, mesh=mesh, in_specs=(split, whole), out_specs=split, check_vma=False
    )


__all__ = ["Batch", "gathered", "map_members", "size_of", "spread", "stack"]
