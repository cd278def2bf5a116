"""Gains from the parameter sheet of a real drive: names and units of its own, in CSV or TOML."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim import tree
from jaxsim.components import read_toml
from jaxsim.errors import InputError
from jaxsim.parameters import violations
from jaxsim.quantity import to_si

_COLUMNS = ("name", "value", "unit")


class Entry(NamedTuple):
    """One line of a sheet: the drive's own name, the number, and the unit ("" where none)."""

    name: str
    value: float
    unit: str


class Imported(NamedTuple):
    """The law with the gains of the sheet.

    taken: parameter -> entry; kept: parameters that the sheet does not have; ignored: names of
    the sheet that are no parameters of the law.
    """

    law: Any
    taken: dict[str, Entry]
    kept: list[str]
    ignored: list[str]


def import_gains(law: Any, sheet: Path, names: Mapping[str, str]) -> Imported:
    """The law with the numbers of a sheet, in SI units.

    names: the drive's own name -> parameter of the law; names that are the law's need no entry.
    Raises: InputError for a number without its unit, a unit of another quantity, a parameter that
    is given twice, a name of `names` that the sheet lacks, and a sheet without any gain.
    """
    entries = read_sheet(sheet)
    for name in names:
        if name not in {e.name for e in entries}:
            raise InputError.unknown(f"--map {name}", name, {e.name for e in entries})
    taken, ignored = {}, []
    for entry in entries:
        path = _path(law, entry.name, names)
        if path is None:
            ignored.append(entry.name)
            continue
        if path in taken:
            both = f"{taken[path].name} and {entry.name}"
            raise InputError(path, "must be given once", both, "take one of them out")
        taken[path] = entry
    if not taken:
        known = ", ".join(tree.paths(law))
        raise InputError(str(sheet), "must hold a gain of the law", "none",
                         f"add --map DRIVE_NAME=PARAMETER; parameters: {known}")  # fmt: skip
    values = {path: _si(law, path, entry, sheet) for path, entry in taken.items()}
    kept = [p for p in tree.paths(law) if p not in taken]
    changed = tree.replace(law, {path: np.asarray(v, float) for path, v in values.items()})
    for words in violations(changed):
        raise InputError(sheet.name, "must keep the rules of the law", words, "correct the sheet")
    return Imported(changed, taken, kept, ignored)


def read_sheet(sheet: Path) -> list[Entry]:
    """CSV with columns name, value, unit (any order, others ignored), or TOML `name = "1 Nm/rad"`.

    Raises: InputError for a file that is neither, with the line that is wrong.
    """
    if not sheet.is_file():
        raise InputError("sheet", "must be a file", str(sheet), "check the path")
    return _from_toml(sheet) if sheet.suffix == ".toml" else _from_csv(sheet)


def _from_toml(sheet: Path) -> list[Entry]:
    entries = []
    for name, value in read_toml(sheet).items():
        number, _, unit = str(value).strip().partition(" ")
        entries.append(Entry(name, _number(number, f"{sheet.name}: {name}"), unit.strip()))
    return entries


def _from_csv(sheet: Path) -> list[Entry]:
    """Comma or semicolon; with semicolons the decimal comma of such sheets is read, too."""
    text = sheet.read_text("utf-8-sig")
    separator = ";" if ";" in text.partition("\n")[0] else ","
    rows = csv.DictReader(text.splitlines(), delimiter=separator)
    head = [str(name).strip().lower() for name in rows.fieldnames or ()]
    if not set(_COLUMNS) <= set(head):
        rule = "must have the columns name, value, unit"
        raise InputError(sheet.name, rule, head, "name them in the first line")
    rows.fieldnames = head
    entries = []
    for row in rows:
        name, value, unit = (str(row[c] or "").strip() for c in _COLUMNS)
        value = value.replace(",", ".") if separator == ";" else value
        where = f"{sheet.name}, line {rows.line_num}: {name}"
        entries.append(Entry(name, _number(value, where), unit))
    return entries


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(where, "must be a number", repr(text), "e.g. 12.5") from None


def _path(law: Any, name: str, names: Mapping[str, str]) -> str | None:
    """The parameter that a name of the sheet stands for; None where it stands for none."""
    if name in names:
        return tree.resolve(law, names[name])
    known = tree.paths(law)
    tails = [p for p in known if p == name or p.endswith(f".{name}")]
    return tree.resolve(law, name) if tails else None


def _si(law: Any, path: str, entry: Entry, sheet: Path) -> Any:
    unit = tree.unit(law, path)
    where = f"{sheet.name}: {entry.name}"
    if not entry.unit and unit != "1":
        fix = f"write its unit, e.g. {unit.split(' or ')[0]}"
        raise InputError(where, f"must have a unit convertible to {unit}", entry.value, fix)
    return to_si(f"{entry.value!r} {entry.unit}" if entry.unit else entry.value, unit, where)


__all__ = ["Entry", "Imported", "import_gains", "read_sheet"]
