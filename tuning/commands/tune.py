"""`gearlash tune`: gains for a batch of drives, with limits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    out: Annotated[Path, typer.Option(help="Folder for law, tables and plots.")],
    starts: Annotated[int | None, typer.Option(min=1, help="Starts of the search.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of drives and starts.")] = None,
    law: Annotated[str | None, typer.Option(help="File to take the first law from.")] = None,
    front: Annotated[
        tuple[str, str] | None,
        typer.Option(help="Two metrics: the front between them, too, as `gearlash pareto` has it."),
    ] = None,
    plane: Annotated[
        tuple[str, str] | None,
        typer.Option("--map", help="Two gains: their map, too, as `gearlash map` has it."),
    ] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0: this one.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder.")] = False,
) -> None:
    """Tune gains by gradients over a batch of drives, under hard limits.

    Exit 0: every limit holds on every drive. 1: no such law was found. 3: every limit holds, but
    drives that run under no law were left out, and named. 130: interrupted; what there was is kept.
    """
    import jaxsim

    jaxsim.configure()
    from jaxsim.options import opened
    from jaxsim.provenance import keep_results, make_folder
    from jaxsim.scale import Where
    from tuning.session import Session
    from tuning.spec import read_spec
    from tuning.workers import sharing

    what = opened(study, law=law)
    spec = read_spec(what, starts=starts, seed=seed)
    beside = Beside(what, spec, front, plane)
    if not resume:
        keep_results("--out", out / "result.json", out / "checkpoint.json", resumes=True)
    make_folder("--out", out)
    with sharing(Where(scheduler, workers), out / "chunks", resume=resume) as share:
        _tune(Session(what, spec, out / "checkpoint.json", share), beside, out, resume)


def _tune(session: Any, beside: Beside, out: Path, resume: bool) -> None:
    """The search and its results; Ctrl-C at any moment keeps what there is."""
    from rich.console import Console

    from tuning import session as sessions

    console = Console()
    if resume:
        with console.status("Taking up the search ..."):
            sessions.resume(session)
    try:
        _search(session, console)
    except KeyboardInterrupt:
        console.print("Interrupted before any law was evaluated: no checkpoint yet, start anew.")
        raise typer.Exit(130) from None
    try:
        result = _conclude(session, out, console)
        if not session.interrupted:
            beside.add(session, result, out, console)
    except KeyboardInterrupt:
        console.print("Interrupted: the search is kept; --resume writes its results.")
        raise typer.Exit(130) from None
    if session.interrupted:
        console.print("Interrupted: the best law so far is kept; --resume goes on.", style="yellow")
        raise typer.Exit(130)
    if not result.feasible:
        raise typer.Exit(1)
    if session.excluded:
        raise typer.Exit(3)


class Beside:
    """A front and a map asked for beside a tuning; mistakes in them are told before the search."""

    def __init__(
        self,
        study: Any,
        spec: Any,
        front: tuple[str, str] | None,
        plane: tuple[str, str] | None,
    ) -> None:
        from tuning import gain_map, pareto

        self.study, self.spec = study, spec
        options = ("--front", "--front")
        self.pair = None if front is None else pareto.pair_of(spec.objective, front, options)
        self.axes = None
        if plane is not None:
            x, y = (gain_map.axis_of(study, "--map", n, None, gain_map.POINTS) for n in plane)
            self.axes = x, y

    def add(self, session: Any, result: Any, out: Path, console: Any) -> None:
        """Run them, write them into `front` and `map`, and put them on the page of the tuning."""
        from tuning import page

        more = [*self._front(result, out, console), *self._map(result, out, console)]
        if more:
            page.write(session, result, out, more)

    def _front(self, result: Any, out: Path, console: Any) -> list[Any]:
        if self.pair is None:
            return []
        from tuning import pareto, pareto_report
        from tuning.commands.pareto import traced

        marks = {"study": result.initial, "tuned": result.gains}
        (out / "front").mkdir(exist_ok=True)
        found = traced(
            self.study, self.spec, self.pair, marks, pareto.POINTS, out / "front", console
        )
        pareto_report.write(self.study, self.spec, found, out / "front")
        for line in pareto_report.sentences(self.spec, found):
            console.print(line)
        return pareto_report.sections(self.spec, found, out / "front")

    def _map(self, result: Any, out: Path, console: Any) -> list[Any]:
        if self.axes is None:
            return []
        from tuning import gain_map, gain_map_report

        laws = {"study": self.study.law, "tuned": result.law}
        marks = {name: gain_map_report.marked(law, *self.axes) for name, law in laws.items()}
        with console.status("Mapping the plane ..."):
            # The rest of the law is the tuned one: the map shows what is around it.
            around = self.study._replace(law=result.law)
            found = gain_map.survey(around, *self.axes, gain_map.usual(around))
            gain_map_report.write(around, found, marks, out / "map")
        for line in gain_map_report.sentences(around, found):
            console.print(line)
        return gain_map_report.sections(found, out / "map")


def _search(session: Any, console: Any) -> None:
    """The search under a progress bar; the time left is that of all iterations still allowed."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Left

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=12),
        TimeElapsedColumn(),
        TextColumn("left <="),
        Left(),
        TextColumn("{task.fields[best]}"),
    )
    tasks: dict[tuple[int, str], Any] = {}
    with Progress(*columns, console=console) as bar:
        waiting = bar.add_task("compiling", total=1, best="")

        def tell(p: Any) -> None:
            bar.update(waiting, completed=1, visible=False)
            if p.phase not in tasks:
                for task in tasks.values():
                    bar.update(task, completed=bar.tasks[task].total)
                tasks[p.phase] = bar.add_task(p.phase[1], total=p.total, best="")
            kept = "limits hold" if p.violation <= 0.0 else f"{100 * p.violation:.2g} % too much"
            bar.update(
                tasks[p.phase], completed=p.done, total=p.total, best=f"{p.cost:.4g}, {kept}"
            )

        session.search(tell)


def _conclude(session: Any, out: Path, console: Any) -> Any:
    """Score afresh, write everything, say how it went."""
    from tuning import figures, page, report, screen
    from tuning.result import conclude
    from tuning.words import sentences

    with console.status("Scoring afresh on the exact model ..."):
        result = conclude(session)
    report.write(session, result, out)
    for table in screen.tables(session, result):
        console.print(table)
    style = "bold green" if result.feasible else "bold red"
    first, *rest = sentences(session, result)
    console.print(first, style=style)
    for line in rest:
        console.print(line, markup=False)
    with console.status("Drawing ..."):
        figures.draw(session, result, out)
        page.write(session, result, out)
    files = (*report.FILES, *figures.FILES, "report.html")
    console.print(f"Wrote {', '.join(files)}: {out}")
    return result
