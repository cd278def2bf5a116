"""Trees of arrays as NumPy files, which run no code when they are read."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError

Tree = TypeVar("Tree")


def save(path: Path, tree: Any) -> None:
    """Write the leaves of a tree, in their order."""
    leaves = jax.tree.leaves(tree)
    named: dict[str, Any] = {f"leaf_{i}": np.asarray(v) for i, v in enumerate(leaves)}
    np.savez(path, **named)


def read(path: Path) -> dict[str, np.ndarray]:
    """The arrays in a file.

    Raises: InputError where it is missing or incomplete, or holds Python objects.
    """
    try:
        # Opened here: NumPy leaves a damaged file open.
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise InputError(str(path), "must be a file", "nothing there", "check the path") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        rule, fix = "must be a complete file of arrays", "train anew, or bring back the file"
        raise InputError(str(path), rule, str(error), fix) from None


def load(path: Path, like: Tree) -> Tree:
    """A tree of the structure, shapes and dtypes of `like` with the arrays in a file.

    Raises: InputError where the file is incomplete or its arrays are those of another tree.
    """
    stored = read(path)
    leaves, structure = jax.tree.flatten(like)
    want = [(f"leaf_{i}", np.shape(v), np.asarray(v).dtype) for i, v in enumerate(leaves)]
    got = [(name, v.shape, v.dtype) for name, v in stored.items()]
    if want != got:
        rule = "must hold the arrays of this training"
        raise InputError(str(path), rule, f"{len(got)} others", "resume with its own settings")
    return jax.tree.unflatten(structure, [jnp.asarray(v) for v in stored.values()])


__all__ = ["load", "read", "save"]
