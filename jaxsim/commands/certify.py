"""`gearlash certify`: are the gradients of a study right?"""

from __future__ import annotations

from collections import Counter
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
    out: Annotated[Path | None, typer.Option(help="Folder for certificate.json.")] = None,
) -> None:
    """Check a study's gradients against finite differences of the located run."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim._certify import certify
    from jaxsim.provenance import make_folder, provenance, write_json
    from jaxsim.study import load

    what = load(study, law=law).in_scenario(scenario)
    wanted = what.objective.metrics() if what.objective else ("first_impact_Nm", "itae_rad_s2")
    console = Console()
    if out is not None:
        make_folder("--out", out)
    with console.status("Gradients forward, reverse and by differences ..."):
        names = parameter or [f"law.{path}" for path in _numbers(what.law)]
        rows = certify(what, names, metric or wanted)
    console.print(table(rows, what.name))
    if out is not None:
        content = {"study": what.name, "rows": [row._asdict() for row in rows]}
        write_json(out / "certificate.json", content | provenance(dtype=what.run.dtype))
        console.print(f"Wrote {out / 'certificate.json'}")
    if any(row.verdict == "wrong" for row in rows):
        raise typer.Exit(1)


def _numbers(law: Any) -> list[str]:
    """Paths of the parameters that are one number: not the arrays, such as Gammas per joint."""
    import numpy as np

    from jaxsim import tree

    return [path for path in tree.paths(law) if np.ndim(tree.get(law, path)) == 0]


def table(rows: list[Any], name: str) -> Any:
    """The rows for the screen, 80 columns wide; gradients are scaled, p * d metric/dp."""
    from rich import box
    from rich.table import Table

    from jaxsim._certify import STEPS

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
    names = _short(list(dict.fromkeys(r.parameter for r in rows)))
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


def _short(paths: list[str]) -> dict[str, str]:
    """The last step of each path, or all of it where two paths end alike."""
    tails = {path: path.rpartition(".")[2] for path in paths}
    counts = Counter(tails.values())
    return {path: tail if counts[tail] == 1 else path for path, tail in tails.items()}
