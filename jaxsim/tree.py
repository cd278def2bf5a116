"""Parameters of a component tree by name: find, read, replace; their precision."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError
from jaxsim.parameters import all_parameters


def paths(tree: Any) -> list[str]:
    """Dotted paths of all parameters, e.g. `transmission.half_gap` or `laws[1].K_B`."""
    return [item.path.lstrip(".") for item in all_parameters(tree)]


def numbers(tree: Any) -> list[str]:
    """Those of the paths that are a single number: no arrays, such as Gammas per joint."""
    return [i.path.lstrip(".") for i in all_parameters(tree) if np.ndim(i.value) == 0]


def shortest(paths: Sequence[str]) -> list[str]:
    """The shortest tail of each path that names it alone."""
    return [
        next(t for t in _tails(path) if sum(f".{p}".endswith(f".{t}") for p in paths) == 1)
        for path in paths
    ]


def _tails(path: str) -> list[str]:
    parts = path.split(".")
    return [".".join(parts[-k:]) for k in range(1, len(parts) + 1)]


def resolve(tree: Any, name: str) -> str:
    """The full path of a parameter given by its path or by an unambiguous tail of it.

    Raises: InputError for an unknown name (with the nearest ones) or an ambiguous one.
    """
    known = paths(tree)
    if name in known:
        return name
    hits = [p for p in known if p.endswith("." + name)]
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise InputError(name, "must name one parameter", f"matches {hits}", "give the full path")
    raise InputError.unknown("parameter", name, shortest(known))


def get(tree: Any, name: str) -> Any:
    """The value of a parameter."""
    path = resolve(tree, name)
    return next(i.value for i in all_parameters(tree) if i.path.lstrip(".") == path)


def unit(tree: Any, name: str) -> str:
    """The unit of a parameter."""
    *parents, field = _steps(tree, resolve(tree, name))
    owner = tree
    for step in parents:
        owner = _child(owner, step)
    owner = owner[0] if isinstance(owner, tuple) else owner
    return next(f.metadata["unit"] for f in dataclasses.fields(owner) if f.name == field)


def replace(tree: Any, values: Mapping[str, Any]) -> Any:
    """A copy of the tree with the named parameters replaced; values may be traced or batched."""
    for name, value in values.items():
        tree = _replace_one(tree, _steps(tree, resolve(tree, name)), value)
    return tree


def cast(tree: Any, dtype: Any) -> Any:
    """All inexact leaves of a tree in one dtype."""
    return jax.tree.map(lambda v: _cast(v, dtype), tree)


def _cast(v: Any, dtype: Any) -> Any:
    # Numbers go to NumPy: a device array of each costs more than a run of a single drive.
    if isinstance(v, (float, np.ndarray, np.generic)):
        v = np.asarray(v)
        return v.astype(dtype) if np.issubdtype(v.dtype, np.inexact) else v
    return jnp.asarray(v, dtype) if jnp.issubdtype(jnp.asarray(v).dtype, jnp.inexact) else v


def _steps(tree: Any, path: str) -> list[str | int]:
    """Attribute names and tuple indices from the root to the leaf."""
    steps: list[str | int] = []
    for part in path.split("."):
        name, _, index = part.partition("[")
        if name:
            steps.append(name)
        if index:
            steps.append(int(index.rstrip("]")))
    return steps


def _child(owner: Any, step: str | int) -> Any:
    if isinstance(owner, tuple) and isinstance(step, str):
        owner = owner[0]  # paths leave out the index where there is only one axis
    return owner[step] if isinstance(step, int) else getattr(owner, step)


def _replace_one(tree: Any, steps: list[str | int], value: Any) -> Any:
    def leaf(root: Any) -> Any:
        for step in steps:
            root = _child(root, step)
        return root

    return eqx.tree_at(leaf, tree, value)
