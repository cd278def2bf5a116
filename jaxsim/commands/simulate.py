"""`gearlash simulate`: run a study once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE for law or drive; repeat.")
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(help="Of a study with several; default: the first.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for run, events, metrics, plot, report.html.")
    ] = None,
) -> None:
    """Run a study: metrics and limits on the screen; signals, events and a page in a folder."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim import run_report
    from jaxsim.options import opened
    from jaxsim.provenance import keep_results, make_folder

    what = opened(study, law=law, scenario=scenario, change=change)
    if out is not None:
        keep_results("--out", out / "metrics.json")
        make_folder("--out", out)
    run, remarks = run_report.run_of(what)
    shown = run_report.lines(what, run)
    found = run_report.summary(what, run, shown)
    console = Console()
    console.print(run_report.as_table(what, shown, run))
    style = {"bad": "bold red", "good": "bold green"}.get(found.mood)
    console.print(found.verdict, style=style, markup=False)
    for line in (*found.remarks, *remarks):
        console.print(line, markup=False)
    if out is not None:
        run_report.write(out, what, run, shown, found)
        console.print(f"Wrote {', '.join(run_report.FILES)} to {out}")
    if run.failures():
        raise typer.Exit(1)
