"""`gearlash certify`: are the gradients of a study right?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    parameter: Annotated[
        list[str] | None,
        typer.Option(help="Parameter of law or drive; repeat. Default: all numbers of the law."),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(help="Metric; repeat. Default: those of the study's objective."),
    ] = None,
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    scenario: Annotated[
        str | None, typer.Option(help="Of a study with several; default: the first.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for certificate.json, a picture, report.html.")
    ] = None,
) -> None:
    """Check a study's gradients against finite differences of the located run."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim import certificate_report, tree
    from jaxsim._certify import certify
    from jaxsim.errors import called
    from jaxsim.objective import check_name
    from jaxsim.options import opened
    from jaxsim.provenance import keep_results, make_folder
    from jaxsim.study import owner_of

    what = opened(study, law=law, scenario=scenario)
    for name in metric or []:
        check_name(name, "--metric")
    for name in parameter or []:
        with called("--parameter"):
            owner_of(what, name)
    wanted = what.objective.metrics() if what.objective else ("first_impact_Nm", "itae_rad_s2")
    console = Console()
    if out is not None:
        keep_results("--out", out / "certificate.json")
        make_folder("--out", out)
    with console.status("Gradients forward, reverse and by differences ..."):
        names = parameter or [f"law.{path}" for path in tree.numbers(what.law)]
        rows = certify(what, names, metric or wanted)
    console.print(table(rows, what.name))
    if out is not None:
        certificate_report.write(out, what, rows)
        console.print(f"Wrote {', '.join(certificate_report.FILES)} to {out}")
    if any(row.verdict == "wrong" for row in rows):
        raise typer.Exit(1)


def table(rows: list[Any], name: str) -> Any:
    """The rows for the screen, 80 columns wide; gradients are scaled, p * d metric/dp."""
    from rich import box
    from rich.table import Table

    from jaxsim._certify import STEPS
    from jaxsim.certificate_report import short

    shown = Table(
        title=f"{name}: p * d metric/dp, in SI",
        title_justify="left",
        box=box.SIMPLE,
        padding=(0, 1, 0, 0),
    )
    shown.add_column("parameter", no_wrap=True)
    for column in ("gradient", "-reverse", *(f"diff {h:g}" for h in STEPS[1:3])):
        shown.add_column(column, justify="right", no_wrap=True)
    shown.add_column("", no_wrap=True)
    names = short(rows)
    for i, r in enumerate(rows):
        if i == 0 or r.metric != rows[i - 1].metric:
            shown.add_row(f"[bold]{r.metric}[/]")
        style = {"wrong": "bold red", "jumps": "yellow"}.get(r.verdict, "green")
        numbers = (r.forward, *r.differences[1:3])
        gradient, *differences = (f"{r.scale * v:.4g}" for v in numbers)
        apart = f"{r.scale * (r.forward - r.reverse):.0e}"
        shown.add_row(
            f" {names[r.parameter]}", gradient, apart, *differences, f"[{style}]{r.verdict}[/]"
        )
    return shown
