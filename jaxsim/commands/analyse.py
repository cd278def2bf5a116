"""`gearlash analyse`: the linear loop of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE for law or drive; repeat.")
    ] = None,
    at: Annotated[
        str | None, typer.Option(help="Load angles, rad, comma between axes; default: the study's.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for analysis.json, the figures, report.html.")
    ] = None,
) -> None:
    """Linearise a study: poles, zeros, bandwidth, margins, stability; figures in a folder."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim import analysis_report
    from jaxsim.analysis import analyse
    from jaxsim.options import opened
    from jaxsim.provenance import keep_results, make_folder

    what = opened(study, law=law, change=change)
    if out is not None:
        keep_results("--out", out / "analysis.json")
        make_folder("--out", out)
    found = analyse(what, None if at is None else _angles(at))
    console = Console()
    for first in range(0, len(found.modes), _COLUMNS):
        console.print(_summary(found, found.modes[first : first + _COLUMNS]))
    console.print(_roots(found))
    for note in found.notes:
        console.print(f"Note: {note}", markup=False)
    if out is not None:
        analysis_report.write(out, found)
        console.print(f"Wrote analysis.json, the figures and report.html to {out}")


def _angles(text: str) -> list[float]:
    from jaxsim.errors import InputError

    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--at", "must be numbers", repr(text), "e.g. --at 0,0.5") from None


_COLUMNS = 3  # modes side by side, to fit a narrow screen


def _summary(found: Any, modes: list[Any]) -> Any:
    """One column per mode."""
    from rich.table import Table

    from jaxsim.analysis_report import bounds, facts, where

    shown = Table(title=f"{found.study} at {where(found)}", title_justify="left")
    shown.add_column("")
    for mode in modes:
        shown.add_column(mode.name, justify="right")
    rows = [facts(mode) for mode in modes]
    for name in rows[0]:
        shown.add_row(name, *(row[name] for row in rows))
    if found.region is not None and modes[0] is found.modes[0]:
        for name, values in bounds(found.region).items():
            shown.add_row(name, values, *[""] * (len(rows) - 1))
    return shown


def _roots(found: Any) -> Any:
    """Poles and zeros."""
    from rich.table import Table

    from jaxsim.analysis_report import roots

    shown = Table(title="Poles and zeros, 1/s", title_justify="left")
    for column in ("mode", "poles of the closed loop", f"zeros, command to {found.controlled}"):
        shown.add_column(column)
    for mode in found.modes:
        shown.add_row(mode.name, roots(mode.poles), roots(mode.zeros))
    return shown
