"""NumPy archives."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from tuning.log import Reader


class NPZ(Reader):
    """Numeric arrays by name; (records, samples) where the file holds several records."""

    suffixes: ClassVar[tuple[str, ...]] = (".npz",)

    def read(self, path: Path) -> dict[str, np.ndarray]:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return {k: v for k, v in arrays.items() if v.dtype.kind in "biuf" and v.ndim > 0}
