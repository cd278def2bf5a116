"""`gearlash reproduce`: the figures and numbers of a paper, next to what the paper says."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

VERDICT = {True: "[green]agrees[/]", False: "[bold red]DISAGREES[/]", None: ""}


def command(
    names: Annotated[
        list[str] | None, typer.Argument(help="all, or names of groups (--list shows them).")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the figures.")] = Path("results/reproduce"),
    json: Annotated[
        Path | None, typer.Option(help="File for all rows; default rows.json in the folder.")
    ] = None,
    listing: Annotated[bool, typer.Option("--list", help="List the groups and stop.")] = False,
) -> None:
    """Redo a paper's figures and numbers, and judge what it claims."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim import findings_report
    from jaxsim.provenance import make_folder

    console = Console()
    if listing:
        console.print(_listing())
        return
    groups, file = _chosen(names or []), json or out / "rows.json"
    for option, folder in (("--out", out), ("--json", file.parent)):
        make_folder(option, folder)
    rows, failed = _reproduce(groups, out, file, console)
    _report(rows, failed, console)
    findings_report.write(out, groups, rows, failed)
    console.print(f"Figures and report.html in {out}, all rows in {file}")
    if failed:
        raise typer.Exit(1)


def _chosen(names: list[str]) -> dict[str, Any]:
    """The groups by name, in the order of the catalog for `all`."""
    from jaxsim.errors import InputError
    from jaxsim.findings import GROUPS

    if not names:
        raise InputError("names", "must name what to reproduce", "nothing", "all, or see --list")
    known = GROUPS.all()
    for name in names:
        if name != "all" and ":" not in name and name not in known:
            raise InputError.unknown("reproduction", name, [*known, "all"])
    wanted = sorted(known) if "all" in names else list(dict.fromkeys(names))
    return {name: GROUPS.find(name) for name in wanted}


def _listing() -> Any:
    from rich.console import Group
    from rich.table import Table

    from jaxsim.findings import GROUPS

    tables: dict[str, Any] = {}
    for name, group in sorted(GROUPS.all().items()):
        if group.paper not in tables:
            shown = Table(title=group.paper, title_justify="left")
            for column in ("group", "what", "figures"):
                shown.add_column(column, no_wrap=column == "group")
            tables[group.paper] = shown
        tables[group.paper].add_row(name, group.title, ", ".join(group.figures))
    return Group(*tables.values())


def _reproduce(
    groups: dict[str, Any], out: Path, file: Path, console: Any
) -> tuple[dict[str, list[Any]], dict[str, str]]:
    """Rows by group, and why groups failed: one that fails does not lose the others.

    The file is written again after every group: an interrupt leaves what is done.
    """
    import time

    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    rows: dict[str, list[Any]] = {}
    failed: dict[str, str] = {}
    seconds: dict[str, float] = {}
    columns = (SpinnerColumn(), *Progress.get_default_columns()[:-1], TimeElapsedColumn())
    with Progress(*columns, TextColumn("{task.fields[group]}"), console=console) as progress:
        task = progress.add_task("Reproducing", total=len(groups), group="")
        for name, group in groups.items():
            progress.update(task, group=name)
            begun = time.perf_counter()
            rows[name] = _one(name, group, out, failed)
            seconds[name] = round(time.perf_counter() - begun, 2)
            _write(file, rows, failed, seconds)
            progress.advance(task)
        progress.update(task, group="")
    return rows, failed


def _one(name: str, group: Any, out: Path, failed: dict[str, str]) -> list[Any]:
    """The rows of one group, its figures drawn; what went wrong goes into `failed`."""
    import traceback

    rows: list[Any] = []
    try:
        found = group().find()
        rows = found.rows
        for figure, draw in found.figures.items():
            draw(out / f"{figure}.png")
    except Exception:  # reported with its traceback; the other groups are still wanted
        failed[name] = traceback.format_exc()
    return rows


def _write(
    file: Path, rows: dict[str, list[Any]], failed: dict[str, str], seconds: dict[str, float]
) -> None:
    from jaxsim.provenance import provenance, write_json

    content = {
        "provenance": provenance(),
        "rows": [row._asdict() for some in rows.values() for row in some],
        "failed": failed,
        "seconds": seconds,
    }
    write_json(file, content)


def _report(rows: dict[str, list[Any]], failed: dict[str, str], console: Any) -> None:
    """Numbers by group, then all claims, then what disagrees and what failed."""
    from rich.markup import escape

    claims = [row for some in rows.values() for row in some if row.id.startswith("claim.")]
    for name, some in rows.items():
        numbers = [row for row in some if not row.id.startswith("claim.")]
        if numbers:
            console.print(_numbers(name, numbers))
    if claims:
        console.print(_claims(claims))
    everything = [row for some in rows.values() for row in some]
    wrong = [row for row in everything if row.ok is False]
    judged = sum(row.ok is not None for row in everything)
    console.print(f"{len(everything)} rows, {judged} judged, {len(wrong)} disagree")
    for row in wrong:
        console.print(f"[bold red]{row.id}[/]: {escape(row.note)}")
    for name, why in failed.items():
        console.print(f"[bold red]{name} failed[/]: {escape(why)}")


def _numbers(name: str, rows: list[Any]) -> Any:
    from rich.table import Table

    shown = Table(title=name, title_justify="left")
    for column in ("id", "value", "unit", "paper", "judged"):
        right = column in ("value", "paper")
        shown.add_column(column, no_wrap=True, justify="right" if right else "left")
    for row in rows:
        shown.add_row(row.id, f"{row.value:.6g}", row.unit, _paper(row), VERDICT[row.ok])
    return shown


def _claims(rows: list[Any]) -> Any:
    from rich.table import Table

    shown = Table(title="What the paper claims", title_justify="left")
    for column in ("claim", "ours", "rule", "verdict"):
        narrow = column != "rule"
        shown.add_column(column, no_wrap=narrow, justify="right" if column == "ours" else "left")
    for row in rows:
        unit = "" if row.unit == "1" else f" {row.unit}"
        name, ours = row.id.removeprefix("claim."), f"{row.value:.4g}{unit}"
        shown.add_row(name, ours, row.tolerance, VERDICT[row.ok])
    return shown


def _paper(row: Any) -> str:
    return "" if row.paper is None else f"{row.paper:g}"
