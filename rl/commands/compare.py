"""`gearlash compare`: agents against classical laws, on the same drives, scenarios and seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Comparison file, or the name of a shipped one.")],
    out: Annotated[Path, typer.Option(help="Folder for trainings, table, plots, report.")],
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0: this one.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler.")] = None,
) -> None:
    """Train what is missing, score agents and classical laws alike, write a report.

    The trainings are kept in the folder: a second call goes on where the first was stopped.
    """
    from rl.study import read_comparison

    what = read_comparison(study)
    import jaxsim

    # Agents train in float32; the classical laws' numbers need no more than that to compare.
    jaxsim.configure(x64=False)
    from rich.console import Console

    from jaxsim.provenance import make_folder
    from jaxsim.scale import Where
    from rl.commands._progress import train_under_a_bar

    make_folder("--out", out)
    console = Console()
    try:
        where = Where(scheduler, workers)
        train_under_a_bar(what.trainings(), out / "agents", where, console)
        lines, words = _compare(what, out, console)
    except KeyboardInterrupt:
        console.print("Interrupted: trainings are kept; the same command goes on.", style="yellow")
        raise typer.Exit(130) from None
    _show(lines, words, console)
    console.print(
        f"Wrote table.csv, comparison.json, tuned_law.toml, plots and report.html to {out}"
    )


def _compare(what: Any, out: Path, console: Any) -> tuple[Any, list[str]]:
    """Score everything and write it down."""
    from envs.environment import build
    from rl import comparison, nominal, report

    env = build(what.task)
    with console.status("Classical laws ...") as status:
        entries, laws, rival = comparison.classical(env, what)

        def tell(runs: int) -> None:
            status.update(f"Tuning the classical law: {runs} of {what.tuning} runs ...")

        entry, found = comparison.tuned(env, what, rival, tell)
        status.update("Agents ...")
        entries += [entry, *comparison.agents(what, out / "agents")]
        lines = comparison.table(entries)
        words = comparison.sentences(lines)
        status.update("Nominal case ...")
        paper = list(laws)[-1]
        laws |= {comparison.TUNED: found.law, **nominal.best_policies(what, out / "agents")}
        runs = nominal.run(laws, *nominal.case(what))
        unit = comparison.unit_of(env)
        words.append(nominal.sentence(what, out / "agents", paper, runs[paper], unit))
        status.update("Drawing ...")
        _draw_learning(what, out)
        report.write(out, what, entries, lines, words, found, runs, unit)
    return lines, words


def _draw_learning(what: Any, out: Path) -> None:
    from rl.figures import learning
    from rl.store import read_rows

    curves = {
        name: [read_rows(out / "agents" / f"{name}-{spec.seed}") for spec in specs]
        for name, specs in what.agents.items()
    }
    learning(out / "learning.png", curves, what.name)


def _show(lines: Any, words: list[str], console: Any) -> None:
    from rich import box
    from rich.table import Table

    from rl.comparison import TUNED

    title = "Median cost over the test episodes"
    look = {"box": box.SIMPLE_HEAD, "pad_edge": False, "padding": (0, 1, 0, 0)}
    shown = Table(title=title, title_justify="left", **look)
    shown.add_column("law", no_wrap=True)
    for name in ("cost", "of tuned", "95 %", "wins %", "CPU s"):
        shown.add_column(name, justify="right", no_wrap=True)
    for line in lines:
        interval = f"{line.ratio_low:.3g} to {line.ratio_high:.3g}"
        beaten = f"{100.0 * line.wins['cost']:.0f}"
        rival = ("-", "-") if line.name == TUNED else (interval, beaten)
        style = "bold" if line.name == TUNED else None
        row = f"{line.median:.4f}", f"{line.ratio:.3f}", *rival, f"{line.cpu:.0f}"
        shown.add_row(line.name, *row, style=style)
    console.print(shown)
    for text in words:
        console.print(text)
