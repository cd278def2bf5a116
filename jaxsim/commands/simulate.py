"""`gearlash simulate`: run a study once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE for law or drive; repeat.")
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(help="Of a study with several; default: the first.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for run, events, metrics, plot.")] = None,
) -> None:
    """Run a study: metrics on the screen; signals, events and a plot in a folder."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim._simulate import simulate
    from jaxsim.provenance import make_folder
    from jaxsim.study import load, with_values

    what = with_values(load(study, law=law).in_scenario(scenario), pairs(change or []))
    if out is not None:
        make_folder("--out", out)
    run = simulate(
        what.drive,
        what.law,
        what.scenario,
        dt=what.run.dt,
        deadzone=what.run.deadzone,
        dtype=what.run.dtype,
        throw=False,
    )
    console = Console()
    console.print(_metrics(run, what.name))
    events = run.events()
    console.print(f"{len(events)} events, {int(run.event_count)} counted")
    if out is not None:
        _write(out, run, what)
        console.print(f"Wrote run.csv, events.csv, metrics.json and response.png to {out}")
    for words in run.failures().values():
        console.print(f"The run did not complete: {words}", style="bold red")
        raise typer.Exit(1)


def pairs(changes: list[str]) -> dict[str, Any]:
    from jaxsim.errors import InputError

    values: dict[str, Any] = {}
    for text in changes:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError("--set", "must be NAME=VALUE", repr(text), "e.g. --set K_B=-0.5")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            values[name.strip()] = value.strip()
    return values


def _metrics(run: Any, name: str) -> Any:
    import numpy as np
    from rich.table import Table

    shown = Table(title=name, title_justify="left")
    shown.add_column("metric")
    shown.add_column("value", justify="right")
    undefined = [metric for metric, value in run.metrics.items() if np.all(np.isnan(value))]
    for metric, value in run.metrics.items():
        if metric not in undefined:
            shown.add_row(metric, "  ".join(f"{v:.6g}" for v in np.atleast_1d(value)))
    shown.caption = f"not defined for this run: {', '.join(undefined)}" if undefined else None
    return shown


def _write(out: Path, run: Any, study: Any) -> None:
    import csv

    from jaxsim import plots
    from jaxsim.provenance import provenance, write_json

    run.to_csv(out / "run.csv")
    with (out / "events.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time [s]", "surface", "rate [rad/s of the surface's guard]"))
        writer.writerows(run.events())
    about = provenance(dtype=study.run.dtype)
    write_json(out / "metrics.json", {"study": study.name, "metrics": run.metrics, **about})
    names = ("theta_L", "T_s", "T_M")
    plots.responses(out / "response.png", {study.name: run}, names, study.name)
