"""MATLAB files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jaxsim.errors import InputError
from tuning.log import Reader


class MAT(Reader):
    """Numeric variables; the fields of a struct are named struct.field. Up to version 7."""

    suffixes: ClassVar[tuple[str, ...]] = (".mat",)

    def read(self, path: Path) -> dict[str, np.ndarray]:
        from scipy.io import loadmat

        try:
            content = loadmat(path, simplify_cells=True)
        except NotImplementedError:
            fix = "save it with `save -v7`, or export CSV"
            raise InputError(path.name, "must be MAT up to version 7", "7.3 (HDF5)", fix) from None
        found: dict[str, np.ndarray] = {}
        for name, value in content.items():
            if not name.startswith("__"):
                found |= _numbers(name, value)
        return found


def _numbers(name: str, value: Any) -> dict[str, np.ndarray]:
    if isinstance(value, dict):
        parts = (_numbers(f"{name}.{key}", inner) for key, inner in value.items())
        return {k: v for part in parts for k, v in part.items()}
    array = np.asarray(value)
    return {name: array} if array.dtype.kind in "biuf" and array.size > 1 else {}
