"""gearlash design-experiment: which excitation shows the unknowns best."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file with [identify] and [identify.design].")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
) -> None:
    """Rank chirps, multisines, sines and square waves by the errors they would leave.

    Writes excitation.csv (time and command of the best), candidates.csv, result.json and a plot.
    Expected at the study's own values: design, measure, identify, and design again.
    """
    from rich.console import Console
    from rich.table import Table

    from jaxsim import configure, load
    from jaxsim.provenance import keep_results, make_folder
    from tuning.identification import design
    from tuning.identification.spec import read_spec

    configure()
    what = load(study)
    spec = read_spec(what)
    keep_results("--out", out / "result.json")
    make_folder("--out", out)
    console = Console()
    with console.status("Simulating the candidates ..."):
        ranked, problem, times = design.design(what, spec)
    _write(what, ranked, problem, times, out)
    names = problem.unknowns.names
    table = Table(*(f"{n} +-" for n in names), "peak [Nm]", "gap", "remark", "excitation")
    for r in ranked[: what.section("identify")["design"].get("shown", 8)]:
        errors = (f"{d:.2g}" for d in r.deviation)
        both = "crossed" if r.crosses else "not crossed"
        table.add_row(*errors, f"{r.peak:.3g}", both, r.reason, r.candidate.name)
    console.print(table)
    console.print(
        f"Wrote excitation.csv, candidates.csv, result.json, best.png: {out}", markup=False
    )


def _write(study: Any, ranked: Any, problem: Any, times: Any, out: Path) -> None:
    import numpy as np

    from jaxsim.plots import figure
    from jaxsim.provenance import provenance, write_json
    from tuning.identification.report import write_csv

    best = ranked[0]
    unit = study.law.reference_unit or study.drive.command_unit
    rows = zip(times, best.candidate.samples, strict=True)
    write_csv(out / "excitation.csv", ("time [s]", f"command [{unit}]"), rows)
    names = problem.unknowns.names
    head = ("excitation", "worst", *(f"error of {n}" for n in names), "crosses", "peak [Nm]", "why")
    write_csv(
        out / "candidates.csv",
        head,
        ((r.candidate.name, r.worst, *r.deviation, r.crosses, r.peak, r.reason) for r in ranked),
    )
    expected = dict(zip(names, np.asarray(best.deviation).tolist(), strict=True))
    content = {"best": best.candidate.name, "expected_errors": expected, "crosses": best.crosses}
    write_json(out / "result.json", content | provenance())
    with figure(out / "best.png", 3, sharex=True, size=(8.0, 5.4)) as axes:
        for ax, r in zip(axes, ranked[:3], strict=False):
            ax.plot(times, r.candidate.samples)
            ax.set_title(r.candidate.name)
            ax.set_ylabel(f"command [{unit}]")
        axes[-1].set_xlabel("time [s]")
