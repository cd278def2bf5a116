"""gearlash inspect: what is in a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    log: Annotated[Path, typer.Argument(help="CSV, Parquet, MAT or npz file.")],
    time: Annotated[str | None, typer.Option(help="Column of time stamps, if not found.")] = None,
    row: Annotated[int | None, typer.Option(help="Record of arrays (records, samples).")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for plots and report.html.")] = None,
) -> None:
    """Say what is in a measurement log, and what looks wrong.

    Sampling, jitter and gaps; per column range, quantisation step, noise and lone spikes; columns
    that are rates of others in some other unit.
    """
    from rich.console import Console

    from jaxsim.provenance import keep_results, make_folder
    from tuning.identification import inspection
    from tuning.log import read_log

    if out is not None:
        keep_results("--out", out / "report.html")
        make_folder("--out", out)
    opened = read_log(log, row)
    stamps = time or inspection.find_time(opened)
    if stamps is not None:
        opened.column(stamps)  # a wrong name is told with the nearest
    console = Console()
    tables = inspection.tables(opened, stamps)
    for caption, head, rows in tables:
        console.print(_table(caption, head, rows))
    words = inspection.remarks(opened, stamps) or ["Nothing looks wrong."]
    for line in words:
        console.print(line, markup=False)
    if out is not None:
        _write(opened, stamps, tables, words, out)
        console.print(f"Wrote plots and report.html: {out}", markup=False)


def _table(caption: str, head: Any, rows: Any) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(*head, title=caption)
    for row in rows:
        # Text: the brackets of "t [ms]" are no markup.
        table.add_row(*(Text(f"{v:.5g}" if isinstance(v, float) else str(v)) for v in row))
    return table


def _write(log: Any, time: str | None, tables: Any, words: list[str], out: Path) -> None:
    from jaxsim.html import Picture, Section, Summary, Table, write_html
    from jaxsim.provenance import provenance
    from tuning.identification import inspection_figures

    pictures = inspection_figures.draw(log, time, out)
    sections = [
        Section("What is in it", [Table(*table) for table in tables]),
        Section("Pictures", [Picture(caption, path) for caption, path in pictures]),
    ]
    clean = words == ["Nothing looks wrong."]
    summary = Summary(words[0], words[1:], "good" if clean else "plain")
    write_html(out / "report.html", f"Log {log.path.name}", summary, sections, provenance())
