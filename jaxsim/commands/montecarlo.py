"""`gearlash montecarlo`: a study's law on thousands or millions of drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    out: Annotated[Path, typer.Option(help="Folder for tables, page and finished chunks.")],
    drives: Annotated[int, typer.Option(min=1, help="How many.")] = 100_000,
    seed: Annotated[int, typer.Option(min=0, help="Of the drives.")] = 0,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help='NAME=WIDTH, e.g. "half_gap=30 %"; default: the spread of [tune.drives].'
        ),
    ] = None,
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    scenario: Annotated[str | None, typer.Option(help="Of a study with several.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0: this one.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder.")] = False,
) -> None:
    """Run a law on many drives: quantiles, the worst drives, any number of machines."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim import montecarlo as mc
    from jaxsim import scale
    from jaxsim.options import opened
    from jaxsim.provenance import make_folder

    what = opened(study, law=law, scenario=scenario)
    job = mc.job_of(what, mc.ranges_of(what, _pairs(vary or [])), seed)
    make_folder("--out", out)
    folder = out / "chunks"
    scale.prepare(folder, mc.plan_of(what, job, drives), resume=resume)
    console = Console()
    try:
        _compute(job, mc.chunks_of(drives), folder, scale.Where(scheduler, workers), console)
    except KeyboardInterrupt:
        console.print("Interrupted: finished chunks are kept; --resume goes on.", style="yellow")
        raise typer.Exit(130) from None
    rows, failed = mc.table(job, folder, drives)
    from jaxsim.montecarlo_report import print_table, write

    print_table(console, rows)
    write(out, what, job, drives, rows, failed)
    console.print(f"Wrote quantiles.csv, worst.csv, montecarlo.json and report.html to {out}")
    if failed:
        console.print(f"Did not complete: {sum(failed.values())} of {drives}", style="bold red")


def _pairs(given: list[str]) -> dict[str, str]:
    from jaxsim.errors import InputError

    values = {}
    for text in given:
        name, equals, width = text.partition("=")
        if not equals or not name:
            raise InputError("--vary", "must be NAME=WIDTH", repr(text), 'e.g. "half_gap=30 %"')
        values[name.strip()] = width
    return values


def _compute(job: Any, chunks: int, folder: Path, where: Any, console: Any) -> None:
    from rich.progress import Progress

    from jaxsim import montecarlo as mc
    from jaxsim import scale

    with Progress(console=console) as bar:
        task = bar.add_task(f"{chunks} chunks of {mc.CHUNK} drives", total=chunks)

        def tell(p: Any) -> None:
            bar.update(task, completed=p.done)

        with scale.Team(where) as team:
            team.compute(mc.work, job, chunks, folder, tell=tell)
