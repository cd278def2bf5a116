"""What a Monte Carlo leaves: tables for people and programs, and one page."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from jaxsim.html import Section, Summary, Table, write_html
from jaxsim.montecarlo import QUANTILES, Job, Row
from jaxsim.provenance import provenance, write_json
from jaxsim.status import Status
from jaxsim.study import Study

_SHOWN = (0, 3, 5, 7)  # of the quantiles, as many as 80 columns hold
_HEAD = ("metric", "mean", *(f"{100 * q:g} %" for q in QUANTILES))


def print_table(console: Any, rows: list[Row]) -> None:
    """Quantiles on the screen."""
    from rich.table import Table as Shown

    shown = Shown("metric", *(f"{100 * QUANTILES[i]:g} %" for i in _SHOWN), "worst drive")
    for row in rows:
        numbers = (f"{row.quantiles[i]:.4g}" for i in _SHOWN)
        shown.add_row(row.metric, *numbers, str(row.drive))
    console.print(shown)


def write(
    out: Path, study: Study, job: Job, drives: int, rows: list[Row], failed: dict[int, int]
) -> None:
    """quantiles.csv, worst.csv, montecarlo.json, report.html."""
    quantiles = [(r.metric, r.mean, *r.quantiles) for r in rows]
    _csv(out / "quantiles.csv", _HEAD, quantiles)
    paths = [r.path for r in job.ranges]
    worst_head = ("metric", "value", "drive", *paths)
    worst = [
        (r.metric, r.worst, r.drive, *(r.values.get(p, float("nan")) for p in paths)) for r in rows
    ]
    _csv(out / "worst.csv", worst_head, worst)
    about = provenance(seed=job.seed, dtype=job.dtype)
    words = {Status(code).words: count for code, count in failed.items()}
    content = {"study": study.name, "drives": drives, "failed": words}
    ranges = {r.path: [r.lower, r.upper] for r in job.ranges}
    numbers = {r.metric: r._asdict() for r in rows}
    write_json(
        out / "montecarlo.json",
        {**content, "ranges": ranges, "levels": QUANTILES, "metrics": numbers, **about},
    )
    tables = [
        Table("Each metric over all drives: mean and quantiles.", _HEAD, quantiles),
        Table("The drive that is worst, by number, and its values in SI units.", worst_head, worst),
        Table("What differs from drive to drive, uniform between these values in SI units.",
              ("parameter", "from", "to"), [tuple(r) for r in job.ranges]),
    ]  # fmt: skip
    title = f"{study.name} on {drives:,} drives"
    write_html(out / "report.html", title, _summary(study, drives, rows, words),
               [Section("Results", tables)], about)  # fmt: skip


def _summary(study: Study, drives: int, rows: list[Row], failed: dict[str, int]) -> Summary:
    """Whether the limits of the study hold on every drive."""
    bad = [f"{count} did not complete: {words}" for words, count in failed.items()]
    limits = study.objective.limits if study.objective else ()
    broken = []
    for limit in limits:
        for row in rows:
            if row.metric.split("[")[0] == limit.metric:
                extreme = row.quantiles[0] if limit.least else row.quantiles[-1]
                if limit.sign * extreme > limit.sign * limit.bound:
                    broken.append(f"{limit.words} does not hold: {extreme:.5g}")
    if bad or broken:
        return Summary("Not every drive does what it should.", [*broken, *bad], "bad")
    if limits:
        return Summary(f"All limits hold on all {drives:,} drives.", (), "good")
    return Summary(f"{drives:,} drives ran; the study sets no limits.", (), "plain")


def _csv(path: Path, head: Any, rows: Any) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)
