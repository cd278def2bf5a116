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
        """The columns of a file by name: (n,) each, or (records, n) where it holds several.

        Text may be among what records have one of: it serves to choose them.

        Raises: InputError, or what the library raises (it is reported with the file's name).
        """


class File(NamedTuple):
    """A file as its reader gives it: columns (n,), or arrays of records (records, n), by name."""

    path: Path
    arrays: dict[str, np.ndarray]


class Log(NamedTuple):
    """A file, or one record of it. columns: name -> (n,) float64."""

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


def read_file(path: Path) -> File:
    """All that a reader finds in a file.

    Raises: InputError for a missing file, an unknown ending, and a file that cannot be read.
    """
    if not path.is_file():
        raise InputError(str(path), "must be a file", "nothing there", "check the path")
    readers = {suffix: cls for cls in READERS.all().values() for suffix in cls.suffixes}
    if path.suffix.lower() not in readers:
        raise InputError.unknown(f"{path.name}: ending", path.suffix, readers)
    try:
        return File(path, readers[path.suffix.lower()]().read(path))
    except InputError:
        raise
    except Exception as error:  # each library has classes of its own for a broken file
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(path.name, "must be readable", why, "check the file") from None


def log_of(file: File, row: int | None = None) -> Log:
    """The columns of a file, in float64.

    row: which record of arrays (records, samples); what a record has one number of is a column of
    one. Without it a two-dimensional array NAME (samples, k) becomes NAME[0] ... NAME[k-1].

    Raises: InputError for a file without numbers, and a row that is not there.
    """
    columns: dict[str, np.ndarray] = {}
    for name, values in file.arrays.items():
        if values.dtype.kind not in "biuf":
            continue  # text serves to choose records
        if row is not None:
            if not -len(values) <= row < len(values):
                got = f"{row} of {len(values)}"
                raise InputError(f"{file.path.name}: row", "must be a record", got, "name another")
            values = values[row]
        alone = np.ndim(values) == 0
        values = np.squeeze(np.asarray(values, float))
        if alone:
            columns[name] = values[None]
        elif values.ndim == 1:
            columns[name] = values
        elif values.ndim == 2:
            columns |= {f"{name}[{i}]": column for i, column in enumerate(values.T)}
    if not columns:
        raise InputError(file.path.name, "must hold columns of numbers", "none", "check the file")
    return Log(file.path, columns)


def read_log(path: Path, row: int | None = None) -> Log:
    """`log_of` a file that is read for it."""
    return log_of(read_file(path), row)
