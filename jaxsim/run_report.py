"""What `gearlash simulate` says and leaves: metrics beside the study's limits, files, one page."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim import plots, tree
from jaxsim._simulate import simulate
from jaxsim.catalog import METRICS
from jaxsim.errors import InputError
from jaxsim.html import Picture, Section, Summary, Table, Text, words, write_html
from jaxsim.metric import unit_of
from jaxsim.objective import Limit
from jaxsim.provenance import provenance, write_json
from jaxsim.run import Run
from jaxsim.study import Study

FILES = ("run.csv", "events.csv", "metrics.json", "response.png", "report.html")
_SIGNALS = ("theta_L", "T_s", "T_M")


class Line(NamedTuple):
    """One number of a run, one value per axis; limit: its bound in words, empty without one.

    remark: whether the limit holds, or what a run says with this number that never does something.
    """

    metric: str
    values: list[float]
    unit: str
    limit: str
    remark: str
    broken: bool


def run_of(study: Study) -> tuple[Run, list[str]]:
    """The study's run with every metric and the criteria in its limits, and remarks.

    Raises: InputError where the study cannot run. A criterion that this loop does not have (a
    margin of a trained policy, say) is left out and told.
    """
    every = tuple(v for group in METRICS.all().values() for v in group.values)
    limits = study.objective.limits if study.objective else ()
    criteria = tuple(dict.fromkeys(x.metric for x in limits if x.metric not in every))
    try:
        return _simulated(study, (*every, *criteria) if criteria else None), []
    except InputError as error:
        run = _simulated(study, None)
        return run, [f"Not measured: {', '.join(criteria)}: {error}"]


def _simulated(study: Study, metrics: tuple[str, ...] | None) -> Run:
    options = study.run
    return simulate(
        study.drive, study.law, study.scenario, dt=options.dt, deadzone=options.deadzone,
        metrics=metrics, dtype=options.dtype, throw=False,
    )  # fmt: skip


def lines(study: Study, run: Run) -> list[Line]:
    """The metrics that this run has; those in the study's limits say whether these hold."""
    limits = study.objective.limits if study.objective else ()
    never = {k: v for group in METRICS.all().values() for k, v in group.never.items()}
    found = []
    for name, value in run.metrics.items():
        values = np.atleast_1d(np.asarray(value, float))
        own = [x for x in limits if x.metric == name]
        if np.isnan(values).all() and not own:
            continue
        broken = [x for x in own if not holds(x, values)]
        told = [f"{'>=' if x.least else '<='} {x.bound:g}" for x in own]
        said = ["BROKEN" if broken else "holds"] if own else []
        said += _never(values, *never[name]) if name in never else []
        unit = unit_of(name, study.drive.command_unit)
        found.append(
            Line(name, values.tolist(), unit, ", ".join(told), ", ".join(said), bool(broken))
        )
    return found


def _never(values: Any, special: float, said: str) -> list[str]:
    """What a number that stands for "never" says, with the axes where only some have it."""
    axes = np.flatnonzero(values == special)
    if len(axes) == len(values):
        return [said]
    return [f"axis {i}: {said}" for i in axes]


def holds(limit: Limit, values: Any) -> bool:
    """Whether a limit holds on every axis; an undefined number keeps no limit."""
    return bool(np.all(limit.excess(np.asarray(values)) <= 0.0))


def undefined(run: Run) -> list[str]:
    """The metrics that this run does not have."""
    return [name for name, value in run.metrics.items() if np.all(np.isnan(value))]


def summary(study: Study, run: Run, shown: list[Line]) -> Summary:
    """Did it complete, and do the study's limits hold in this one run."""
    failures = list(run.failures().values())
    if failures:
        return Summary(f"The run did not complete: {failures[0]}", (), "bad")
    broken = [line for line in shown if line.broken]
    count = len(study.objective.limits) if study.objective else 0
    told = f"{len(run.events())} events"
    if broken:
        said = [f"{x.metric} = {_numbers(x)} {x.unit} is not {x.limit}" for x in broken]
        return Summary(f"Limits of the study are broken: {'; '.join(said)}.", (told,), "bad")
    if count:
        return Summary(f"All limits of the study ({count}) hold in this run.", (told,), "good")
    return Summary("The run completed; the study sets no limits.", (told,), "plain")


def _numbers(line: Line) -> str:
    return ", ".join(f"{v:.6g}" for v in line.values)


def as_table(study: Study, shown: list[Line], run: Run) -> Any:
    """The metrics for the screen."""
    from rich import box
    from rich.table import Table as Shown

    look: Any = {"box": box.SIMPLE_HEAD, "pad_edge": False, "padding": (0, 1, 0, 0)}
    table = Shown(title=study.name, title_justify="left", caption_justify="left", **look)
    table.add_column("metric", no_wrap=True)
    table.add_column("value", no_wrap=True, justify="right")
    table.add_column("unit", no_wrap=True)
    table.add_column("limit")
    for line in shown:
        style = "bold red" if line.broken else None
        remark = f"{line.limit} {line.remark}".strip()
        table.add_row(line.metric, _numbers(line), line.unit, remark, style=style)
    left = undefined(run)
    table.caption = f"not defined for this run: {', '.join(left)}" if left else None
    return table


def write(out: Path, study: Study, run: Run, shown: list[Line], found: Summary) -> None:
    """All of `FILES`."""
    run.to_csv(out / "run.csv")
    with (out / "events.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time [s]", "surface", "rate [rad/s of the surface's guard]"))
        writer.writerows(run.events())
    about = provenance(dtype=study.run.dtype)
    write_json(out / "metrics.json", {"study": study.name, "metrics": run.metrics, **about})
    plots.responses(out / "response.png", {study.name: run}, _SIGNALS, study.name)
    caption = "Load angle, joint torque and motor torque; the dotted line is the reference."
    sections = [
        Section("Time response", [Picture(caption, out / "response.png")]),
        Section("Metrics", [_metrics(shown, run)]),
        Section("Events", [_events(run)]),
        Section("What was simulated", [_parameters(study)]),
    ]
    write_html(out / "report.html", f"Simulation of {study.name}", found, sections, about)


def _metrics(shown: list[Line], run: Run) -> Table:
    axes = max(len(line.values) for line in shown)
    head = ["value"] if axes == 1 else [f"axis {i}" for i in range(axes)]
    rows = [[x.metric, *x.values, words(x.unit), x.limit, x.remark] for x in shown]
    left = undefined(run)
    more = f" Not defined for this run: {', '.join(left)}." if left else ""
    caption = f"Every metric of the run; limits as the study sets them.{more}"
    return Table(caption, ["metric", *head, "unit", "limit", ""], rows)


def _events(run: Run) -> Table | Text:
    """How often each surface was crossed; events.csv has all of them."""
    if not run.events():
        return Text(["No surface was crossed."])
    counts = Counter(event.surface for event in run.events())
    first = {event.surface: event for event in reversed(run.events())}
    rows = [[name, count, first[name].time] for name, count in counts.items()]
    caption = (
        "Crossings of surfaces, located in time: contact+ and contact- are the flanks of the gap, "
        "the others switches of the law and stops. Every one is in events.csv."
    )
    return Table(caption, ["surface", "events", "first at, s"], rows)


def _parameters(study: Study) -> Table:
    """Every single number of law and drive."""
    rows = [
        [f"{owner}.{path}", float(tree.get(part, path)), words(tree.unit(part, path))]
        for owner, part in (("law", study.law), ("drive", study.drive))
        for path in tree.numbers(part)
    ]
    scenario, options = study.scenario, study.run
    rows += [["duration", scenario.duration, "s"], ["dt", options.dt, "s"]]
    return Table("Parameters of law and drive, SI.", ["parameter", "value", "unit"], rows)
