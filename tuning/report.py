"""Results of a tuning run: the files in its folder that people and programs read."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim._certify import STEPS
from jaxsim.components import dump
from jaxsim.provenance import provenance, write_json, write_toml
from tuning.certificate import Case
from tuning.result import Result
from tuning.scoring import Scores
from tuning.session import Session
from tuning.spec import describe
from tuning.words import sentences


class Line(NamedTuple):
    """One metric under one law: as the study is, mean over drives and scenarios, worst case.

    nominal: on the study's drive in its first scenario. worst: as `Scores.worst` has it; drive:
    that has it, with its scenario.
    """

    nominal: float
    mean: float
    worst: float
    drive: str


# What `write` leaves in the folder, next to the plots and report.html.
FILES = (
    "law.toml",
    "result.json",
    "table.csv",
    "drives.csv",
    "history.csv",
    "certificate.csv",
    "sensitivity.csv",
)


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
    objective = session.spec.objective
    worst, row, scenario = scores.worst(name, objective)
    values = scores.values[name]
    mean = float(np.mean(values)) if np.isfinite(values).all() else np.nan
    nominal = scores.of_case(name, 0, 0, objective) if result.drives[0] == 0 else np.nan
    return Line(nominal, mean, worst, session.problem.label(int(result.drives[row]), scenario))


def write(session: Session, result: Result, out: Path) -> None:
    """Each of `FILES`, replaced as a whole."""
    out.mkdir(parents=True, exist_ok=True)
    table = lines(session, result)
    about = provenance(seed=session.spec.seed, dtype=session.study.run.dtype)
    words = sentences(session, result)
    head = "\n".join([f"Tuned for {session.study.name}. {words[0]}", *words[1:]])
    write_toml(out / "law.toml", {"law": dump(result.law), "provenance": about}, head)
    write_json(out / "result.json", _content(session, result, table, words) | about)
    write_csv(out / "table.csv", _TABLE_HEAD, (_flat(name, *pair) for name, pair in table.items()))
    write_csv(out / "drives.csv", *_drives(session, result))
    history = session.history
    write_csv(out / "history.csv", list(history[0]), (row.values() for row in history))
    write_csv(out / "certificate.csv", *certificate_table(session, result))
    write_csv(out / "sensitivity.csv", *sensitivity_table(session, result))


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
            "before": result.before.cost(session.spec.objective),
            "after": result.after.cost(session.spec.objective),
            "after_at_half_dt": result.finer.cost(session.spec.objective),
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
        "attained": [a._asdict() | a.limit._asdict() for a in result.attained],
        "fresh_drives": None if result.check is None else result.check._asdict(),
        "metrics": {
            name: {"before": before._asdict(), "after": after._asdict()}
            for name, (before, after) in table.items()
        },
        "certificate": {
            "verdicts": result.certificate.counts,
            "steps": STEPS,
            "components": [
                c._asdict() | {"case": _named(session, c.case)}
                for c in result.certificate.components
            ],
        },
        "sensitivities": [
            x._asdict() | {"case": _named(session, x.case)}
            for x in result.certificate.sensitivities
        ],
        "left_out": {session.problem.label(i): why for i, why in session.excluded.items()},
        "seconds": session.seconds,
        "dt": study.run.dt,
        "specification": describe(session.spec),
    }


def _named(session: Session, case: Case) -> dict[str, Any]:
    problem = session.problem
    values = zip((s.name for s in session.spec.spreads), problem.drives[case.drive], strict=True)
    return {
        "drive": case.drive,
        "scenario": problem.scenarios[case.scenario],
        "parameters": dict(values),
    }


def certificate_table(session: Session, result: Result) -> tuple[list[str], list[list[Any]]]:
    """One row per case, metric and gain: gradient of the search, differences, verdict; SI."""
    label = session.problem.label
    head = ["case", "metric", "gain", "gradient", *(f"difference_{h:g}" for h in STEPS)]
    rows = [
        [label(*c.case), c.metric, c.gain, c.gradient, *c.differences, c.error, c.verdict]
        for c in result.certificate.components
    ]
    return [*head, "scaled_error", "verdict"], rows


def sensitivity_table(session: Session, result: Result) -> tuple[list[str], list[list[Any]]]:
    """One row per case and metric: per cent of the metric per per cent of each gain."""
    told: dict[tuple[Case, str], list[float]] = {}
    for x in result.certificate.sensitivities:
        told.setdefault((x.case, x.metric), []).append(x.share)
    rows = [
        [session.problem.label(*case), metric, *shares]
        for (case, metric), shares in told.items()
        if not np.isnan(shares).all()
    ]
    return ["case", "metric", *(f.name for f in session.spec.free)], rows


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
            scores.of_case(m, k, c, session.spec.objective)
            for m in metrics
            for scores in (result.before, result.after)
        ]
        rows.append([index, name, *session.problem.drives[index].tolist(), *numbers])
    return head, rows


def write_csv(path: Path, head: list[str], rows: Iterable[Iterable[Any]]) -> None:
    """A table for people's spreadsheets."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)
