"""The one look of all HTML reports: summary first, pictures with captions, provenance last."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxsim.provenance import replace_text

_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}
_DIGITS = 5


class Text(NamedTuple):
    """Paragraphs."""

    paragraphs: Sequence[str]


class Table(NamedTuple):
    """A table with a caption; numbers are shown with five significant digits.

    rows: per line as many cells as `header` has names; None is a dash. Columns of numbers align
    right, as do numbers among words.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[Any]]


class Picture(NamedTuple):
    """A PNG or SVG file with a caption that says what to see in it; it is embedded."""

    caption: str
    path: Path


class Section(NamedTuple):
    """A headed part of a report."""

    title: str
    parts: Sequence[Text | Table | Picture]


class Summary(NamedTuple):
    """What a reader in a hurry takes away: a verdict in one sentence, and what to know beside it.

    mood: `good` (green), `bad` (red) or `plain`.
    """

    verdict: str
    remarks: Sequence[str] = ()
    mood: Literal["good", "bad", "plain"] = "plain"


def words(unit: str) -> str:
    """A unit that stays on one line; that of a pure number is none."""
    return "" if unit == "1" else unit.replace(" ", "\N{NO-BREAK SPACE}")


def write_html(
    path: Path,
    title: str,
    summary: Summary,
    sections: Sequence[Section],
    provenance: Mapping[str, Any],
) -> None:
    """Write one self-contained HTML file: light and dark, readable on a phone, no network.

    provenance: of `jaxsim.provenance.provenance`; nested mappings become rows of their own.
    """
    text = _template().render(
        title=title, summary=summary, sections=sections, provenance=_rows(provenance)
    )
    replace_text(path, text)


def _template() -> Any:
    from jinja2 import Environment, StrictUndefined

    source = resources.files("jaxsim.templates").joinpath("report.html.j2").read_text("utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        "cell": _cell,
        "is_number": _is_number,
        "numeric": _numeric,
        "kind": _kind,
        "uri": _uri,
    }
    return environment.from_string(source)


def _kind(part: Any) -> str:
    return type(part).__name__


def _numeric(table: Table) -> list[bool]:
    """Whether each column aligns right: what stands in it are numbers, or nothing."""
    columns = [
        [r[i] for r in table.rows if r[i] not in (None, "")] for i in range(len(table.header))
    ]
    return [bool(column) and all(map(_is_number, column)) for column in columns]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _cell(value: Any) -> str:
    """A cell as text: floats with five significant digits, None as a dash."""
    if value is None:
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.{_DIGITS}g}"
    return str(value)


def _uri(path: Path) -> str:
    """The file as a data URI."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{_TYPES[path.suffix]};base64,{data}"


def _rows(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows = []
    for key, value in content.items():
        if isinstance(value, Mapping):
            rows += _rows(value, f"{prefix}{key} ")
        else:
            rows.append((f"{prefix}{key}", _cell(value)))
    return rows
