"""`gearlash train`: an agent for a task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from jaxsim.errors import InputError


def command(
    task: Annotated[str, typer.Argument(help="Task, such as backlash_position.")],
    out: Annotated[Path, typer.Option(help="Folder for policy, curve and checkpoints.")],
    algo: Annotated[str, typer.Option(help="apg, ppo, sac or td3.")] = "apg",
    seed: Annotated[int, typer.Option(min=0, help="Of weights and training episodes.")] = 0,
    seeds: Annotated[
        int, typer.Option(min=1, help="Trainings, from --seed on; several: in OUT/seed-N each.")
    ] = 1,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="NAME=VALUE for an entry of the preset; repeat."),
    ] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes for --seeds; 0: this one.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder.")] = False,
) -> None:
    """Train an agent: analytic policy gradients, or PPO, SAC, TD3 of stable-baselines3."""
    from jaxsim.options import pairs
    from jaxsim.scale import Where
    from rl.spec import read_spec
    from rl.store import read_spec_of

    where = Where(scheduler, workers)
    if seeds > 1:
        every = range(seed, seed + seeds)
        specs = [read_spec(task, algo, s, pairs(change or [])) for s in every]
        return _train_many(specs, out, where, resume)
    if where != Where():
        fix = "add --seeds, or leave it out"
        raise InputError("--workers, --scheduler", "need several trainings", "one", fix)

    if resume:
        if change:
            _refuse_changes()
        spec = read_spec_of(out)
    else:
        spec = read_spec(task, algo, seed, pairs(change or []))
    import jaxsim

    # Training is in float32: twice as fast, and no finer than what its episodes differ by.
    jaxsim.configure(x64=False)
    from rich.console import Console

    from jaxsim.provenance import keep_results, make_folder

    if not resume:
        keep_results("--out", out / "state.json", resumes=True)
    make_folder("--out", out)
    console = Console()
    with console.status("Setting up ..."):
        session = _session(spec, out, resume)
    try:
        _run(session, console)
    except KeyboardInterrupt:
        console.print("Interrupted: --resume goes on from the last validation.", style="yellow")
        raise typer.Exit(130) from None
    _conclude(session, console)


def _train_many(specs: list[Any], out: Path, where: Any, resume: bool) -> None:
    """One training per seed, here or on workers; one that is complete is not made again."""
    import jaxsim

    jaxsim.configure(x64=False)
    from rich.console import Console

    from jaxsim.components import read_json
    from jaxsim.provenance import keep_results, make_folder
    from rl.commands._progress import train_under_a_bar
    from rl.figures import learning
    from rl.store import read_rows

    named = [(f"seed-{spec.seed}", spec) for spec in specs]
    if not resume:
        keep_results("--out", *(out / name / "state.json" for name, _ in named), resumes=True)
    make_folder("--out", out)
    console = Console()
    try:
        train_under_a_bar(named, out, where, console)
    except KeyboardInterrupt:
        console.print("Interrupted: --resume goes on.", style="yellow")
        raise typer.Exit(130) from None
    learning(out / "learning.png", {specs[0].algo: [read_rows(out / n) for n, _ in named]},
             specs[0].task)  # fmt: skip
    for name, _ in named:
        result = read_json(out / name / "result.json")
        console.print(f"{name}: median cost {result['test_cost_median']:.4g} on test episodes")
    console.print(f"Wrote a folder per seed and learning.png: {out}")


def _refuse_changes() -> None:
    fix = "leave out --set, or train into another folder"
    raise InputError("--resume", "goes on with the spec in the folder", "--set", fix)


def _session(spec: Any, out: Path, resume: bool) -> Any:
    from rl.session import Session

    return Session(spec, out, resume=resume)


def _run(session: Any, console: Any) -> None:
    """The training under a progress bar."""
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    spec = session.spec
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=16),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[shown]}"),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(f"{spec.algo} {spec.task}", total=spec.total, shown="compiling")
        if session.rows:
            bar.update(task, completed=session.trainer.done, shown="")

        def tell(row: Any) -> None:
            shown = f"cost {row.cost:.4g}, loss {row.validation:.4g}, best {row.best:.4g}"
            bar.update(task, completed=row.done, shown=shown)

        session.run(tell)


def _conclude(session: Any, console: Any) -> None:
    """Score on the test episodes; write result and curve; say how it went."""
    from rl.figures import learning
    from rl.store import write_result

    with console.status("Scoring on test episodes ..."):
        scores = session.test()
    folder = session.folder
    result = write_result(folder, session.spec, session.rows, scores)
    learning(folder / "learning.png", {session.spec.algo: [session.rows]}, session.spec.task)
    console.print(
        f"Median cost {result['test_cost_median']:.4g} over {len(scores.cost)} test episodes; "
        f"{result['steps']:,} steps, {result['cpu_s']:.0f} CPU s."
    )
    console.print(f"Wrote policy.json, law.toml, progress.csv, result.json, learning.png: {folder}")
