"""Results of a tuning run: files in a folder and the table on the screen."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim.components import dump
from jaxsim.provenance import provenance, write_json, write_toml
from tuning.result import Result, Scores, sentences
from tuning.session import Session
from tuning.spec import describe


class Line(NamedTuple):
    """One metric under one law: as the study is, mean over drives and scenarios, worst case.

    nominal: on the study's drive in its first scenario. worst: the value of largest size; drive:
    that has it, with its scenario.
    """

    nominal: float
    mean: float
    worst: float
    drive: str


def lines(session: Session, result: Result) -> dict[str, tuple[Line, Line]]:
    """Metric -> (before, after); those of the objective first."""
    wanted = session.problem.metrics
    names = [*wanted, *(n for n in result.after.values if n not in wanted)]
    return {
        name: (
            _line(session, result, result.before, name),
            _line(session, result, result.after, name),
        )
        for name in names
    }


def _line(session: Session, result: Result, scores: Scores, name: str) -> Line:
    worst, row, scenario = scores.worst(name)
    values = scores.values[name]
    mean = float(np.mean(values)) if np.isfinite(values).all() else np.nan
    nominal = float(np.max(values[0, 0])) if result.drives[0] == 0 else np.nan
    return Line(nominal, mean, worst, session.problem.label(int(result.drives[row]), scenario))


def write(session: Session, result: Result, out: Path) -> None:
    """law.toml, result.json, table.csv, drives.csv and history.csv, each replaced as a whole."""
    out.mkdir(parents=True, exist_ok=True)
    table = lines(session, result)
    about = provenance(seed=session.spec.seed, dtype=session.study.run.dtype)
    words = sentences(session, result)
    head = "\n".join([f"Tuned for {session.study.name}. {words[0]}", *words[1:]])
    write_toml(out / "law.toml", {"law": dump(result.law), "provenance": about}, head)
    write_json(out / "result.json", _content(session, result, table, words) | about)
    _write_csv(out / "table.csv", _TABLE_HEAD, (_flat(name, *pair) for name, pair in table.items()))
    _write_csv(out / "drives.csv", *_drives(session, result))
    history = session.history
    _write_csv(out / "history.csv", list(history[0]), (row.values() for row in history))


def _content(
    session: Session, result: Result, table: Mapping[str, tuple[Line, Line]], words: list[str]
) -> dict[str, Any]:
    names = [f.name for f in session.spec.free]
    study = session.study
    return {
        "study": study.name,
        "feasible": result.feasible,
        "status": result.status,
        "reason": result.reason,
        "words": words,
        "cost": {
            "before": result.cost(study, result.before),
            "after": result.cost(study, result.after),
            "after_at_half_dt": result.cost(study, result.finer),
        },
        "gains": {
            name: {"before": b, "after": a, "unit": f.unit}
            for name, b, a, f in zip(
                names, result.initial, result.gains, session.spec.free, strict=True
            )
        },
        "limits": [
            {**v.limit._asdict(), "value": v.value, "value_at_half_dt": v.finer, "holds": v.holds}
            | {"worst_drive": session.problem.label(v.drive, v.scenario), "price": v.price}
            for v in result.verdicts
        ],
        "metrics": {
            name: {"before": before._asdict(), "after": after._asdict()}
            for name, (before, after) in table.items()
        },
        "left_out": {session.problem.label(i): why for i, why in session.excluded.items()},
        "seconds": session.seconds,
        "dt": study.run.dt,
        "specification": describe(session.spec),
    }


_TABLE_HEAD = ["metric"] + [
    f"{when}_{what}"
    for when in ("before", "after")
    for what in ("nominal", "mean", "worst", "worst_drive")
]


def _flat(name: str, before: Line, after: Line) -> list[Any]:
    return [name, *before, *after]


def _drives(session: Session, result: Result) -> tuple[list[str], list[list[Any]]]:
    """One row per drive and scenario: parameters, and the objective's metrics before and after."""
    metrics, scenarios = session.problem.metrics, session.problem.scenarios
    head = ["drive", "scenario", *(s.name for s in session.spec.spreads)]
    head += [f"{m}_{when}" for m in metrics for when in ("before", "after")]
    rows = []
    for (k, index), (c, name) in product(enumerate(result.drives.tolist()), enumerate(scenarios)):
        numbers = [
            float(scores.values[m][k, c].max())
            for m in metrics
            for scores in (result.before, result.after)
        ]
        rows.append([index, name, *session.problem.drives[index].tolist(), *numbers])
    return head, rows


def _write_csv(path: Path, head: list[str], rows: Iterable[Iterable[Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)


def screen(session: Session, result: Result) -> list[Any]:
    """What is shown at the end: gains, metrics before and after."""
    return [_gains_table(session, result), _metrics_table(session, result)]


def _gains_table(session: Session, result: Result) -> Any:
    from rich.table import Table

    shown = Table(title="Gains", title_justify="left")
    shown.add_column("gain")
    for column in ("before", "after"):
        shown.add_column(column, justify="right")
    shown.add_column("bounds")
    rows = zip(session.spec.free, result.initial, result.gains, strict=True)
    for f, before, after in rows:
        bounds = f"{f.lower:g} to {f.upper:g} {f.unit}"
        at = " (at a bound)" if min(after - f.lower, f.upper - after) <= 1e-6 * abs(after) else ""
        shown.add_row(f.name, f"{before:.6g}", f"{after:.6g}", bounds + at)
    return shown


def _metrics_table(session: Session, result: Result) -> Any:
    from rich import box
    from rich.table import Table

    count = len(session.problem.scenarios)
    where = f" in {count} scenarios" if count > 1 else ""
    title = f"On {len(result.drives)} drives{where}; worst is the largest in size"
    shown = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown.add_column("metric", no_wrap=True)
    for when in ("before", "after"):
        for what in ("nominal", "mean", "worst"):
            shown.add_column(f"{when}\n{what}", justify="right", no_wrap=True)
    objective = session.problem.metrics
    for name, pair in lines(session, result).items():
        values = [v for line in pair for v in line[:3]]
        if np.isnan(values).all():
            continue  # this study has no such quantity
        style = "bold" if name in objective else None
        last = name == objective[-1]
        shown.add_row(name, *map(_number, values), style=style, end_section=last)
    return shown


def _number(value: float) -> str:
    """Three digits in at most eight characters."""
    if not np.isfinite(value):
        return "-" if np.isnan(value) else "never"
    if value == 0.0 or 1e-2 <= abs(value) < 1e4:
        return f"{value:.3f}" if abs(value) < 10.0 else f"{value:.4g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"
