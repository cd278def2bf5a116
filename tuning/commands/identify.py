"""gearlash identify: parameters from logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file with an [identify] section.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    logs: Annotated[Path | None, typer.Option(help="Folder of the logs, not the study's.")] = None,
    starts: Annotated[int | None, typer.Option(help="Starts of the search.", min=1)] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the starts.", min=0)] = None,
) -> None:
    """Identify parameters from measurement logs.

    Writes drive.toml (the drive with intervals, for `drive.file` of any study), result.json,
    tables, plots and report.html. Exit 130 when interrupted: what there was is written.
    """
    from rich.console import Console

    from jaxsim import configure, load
    from jaxsim.provenance import make_folder
    from tuning.identification.spec import read_spec

    configure()
    what = load(study)
    spec = read_spec(what, starts=starts, seed=seed)
    spec = spec if logs is None else spec._replace(folder=logs)
    make_folder("--out", out)
    console = Console()
    outcome, rivals = _identify(what, spec, console)
    _conclude(what, spec, outcome, rivals, out, console)
    if outcome.interrupted:
        raise typer.Exit(130)


def _identify(study: Any, spec: Any, console: Any) -> Any:
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

        outcome = identify(study, spec, tell)
        return outcome, [] if outcome.interrupted else compare(study, spec, outcome, tell)


def _conclude(study: Any, spec: Any, outcome: Any, rivals: Any, out: Path, console: Any) -> None:
    """Write everything, say how it went."""
    from rich.table import Table

    from tuning.identification import figures, page, report

    report.write(study, spec, outcome, out)
    table = Table("parameter", "value", "low", "high", "unit", "verdict")
    for name, value, low, high, unit, _, kind, _, _ in report.rows(outcome):
        table.add_row(name, f"{value:.6g}", f"{low:.6g}", f"{high:.6g}", unit, kind)
    console.print(table)
    for line in report.sentences(outcome):
        console.print(line, markup=False)
    with console.status("Drawing ..."):
        pictures = figures.draw(outcome, out)
        page.write(study, spec, outcome, rivals, pictures, out)
    console.print(f"Wrote {', '.join(report.FILES)}, plots and report.html: {out}", markup=False)
