"""Drives that were measured, one by one."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.components import read_toml
from jaxsim.errors import InputError
from jaxsim.study import Study
from tuning.drive_set import Drives, DriveSet, Quantity, quantity_in, with_own

_EXAMPLE = 'e.g. list = [{ half_gap = "7 mrad", K = 250 }]'


class List(DriveSet):
    """`list = [{ half_gap = "7 mrad", K = 250 }, ...]`, or the name of a file with the same.

    TOML: `[[drive]]` tables. CSV: a column per parameter, "half_gap [mrad]" or SI. The study's
    drive and those of the list, which all name the same parameters.
    """

    def read(self, study: Study, given: Any, count: int, seed: int, where: str) -> Drives:
        rows = _read(study.folder / given) if isinstance(given, str) else given
        if not isinstance(rows, list) or not rows or not all(isinstance(r, dict) for r in rows):
            raise InputError(where, "must be a list of drives", repr(given), _EXAMPLE)
        names = list(rows[0])
        quantities = [quantity_in(study, name, where) for name in names]
        table = []
        for k, row in enumerate(rows):
            place = f"{where}[{k}]"
            if set(row) != set(names):
                fix = f"give {', '.join(names)} in each"
                raise InputError(place, "must name the same parameters", sorted(row), fix)
            table.append([_one(study, q, row[q.name], f"{place}.{q.name}") for q in quantities])
        values = np.array(table)
        ends = zip(quantities, values.min(axis=0), values.max(axis=0), strict=True)
        spreads = tuple(q.spread(float(low), float(high)) for q, low, high in ends)
        return with_own(study, spreads, values)


def _one(study: Study, quantity: Quantity, given: Any, where: str) -> float:
    values = quantity.values(study, given, where)
    if len(values) != 1:
        raise InputError(where, "must be one number", given, "give a single value")
    return float(values[0])


def _read(path: Path) -> Any:
    """The drives of a file, as the study file would list them."""
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    drives = read_toml(path)
    if list(drives) != ["drive"]:
        fix = "write one [[drive]] per drive"
        raise InputError(str(path), "must hold [[drive]] tables", sorted(drives), fix)
    return drives["drive"]


def _read_csv(path: Path) -> list[dict[str, Any]]:
    try:
        rows = list(csv.DictReader(path.read_text("utf-8-sig").splitlines()))
    except FileNotFoundError:
        raise InputError(str(path), "must be a file", "nothing there", "check the path") from None
    return [dict(_cell(head, text) for head, text in row.items()) for row in rows]


def _cell(head: str, text: str) -> tuple[str, Any]:
    """A parameter and its value: with the unit in the head, else in SI."""
    name, unit = re.fullmatch(r"\s*(.*?)\s*(?:\[(.*)\])?\s*", head or "").groups()  # type: ignore[union-attr]
    if unit:
        return name, f"{text} {unit}"
    try:
        return name, float(text)
    except (TypeError, ValueError):
        return name, text
