"""Logs: files of measured columns, read by the reader that their ending names."""

from __future__ import annotations

import abc
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from jaxsim.catalog import Catalog
from jaxsim.errors import InputError

READERS = Catalog("logs", "tuning.logs", "tuning.log:Reader")


class Reader(abc.ABC):
    """Reads one format: a file becomes columns of numbers, what is no number becomes nan."""

    suffixes: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def read(self, path: Path) -> dict[str, np.ndarray]:
        """The columns of a file by name: (n,) each, or (rows, n) where it holds several records.

        Raises: InputError, or what the library raises (it is reported with the file's name).
        """


class Log(NamedTuple):
    """A file as it was read. columns: name -> (n,) float64."""

    path: Path
    columns: dict[str, np.ndarray]

    @property
    def name(self) -> str:
        return self.path.stem

    def column(self, name: str) -> np.ndarray:
        """A column by name.

        Raises: InputError for an unknown name, with the nearest.
        """
        if name not in self.columns:
            raise InputError.unknown(f"{self.path.name}: column", name, self.columns)
        return self.columns[name]


def read_log(path: Path, row: int | None = None) -> Log:
    """The columns of a file, in float64.

    row: which record of arrays (records, samples); without it a two-dimensional array NAME
    (samples, k) becomes the columns NAME[0] ... NAME[k-1].

    Raises: InputError for a missing file, an unknown ending, a file that cannot be read or is
    empty, and a row that is not there.
    """
    if not path.is_file():
        raise InputError(str(path), "must be a file", "nothing there", "check the path")
    readers = {suffix: cls for cls in READERS.all().values() for suffix in cls.suffixes}
    if path.suffix.lower() not in readers:
        raise InputError.unknown(f"{path.name}: ending", path.suffix, readers)
    try:
        raw = readers[path.suffix.lower()]().read(path)
    except InputError:
        raise
    except Exception as error:  # each library has classes of its own for a broken file
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(path.name, "must be readable", why, "check the file") from None
    columns = _flat(raw, row, path)
    if not columns:
        raise InputError(path.name, "must hold columns of numbers", "none", "check the file")
    return Log(path, columns)


def _flat(raw: dict[str, np.ndarray], row: int | None, path: Path) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    for name, values in raw.items():
        if row is not None:
            if not -len(values) <= row < len(values):
                got = f"{row} of {len(values)}"
                raise InputError(f"{path.name}: row", "must be a record", got, "name another")
            values = values[row]
        values = np.squeeze(np.asarray(values, float))
        if values.ndim == 1:
            columns[name] = values
        elif values.ndim == 2:
            columns |= {f"{name}[{i}]": column for i, column in enumerate(values.T)}
    return columns
