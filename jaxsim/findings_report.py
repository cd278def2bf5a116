"""The page of a reproduction: every number next to the paper's, and the figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from jaxsim.findings import Group, Row
from jaxsim.html import Picture, Section, Summary, Table, words, write_html
from jaxsim.provenance import provenance

_HEAD = ("number", "what", "value", "unit", "paper", "judged by", "verdict", "note")
_VERDICT = {True: "agrees", False: "DISAGREES", None: ""}


def write(
    out: Path, groups: Mapping[str, type[Group]], rows: Mapping[str, list[Row]],
    failed: Mapping[str, str],
) -> None:  # fmt: skip
    """report.html, with the figures that are in the folder."""
    sections = [
        Section(f"{groups[name].paper}: {name}", [_table(groups[name].title, some), *_figures(
            out, groups[name])]) for name, some in rows.items()
    ]  # fmt: skip
    every = [row for some in rows.values() for row in some]
    summary = _summary(every, list(failed))
    write_html(out / "report.html", "Papers, reproduced", summary, sections, provenance())


def _summary(rows: list[Row], failed: list[str]) -> Summary:
    judged = sum(row.ok is not None for row in rows)
    wrong = [f"{row.id} disagrees: {row.note}" for row in rows if row.ok is False]
    told = f"{judged - len(wrong)} of {judged} numbers that can be judged agree."
    lost = [f"{name} failed." for name in failed]
    return Summary(told, (*lost, *wrong), "bad" if failed else "plain")


def _table(title: str, rows: list[Row]) -> Table:
    cells = [
        [r.id, r.quantity, r.value, words(r.unit), r.paper, r.tolerance or "", _VERDICT[r.ok],
         r.note]
        for r in rows
    ]  # fmt: skip
    return Table(title, _HEAD, cells)


def _figures(out: Path, group: type[Group]) -> list[Picture]:
    paths = [out / f"{name}.png" for name in group.figures]
    return [Picture(path.stem.replace("_", " "), path) for path in paths if path.exists()]
