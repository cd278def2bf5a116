"""Apache Parquet."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from tuning.log import Reader


class Parquet(Reader):
    """Columns of numbers; times of day become seconds since the first."""

    suffixes: ClassVar[tuple[str, ...]] = (".parquet",)

    def read(self, path: Path) -> dict[str, np.ndarray]:
        import polars as pl

        columns = {}
        for column in pl.read_parquet(path):
            if column.dtype.is_temporal():
                column = (column - column[0]).dt.total_nanoseconds() * 1e-9
            if column.dtype.is_numeric() or column.dtype == pl.Boolean:
                columns[column.name] = column.cast(pl.Float64).to_numpy()
        return columns
