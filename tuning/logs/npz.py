"""NumPy archives."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from tuning.log import Reader


class NPZ(Reader):
    """Arrays of numbers by name, (records, samples) where it holds several; texts of records."""

    suffixes: ClassVar[tuple[str, ...]] = (".npz",)

    def read(self, path: Path) -> dict[str, np.ndarray]:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return {k: v for k, v in arrays.items() if v.dtype.kind in "biufU" and v.ndim > 0}
