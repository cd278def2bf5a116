"""The HTML writer: one self-contained file in which nothing of the content is lost or executed."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxsim.html import Picture, Section, Summary, Table, Text, write_html

_VOID = {"meta", "link", "img"}


class _Reader(HTMLParser):
    """Cells of the tables; fails on tags that are not closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.links += [v for k in ("src", "href") if (v := values.get(k)) is not None]
        if tag not in _VOID:
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "dot.png"
    Image.new("RGB", (2, 3), "red").save(path)
    return path


def test_report_holds_everything_and_needs_no_other_file(tmp_path: Path, picture: Path) -> None:
    rows = [["ITAE", 1.7642e-4, np.float64(-2.0)], ["<script>", None, True]]
    sections = [
        Section("Goals", [Text(["a < b"]), Table("before & after", ["goal", "J", "x"], rows)]),
        Section("Plots", [Picture("a red dot", picture)]),
    ]
    out = tmp_path / "report.html"
    about = {"command": "gearlash", "versions": {"jax": "0.10"}}
    write_html(out, "Tuned", Summary("It holds.", ["one remark"], "good"), sections, about)
    page = out.read_text("utf-8")
    reader = _Reader()
    reader.feed(page)
    assert reader.open == []
    assert reader.cells == [
        *("goal", "J", "x", "ITAE", "0.00017642", "-2", "<script>", "–", "yes"),
        *("command", "gearlash", "versions jax", "0.10"),
    ]
    assert page.count("<script>") == 1, "text of a table must not become a script"
    kept = re.search(r"data:image/png;base64,([^\"]+)", page)
    assert kept is not None
    assert base64.b64decode(kept[1]) == picture.read_bytes()
    anchors = [link for link in reader.links if not link.startswith("data:")]
    assert anchors == ["#s1", "#s2", "#provenance"], "no file or address outside"


def test_what_is_missing_in_a_column_of_numbers_aligns_with_them(tmp_path: Path) -> None:
    rows = [["a", None, 1.5, "x"], ["b", 2.0, None, None]]
    table = Table("t", ["name", "first", "second", "words"], rows)
    write_html(tmp_path / "r.html", "T", Summary("v"), [Section("S", [table])], {})
    text = (tmp_path / "r.html").read_text("utf-8")
    cells = re.findall(r"<t[hd]( class=\"number\")?>([^<]*)<", text)
    assert [bool(right) for right, _ in cells[:12]] == [False, True, True, False] * 3


def test_a_picture_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    sections = [Section("Plots", [Picture("none", tmp_path / "none.png")])]
    with pytest.raises(FileNotFoundError):
        write_html(tmp_path / "r.html", "T", Summary("v"), sections, {})
    assert not (tmp_path / "r.html").exists()
