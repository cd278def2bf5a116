"""Text tables."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from tuning.log import Reader


class CSV(Reader):
    """One header line, then numbers; separated by commas, semicolons or tabs; `#` comments.

    With semicolons, a comma is the decimal point where no number has a point.
    """

    suffixes: ClassVar[tuple[str, ...]] = (".csv", ".txt", ".tsv")

    def read(self, path: Path) -> dict[str, np.ndarray]:
        import polars as pl

        with path.open(encoding="utf-8-sig") as file:
            lines = [line for _, line in zip(range(50), file, strict=False)]
        lines = [line for line in lines if not line.startswith("#")]
        separator = max(",;\t", key=lines[0].count) if lines else ","
        body = "".join(lines[1:])
        table = pl.read_csv(
            path,
            separator=separator,
            comment_prefix="#",
            infer_schema=False,
            truncate_ragged_lines=True,
        )
        decimal_comma = separator == ";" and "," in body and "." not in body
        columns = {}
        for column in table:
            text = column.str.strip_chars()
            text = text.str.replace_all(",", ".", literal=True) if decimal_comma else text
            numbers = text.cast(pl.Float64, strict=False)
            columns[column.name.strip()] = numbers.to_numpy()
        return columns
