"""Files that hold many recordings: which records are meant, and what each says of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim import tree
from jaxsim.errors import InputError
from jaxsim.quantity import to_si
from jaxsim.validation import check
from tuning.identification.experiment import Experiment, model_of
from tuning.identification.spec import Noted, Recording
from tuning.identification.unknowns import path_of, unit_of
from tuning.log import File, Log

# Numbers of a record count as equal to those of a study to this share.
_EQUAL = 1e-6


def rows(recording: Recording, file: File) -> list[int | None]:
    """The records of a file that a recording means; [None] where it is one record as a whole.

    `records` names what a record has one of and the values that are meant, in one table or several
    of which any will do; `first_of` keeps the first record, in the order of the file, of every
    combination of what it names.

    Raises: InputError for unknown names, and where no record is left.
    """
    if not recording.records and not recording.first_of:
        return [recording.row]
    given = recording.records
    tables = given if isinstance(given, list) else [given]
    names = [*(name for table in tables for name in table), *recording.first_of]
    for name in names:
        if name not in file.arrays:
            where = f"identify.experiments.records, in {file.path.name}"
            raise InputError.unknown(where, name, file.arrays)
    meant = np.zeros(len(file.arrays[names[0]]), bool) | (not tables)
    for table in tables:
        hits = [_among(file.arrays[name], values, name) for name, values in table.items()]
        meant |= np.logical_and.reduce(hits)
    found = _first_of([file.arrays[n] for n in recording.first_of], np.flatnonzero(meant))
    if not found:
        fix = "check the values; `gearlash inspect LOG --row 0` shows those of a record"
        raise InputError("identify.experiments.records", "must match", recording.records, fix)
    return [*found]


def _among(column: np.ndarray, values: Any, name: str) -> np.ndarray:
    """Which records have one of the values."""
    values = values if isinstance(values, list) else [values]
    text = column.dtype.kind == "U"
    if any(isinstance(v, str) != text for v in values):
        rule = "must be text" if text else "must be numbers"
        raise InputError(f"identify.experiments.records.{name}", rule, values, "as in the file")
    if text:
        return np.isin(column, values)
    return np.any([np.isclose(column, v, rtol=_EQUAL, atol=0.0) for v in values], axis=0)


def _first_of(columns: Sequence[np.ndarray], chosen: np.ndarray) -> list[int]:
    """All that are chosen, or the first of each combination of the columns."""
    if not columns:
        return chosen.tolist()
    first: dict[tuple[Any, ...], int] = {}
    for i in chosen.tolist():
        first.setdefault(tuple(c[i] for c in columns), i)
    return [*first.values()]


def _noted(log: Log, given: Noted, times: np.ndarray, unit: str, where: str) -> float | None:
    """What a column says of its recording, in SI units: a constant, or when it falls `below`.

    times: (n,) s of its readings. None where it never falls so low.

    Raises: InputError for a column that is missing or not constant.
    """
    values = log.column(given.column)
    if given.below is not None:
        low = np.flatnonzero(values < given.below)
        return float(times[low[0]]) if low.size else None
    if np.ptp(values) != 0.0:
        rule = "must be one number for a recording"
        got = f"{given.column} from {values.min():.6g} to {values.max():.6g}"
        raise InputError(where, rule, got, "name another column, or give `below`")
    value = float(values[0])
    return value if given.unit is None else float(to_si(f"{value:.17g} {given.unit}", unit, where))


def files(folder: Path, log: str) -> list[Path]:
    """The files of a name or pattern.

    Raises: InputError for a pattern without a match.
    """
    path = folder / log
    if not any(mark in log for mark in "*?["):
        return [path]
    found = sorted(path.parent.glob(path.name))
    if not found:
        fix = "check the pattern"
        raise InputError("identify.experiments.log", "must match a file", log, fix)
    return found


def known(made: Experiment, recording: Recording, log: Log, stamps: np.ndarray) -> Experiment:
    """What is known of this recording, or what its own columns say, written into its tree."""
    if not recording.set:
        return made
    model, times = model_of(made), stamps - stamps[0]
    for name, value in recording.set.items():
        where = f"identify.experiments.set.{name}"
        path = path_of(made, name, where)
        unit = unit_of(made, path)
        if isinstance(value, Mapping):
            number = _noted(log, check(Noted, value, where), times, unit, where)
        else:
            number = to_si(value, unit, where)
        if number is not None:
            model = tree.replace(model, {path: np.asarray(number, float)})
    sensors = zip(made.measurements, model.sensors, strict=True)
    measured = tuple(m._replace(sensor=s) for m, s in sensors)
    return made._replace(
        drive=model.drive, law=model.law, scenario=model.scenario, measurements=measured
    )
