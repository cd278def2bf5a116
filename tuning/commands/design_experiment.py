"""gearlash design-experiment: which excitation shows the unknowns best."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file with [identify] and [identify.design].")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
) -> None:
    """Rank chirps, multisines, sines and square waves by the errors they would leave.

    Writes excitation.csv (time and command of the best), candidates.csv, result.json, plots and
    report.html. Expected at the study's own values: design, measure, identify, and design again.
    Exit 1: no candidate will do.
    """
    from rich.console import Console
    from rich.table import Table

    from jaxsim import configure, load
    from jaxsim.provenance import keep_results, make_folder
    from tuning.identification import design, design_page
    from tuning.identification.spec import read_spec

    configure()
    what = load(study)
    spec = read_spec(what)
    keep_results("--out", out / "result.json")
    make_folder("--out", out)
    console = Console()
    with console.status("Simulating the candidates ..."):
        ranked, problem, times = design.design(what, spec)
    unit = what.law.reference_unit or what.drive.command_unit
    shown = what.section("identify")["design"].get("shown", 8)
    made = design_page.Designed(ranked, problem, times, unit, shown)
    design_page.write(what, made, out)
    table = Table("excitation", "largest error [%]", "peak [Nm]", "gap", "remark")
    for r in ranked[:shown]:
        both = "crossed" if r.crosses else "not crossed"
        table.add_row(r.candidate.name, f"{100 * r.worst:.2g}", f"{r.peak:.3g}", both, r.reason)
    console.print(table)
    for line in design_page.sentences(made):
        console.print(line, markup=False)
    files = "excitation.csv, candidates.csv, result.json, plots and report.html"
    console.print(f"Wrote {files}: {out}", markup=False)
    if ranked[0].reason or ranked[0].worst == float("inf"):
        raise typer.Exit(1)
