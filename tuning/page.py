"""report.html of a tuning run: one file with everything, the verdict first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim._certify import STEPS
from jaxsim.html import Picture, Section, Summary, Table, Text, words, write_html
from jaxsim.metric import unit_of
from jaxsim.provenance import provenance
from tuning.certificate import PAIR
from tuning.report import Line, lines, sensitivity_table
from tuning.result import Result, Verdict
from tuning.session import Session
from tuning.words import at_bound, sentences


def write(session: Session, result: Result, out: Path, more: Sequence[Section] = ()) -> None:
    """report.html, from the plots in the folder; what is not there is not told.

    more: sections on what was asked for beside the tuning, a front or a map.
    """
    first, *rest = sentences(session, result)
    mood = "good" if result.feasible else "bad"
    sections = [
        Section("Gains", [_gains(session, result)]),
        Section("Goals and limits", [_goals(session, result), _limits(session, result)]),
        Section("Time responses", _pictures(out, "responses.png")),
        Section("Spread over the drives", _pictures(out, "spread.png")),
        *more,
        Section("Certificate", _certificate(session, result)),
        Section("Sensitivities", _sensitivities(session, result, out)),
        Section("The search", [*_pictures(out, "convergence.png"), _search(session)]),
        Section("All metrics", [_metrics(session, result)]),
    ]
    about = provenance(seed=session.spec.seed, dtype=session.study.run.dtype)
    title = f"Tuning of {session.study.name}"
    write_html(out / "report.html", title, Summary(first, rest, mood), sections, about)


_CAPTIONS = {
    "responses.png": "Before and after, on the study's drive and in the case that decides; "
    "runs on the model of the study.",
    "spread.png": "Share of the runs with a value below: each metric of the objective on all "
    "drives, before and after, by fresh runs on the exact model.",
    "convergence.png": "Cost of every start over the iterations; a point exceeds a limit where "
    "its mark is open.",
    "sensitivities.png": "What one per cent more of a gain does to each metric of the objective "
    "at the tuned law; no bar where the metric is 0 or jumps.",
}


def _pictures(out: Path, name: str) -> list[Picture]:
    return [Picture(_CAPTIONS[name], out / name)] if (out / name).exists() else []


def _gains(session: Session, result: Result) -> Table:
    rows = [
        [
            f.name,
            before,
            after,
            f.lower,
            f.upper,
            f.unit,
            "at a bound" if at_bound(f, after) else "",
        ]
        for f, before, after in zip(session.spec.free, result.initial, result.gains, strict=True)
    ]
    head = ["gain", "before", "after", "lower bound", "upper bound", "unit", ""]
    return Table("The free parameters; law.toml holds the whole law.", head, rows)


_WHERE = ("nominal", "mean", "worst", "worst on")


def _goals(session: Session, result: Result) -> Table:
    """Before and after, metrics of the objective only."""
    table = lines(session, result)
    rows = [
        [name, words(unit_of(name)), when, *line]
        for name in session.problem.metrics
        for when, line in zip(("before", "after"), table[name], strict=True)
    ]
    count, scenarios = result.after.status.shape
    what = f"On {count} drives in {scenarios} scenarios" if scenarios > 1 else f"On {count} drives"
    return Table(
        f"{what}, by fresh runs on the exact model; where the worst is, with the drive.",
        ["metric", "unit", "", *_WHERE],
        rows,
    )


def _limits(session: Session, result: Result) -> Table | Text:
    if not result.verdicts:
        return Text(["The study sets no limits."])
    rows = [_limit(session, v) for v in result.verdicts]
    head = ["limit", "bound", "over", "value", "at half dt", "holds", "worst on"]
    caption = "Limits; price: d cost/d bound at the tuned law, 0 where the limit does not press."
    return Table(caption, [*head, "price"], rows)


def _limit(session: Session, v: Verdict) -> list[Any]:
    numbers = [v.limit.bound, str(v.limit.over), v.value, v.finer]
    where = session.problem.label(v.drive, v.scenario)
    name = f"{v.limit.metric} {'>=' if v.limit.least else '<='}"
    return [name, *numbers, "yes" if v.holds else "NO", where, _known(v.price)]


def _known(value: float) -> float | None:
    return None if np.isnan(value) else value


def _certificate(session: Session, result: Result) -> list[Any]:
    """One table per case; certificate.csv has the differences at all steps."""
    text = (
        "Right: the gradient that the search used agrees with central differences of runs on the "
        "exact model for two neighbouring steps, within 1 % of its size or 1e-4 of the scaled "
        "gradient. Zero: the metric does not depend on any gain here. Jumps: the metric itself is "
        "discontinuous here. The error is for a change of the gain by its own size; differences "
        "at all steps are in certificate.csv."
    )
    head = ["metric", "gain", "gradient", *(f"difference, {STEPS[k]:g}" for k in PAIR)]
    tables = []
    for case in result.cases:
        own = [c for c in result.certificate.components if c.case == case]
        rows = [
            [c.metric, c.gain, c.gradient, *(c.differences[k] for k in PAIR), c.error, c.verdict]
            for c in own
        ]
        caption = f"d metric/d gain, SI, on {session.problem.label(*case)}."
        tables.append(Table(caption, [*head, "error", "verdict"], rows))
    return [Text([text]), *tables]


def _sensitivities(session: Session, result: Result, out: Path) -> list[Any]:
    """One table per case, metrics of the objective first."""
    head, rows = sensitivity_table(session, result)
    wanted = session.problem.metrics
    parts: list[Any] = _pictures(out, "sensitivities.png")
    for case in result.cases:
        label = session.problem.label(*case)
        own = [[row[1], *map(_known, row[2:])] for row in rows if row[0] == label]
        own.sort(key=lambda row: wanted.index(row[0]) if row[0] in wanted else len(wanted))
        what = "Per cent of the metric per per cent of the gain, from differences of exact runs"
        parts.append(Table(f"{what}, on {label}.", head[1:], own))
    return parts


def _search(session: Session) -> Table:
    """How each start of each stage ended."""
    ends: dict[tuple[str, int], dict[str, Any]] = {}
    for row in session.history:
        ends[row["stage"], row["start"]] = row
    names = [f.name for f in session.spec.free]
    keys = ["stage", "start", "iteration", "status", "cost", "violation", *names]
    rows = [[row[k] for k in keys] for row in ends.values()]
    head = ["stage", "start", "iterations", "status", "cost", "violation", *names]
    return Table(f"Where the starts stood last, after {session.seconds:.0f} s.", head, rows)


def _metrics(session: Session, result: Result) -> Table:
    rows = []
    for name, pair in lines(session, result).items():
        numbers = [_known(v) for line in pair for v in _numbers(line)]
        if any(v is not None for v in numbers):
            rows.append([name, *numbers])
    head = [f"{when} {what}" for when in ("before", "after") for what in _WHERE[:3]]
    return Table("Every metric; the drives are in table.csv.", ["metric", *head], rows)


def _numbers(line: Line) -> tuple[float, float, float]:
    return line.nominal, line.mean, line.worst
