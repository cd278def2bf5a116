"""`gearlash certify`: are the gradients of a study right?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    parameter: Annotated[
        list[str] | None,
        typer.Option(help="Parameter of law or drive; repeat. Default: all of the law's."),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(help="Metric; repeat. Default: those of the study's objective."),
    ] = None,
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for certificate.json.")] = None,
) -> None:
    """Check a study's gradients against finite differences of the located run."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim import tree
    from jaxsim.certify import certify
    from jaxsim.provenance import provenance, write_json
    from jaxsim.study import load

    what = load(study, law=law)
    wanted = what.objective.metrics() if what.objective else ("first_impact_Nm", "itae_rad_s2")
    console = Console()
    with console.status("Gradients forward, reverse and by differences ..."):
        names = parameter or [f"law.{path}" for path in tree.paths(what.law)]
        rows = certify(what, names, metric or wanted)
    console.print(table(rows, what.name))
    if out is not None:
        content = {"study": what.name, "rows": [row._asdict() for row in rows]}
        write_json(out / "certificate.json", content | provenance(dtype=what.run.dtype))
        console.print(f"Wrote {out / 'certificate.json'}")
    if any(row.verdict == "wrong" for row in rows):
        raise typer.Exit(1)


def table(rows: list[Any], name: str) -> Any:
    """The rows for the screen; gradients are scaled, p * d metric/dp."""
    from rich.table import Table

    from jaxsim.certify import STEPS

    shown = Table(title=f"Gradients of {name}, times the parameter's size", title_justify="left")
    for column in ("metric", "parameter"):
        shown.add_column(column)
    for column in ("forward", "reverse", *(f"diff {h:g}" for h in STEPS), "error"):
        shown.add_column(column, justify="right")
    shown.add_column("verdict")
    for r in rows:
        numbers = [r.scale * v for v in (r.forward, r.reverse, *r.differences)]
        style = {"wrong": "bold red", "jumps": "yellow"}.get(r.verdict, "green")
        shown.add_row(
            r.metric,
            r.parameter.rsplit(".", 1)[-1],
            *(f"{v:.5g}" for v in numbers),
            f"{r.error:.1e}",
            f"[{style}]{r.verdict}[/]",
        )
    return shown
