"""gearlash identify: parameters from logs."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file with an [identify] section.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    logs: Annotated[Path | None, typer.Option(help="Folder of the logs, not the study's.")] = None,
    starts: Annotated[int | None, typer.Option(help="Starts of the search.", min=1)] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the starts.", min=0)] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0: this one.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder.")] = False,
) -> None:
    """Identify parameters from measurement logs.

    Writes drive.toml (the drive with intervals, for `drive.file` of any study), result.json,
    tables, plots and report.html. Exit 0: every parameter is determined. 1: the record speaks
    against the model. 3: some parameters are not determined, or logs or structures are left out.
    130 when interrupted: what there was is written, and --resume goes on from finished fits.
    """
    from rich.console import Console

    from jaxsim import configure, load
    from jaxsim.provenance import make_folder
    from jaxsim.scale import Team, Where
    from tuning.identification import report
    from tuning.identification.chunks import Chunks
    from tuning.identification.spec import read_spec

    configure()
    what = load(study)
    spec = read_spec(what, starts=starts, seed=seed)
    spec = spec if logs is None else spec._replace(folder=logs)
    chunks = _chunks(out, resume)
    make_folder("--out", out)
    console = Console()
    try:
        with Team(Where(scheduler, workers)) as team:
            outcome, rivals = _identify(what, spec, console, Chunks(team, chunks))
    except KeyboardInterrupt:
        console.print("Interrupted: finished fits are kept; --resume goes on.", style="yellow")
        raise typer.Exit(130) from None
    _conclude(what, spec, outcome, rivals, out, console)
    if outcome.interrupted:
        console.print("Interrupted: finished fits are kept; --resume goes on.", style="yellow")
        raise typer.Exit(130)
    shutil.rmtree(chunks)
    if code := report.exit_code(outcome, rivals):
        raise typer.Exit(code)


def _chunks(out: Path, resume: bool) -> Path:
    """Where finished fits are kept until all is done.

    Raises: InputError where there are some that nobody asks for, or none to go on from.
    """
    from jaxsim.errors import InputError
    from jaxsim.provenance import keep_results

    chunks = out / "chunks"
    if not resume:
        keep_results("--out", chunks, resumes=True)
        keep_results("--out", out / "result.json")
    if resume and not chunks.exists():
        rule = "needs a search that was stopped"
        raise InputError("--resume", rule, f"no {chunks}", "leave --resume out")
    return chunks


def _identify(study: Any, spec: Any, console: Any, fitted: Any) -> Any:
    """The fits under a progress line."""
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from tuning.identification.compare import compare
    from tuning.identification.session import identify

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)

        def tell(what: str, p: Any) -> None:
            more = ""
            if p is not None:
                leg = f"part {p.stage + 1} of {p.stages}, " if p.stages > 1 else ""
                more = f": {leg}iteration {p.iteration}, {p.moving} moving, loss {p.loss:.5g}"
            bar.update(task, description=what + more)

        outcome = identify(study, spec, tell, fitted)
        return outcome, [] if outcome.interrupted else compare(study, spec, outcome, tell, fitted)


def _conclude(study: Any, spec: Any, outcome: Any, rivals: Any, out: Path, console: Any) -> None:
    """Write everything, say how it went."""
    from rich.table import Column, Table

    from tuning.identification import figures, page, report
    from tuning.identification.compare import sentence

    report.write(study, spec, outcome, rivals, out)
    widest = Column("verdict", min_width=12)  # contradicted
    table = Table("parameter", "value", "low", "high", "unit", widest)
    for name, value, low, high, unit, _, kind, _, _ in report.rows(outcome):
        table.add_row(name, f"{value:.6g}", f"{low:.6g}", f"{high:.6g}", unit, kind)
    console.print(table)
    for line in report.sentences(outcome) + ([sentence(rivals)] if rivals else []):
        console.print(line, markup=False)
    with console.status("Drawing ..."):
        pictures = figures.draw(outcome, out)
        page.write(study, spec, outcome, rivals, pictures, out)
    console.print(f"Wrote {', '.join(report.FILES)}, plots and report.html: {out}", markup=False)
