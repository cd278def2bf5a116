"""`gearlash map`: poles and runs over a plane of two gains."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    x: Annotated[str, typer.Option(help="Gain of the law, across.")],
    y: Annotated[str, typer.Option(help="Gain of the law, upwards.")],
    out: Annotated[Path, typer.Option(help="Folder for table, plot and page.")],
    x_range: Annotated[
        tuple[float, float] | None, typer.Option(help="Default: its bounds in [tune.free].")
    ] = None,
    y_range: Annotated[tuple[float, float] | None, typer.Option(help="The same for y.")] = None,
    points: Annotated[int | None, typer.Option(min=2, help="Per gain; default 41.")] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(help="Repeat. Default: the objective's and the limit cycle."),
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(help="Of a study with several; default: the first.")
    ] = None,
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    tuned: Annotated[
        str | None, typer.Option(help="law.toml of `gearlash tune`, to be marked.")
    ] = None,
) -> None:
    """Map two gains: poles of every contact mode and the batched nonlinear runs."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim.options import law_of, opened
    from jaxsim.provenance import keep_results, make_folder
    from tuning import gain_map, gain_map_report

    what = opened(study, law=law, scenario=scenario)
    count = points or gain_map.POINTS
    across = gain_map.axis_of(what, "--x", x, x_range, count)
    upwards = gain_map.axis_of(what, "--y", y, y_range, count)
    names = tuple(metric) if metric else gain_map.usual(what)
    keep_results("--out", out / "map.json")
    make_folder("--out", out)
    console = Console()
    marks = {"study": gain_map_report.marked(what.law, across, upwards)}
    if tuned is not None:
        other = law_of(study, "--tuned", tuned)
        marks["tuned"] = gain_map_report.marked(other, across, upwards)
    with console.status(f"{count} x {count} laws: runs and poles ..."):
        found = gain_map.survey(what, across, upwards, names)
        files = gain_map_report.write(what, found, marks, out)
    for line in gain_map_report.sentences(what, found):
        console.print(line)
    console.print(f"Wrote {', '.join(files)}: {out}")
