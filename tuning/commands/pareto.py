"""`gearlash pareto`: the front between two goals."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    between: Annotated[str, typer.Option(help="Metric that the points minimise.")],
    and_: Annotated[str, typer.Option("--and", help="Metric that the points limit.")],
    out: Annotated[Path, typer.Option(help="Folder for laws, tables and plots.")],
    points: Annotated[int | None, typer.Option(min=3, help="Of the front; default 12.")] = None,
    starts: Annotated[int | None, typer.Option(min=1, help="Of the searches.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of drives and starts.")] = None,
    law: Annotated[str | None, typer.Option(help="File to take the first law from.")] = None,
    tuned: Annotated[
        str | None, typer.Option(help="law.toml of `gearlash tune`: a start, and marked.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder.")] = False,
) -> None:
    """Trace the front between two goals as one batch, under the study's limits.

    Ctrl-C keeps the laws found by then and writes their front (exit 130); --resume goes on.
    """
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim.options import law_of, opened
    from jaxsim.provenance import keep_results, make_folder
    from tuning import pareto, pareto_report, space
    from tuning.spec import read_spec

    what = opened(study, law=law)
    spec = read_spec(what, starts=starts, seed=seed)
    pair = pareto.pair_of(spec.objective, (between, and_))
    if not resume:
        keep_results("--out", out / "front.json", out / "checkpoint.json", resumes=True)
    make_folder("--out", out)
    marks = {"study": space.gains_of(what.law, spec.free)}
    if tuned is not None:
        marks["tuned"] = space.gains_of(law_of(study, "--tuned", tuned), spec.free)
    console = Console()
    try:
        front = traced(what, spec, pair, marks, points or pareto.POINTS, out, console, resume)
    except KeyboardInterrupt:
        console.print("Interrupted before there was a law to keep; --resume writes what there is.")
        raise typer.Exit(130) from None
    files = pareto_report.write(what, spec, front, out)
    console.print(pareto_report.table(spec, front))
    first, *rest = pareto_report.sentences(spec, front)
    console.print(first, style="bold green" if front.points else "bold red")
    for line in rest:
        console.print(line, markup=False)
    console.print(f"Wrote {', '.join(files)}: {out}")
    if front.interrupted:
        raise typer.Exit(130)
    if not front.points:
        raise typer.Exit(1)


def traced(
    what: Any, spec: Any, pair: Any, marks: Any, points: int, out: Path, console: Any,
    resume: bool = False,
) -> Any:  # fmt: skip
    """The front, under a progress line; its state is kept in the folder."""
    import numpy as np
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from tuning import front, front_checkpoint, pareto, space

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("compiling")

        def tell(p: Any) -> None:
            state = f"{p.what}: iteration {p.iteration} of at most {p.most}"
            bar.update(task, description=f"{state}, {p.found} laws that none beats")

        file = out / "checkpoint.json"
        tracer = pareto.tracer_of(what, spec, pair, tell, file)
        if resume:
            front_checkpoint.read(tracer, points, file)
        given = space.to_unit(spec.free, np.array(list(marks.values())))
        starts = np.concatenate([given, space.starting_points(what.law, spec)[1:]])
        laws = tracer.trace(starts, points)
        bar.update(task, description="scoring afresh on the exact model")
        return front.conclude(tracer, laws, marks)
