"""What an identification leaves in its folder for people and programs: TOML, JSON, CSV, words."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.components import dump
from jaxsim.provenance import provenance, write_json, write_toml
from jaxsim.study import Study
from tuning.identification.compare import Rival, sentence
from tuning.identification.session import Outcome
from tuning.identification.spec import Spec

FILES = ("drive.toml", "result.json", "parameters.csv", "experiments.csv", "residuals.csv")
HEAD = ("parameter", "value", "low", "high", "unit", "start", "verdict", "why", "what would help")
LOGS = (
    "log", "use", "signal", "unit", "rms before", "rms after", "mean abs after",
    "of the readings [%]", "readings", "masked", "white", "contact",
)  # fmt: skip
_MOST_TOLD = 8  # held-out logs and signals that are told in words


def rows(outcome: Outcome) -> list[tuple[Any, ...]]:
    """One line per unknown, as `HEAD` names them."""
    return [
        (
            outcome.names[i],
            float(outcome.values[i]),
            float(outcome.interval[i, 0]),
            float(outcome.interval[i, 1]),
            outcome.unit(i),
            float(outcome.initial[i]),
            outcome.verdicts[i].kind,
            outcome.verdicts[i].why,
            outcome.verdicts[i].advice,
        )
        for i in outcome.shown
    ]


def log_rows(outcome: Outcome) -> list[tuple[Any, ...]]:
    """One line per experiment and signal, as `LOGS` names them."""
    from jaxsim.loop import UNITS

    lines = []
    place = {int(e): k for k, e in enumerate(outcome.train)}
    for e, recorded in enumerate(outcome.recorded):
        plus, minus = outcome.evaluation.contact[0, e]
        touched = f"+ {100 * plus:.0f} %, - {100 * minus:.0f} %"
        use = "fitted" if e in place else ("held out" if recorded.use == "test" else "left out")
        for s, signal in enumerate(outcome.problem.signals):
            unit = UNITS[signal.partition("[")[0]]
            white = outcome.seen.whiteness[place[e]][s].white if e in place else None
            used = recorded.experiment.measurements[s].used
            errors = (
                float(outcome.before[e, s]),
                float(outcome.error[e, s]),
                float(_absolute(outcome, np.array([e]), s)),
                _relative(outcome, e, s),
            )
            counts = int(used.sum()), int((~used).sum())
            lines.append(
                (recorded.experiment.name, use, signal, unit, *errors, *counts, white, touched)
            )
    return lines


def _absolute(outcome: Outcome, logs: np.ndarray, s: int) -> float:
    """Mean |model - reading| of one signal over all used readings of some logs."""
    noise = outcome.problem.readings.noise[logs, s]
    left = np.abs(outcome.evaluation.residuals[0, logs, s]).sum(axis=-1)
    return float((noise * left).sum() / max(outcome.problem.readings.used[logs, s].sum(), 1))


def _relative(outcome: Outcome, e: int, s: int) -> float:
    """norm(model - readings)/norm(readings) of one signal of one log, %."""
    used = outcome.problem.readings.used[e, s]
    size = np.sqrt(np.mean(outcome.problem.readings.values[e, s][used] ** 2))
    return float(100.0 * outcome.error[e, s] / size) if size > 0.0 else float("nan")


def sentences(outcome: Outcome) -> list[str]:
    """The result in words, the most important first."""
    kinds = [outcome.verdicts[i].kind for i in outcome.shown]
    known, wrong = kinds.count("determined"), kinds.count("contradicted")
    logs = f"{len(outcome.train)} log{'s' if len(outcome.train) > 1 else ''}"
    first = f"{known} of {len(kinds)} parameters are determined by {logs}"
    if outcome.test.size:
        first += f"; {outcome.test.size} more were held out"
    if wrong:
        first += f". {wrong} CONTRADICTED: the record itself speaks against the model"
    words = [first + ".", *outcome.doubts]
    words += _held_out(outcome)
    if outcome.interrupted:
        words.append("The search was interrupted: this is the best there was.")
    return [*words, *_undetermined(outcome), *_remarks(outcome)]


def _undetermined(outcome: Outcome) -> list[str]:
    """The unknowns that are not determined; those that are contradicted alike in one sentence."""
    alike: dict[str, list[str]] = {}
    words = []
    for v in (outcome.verdicts[i] for i in outcome.shown):
        if v.kind == "contradicted":
            alike.setdefault(v.why, []).append(v.name)
        elif v.kind != "determined":
            words.append(f"{v.name} ({v.kind}): {v.why}. To see it: {v.advice}.")
    return [f"{', '.join(names)} (contradicted): {why}." for why, names in alike.items()] + words


def exit_code(outcome: Outcome, rivals: Sequence[Rival] = ()) -> int:
    """0: all is determined. 1: the record speaks against the model. 3: a part of it was found."""
    kinds = {outcome.verdicts[i].kind for i in outcome.shown}
    if outcome.doubts or "contradicted" in kinds:
        return 1
    left_out = sum(r.use == "fit" for r in outcome.recorded) > len(outcome.train)
    return 3 if kinds != {"determined"} or left_out or any(r.remark for r in rivals) else 0


def _held_out(outcome: Outcome) -> list[str]:
    """How well the held-out logs are predicted: each, or all together where they are many."""
    from jaxsim.loop import UNITS

    if outcome.test.size * len(outcome.problem.signals) <= _MOST_TOLD:
        return [
            f"Held out, {log}: {signal} {after:.4g} {unit} rms, {share:.4g} % of the readings."
            for log, use, signal, unit, _, after, _, share, *_ in log_rows(outcome)
            if use == "held out"
        ]
    words = []
    for s, signal in enumerate(outcome.problem.signals):
        unit = UNITS[signal.partition("[")[0]]
        for what, logs in (("Fitted", outcome.train), ("Held out", outcome.test)):
            used = outcome.problem.readings.used[logs, s]
            rms = np.sqrt(np.sum(outcome.error[logs, s] ** 2 * used.sum(axis=-1)) / used.sum())
            words.append(
                f"{what}, {logs.size} logs: {signal} {_absolute(outcome, logs, s):.4g} {unit} mean "
                f"absolute error, {rms:.4g} {unit} rms."
            )
    return words


def _remarks(outcome: Outcome) -> list[str]:
    """What was noticed; where it was noticed of many logs, an example and where the rest is."""
    if len(outcome.remarks) <= _MOST_TOLD:
        return list(outcome.remarks)
    noticed = [words for r in outcome.recorded for words in r.remarks]
    rest = [words for words in outcome.remarks if words not in set(noticed)]
    masked = sum(int((~m.used).sum()) for r in outcome.recorded for m in r.experiment.measurements)
    told = f"{len(noticed)} remarks on the logs, {masked} readings masked: see experiments.csv"
    return [*rest, f"{told}. The first: {noticed[0]}"] if noticed else rest


def write(study: Study, spec: Spec, outcome: Outcome, rivals: Sequence[Rival], out: Path) -> None:
    """Each of `FILES`, replaced as a whole; law.toml where gains were identified, too."""
    about = provenance(seed=spec.search.seed, dtype="float64")
    words = sentences(outcome) + ([sentence(rivals)] if rivals else [])
    head = "\n".join([f"Identified for {study.name}. {words[0]}", *words[1:], "", *_lines(outcome)])
    tables = {"identified": _identified(outcome, spec), "provenance": about}
    write_toml(out / "drive.toml", {"drive": dump(outcome.drive(study)), **tables}, head)
    if any(p.startswith("law.") for f in outcome.problem.unknowns.free for p in f.paths):
        write_toml(out / "law.toml", {"law": dump(outcome.law(study)), **tables}, head)
    content = _content(study, spec, outcome, words)
    content["structures"] = [r._asdict() for r in rivals]
    write_json(out / "result.json", content | about)
    write_csv(out / "parameters.csv", HEAD, rows(outcome))
    write_csv(out / "experiments.csv", LOGS, log_rows(outcome))
    write_csv(out / "residuals.csv", *_residuals(outcome))


def _lines(outcome: Outcome) -> list[str]:
    return [
        f"{name} = {value:.6g} {unit}  [{low:.6g}, {high:.6g}]  {kind}"
        for name, value, low, high, unit, _, kind, _, _ in rows(outcome)
    ]


def _identified(outcome: Outcome, spec: Spec) -> dict[str, Any]:
    """The table of intervals in drive.toml: name -> value, interval, unit, verdict."""
    return {
        name: {
            "value": value,
            f"interval_{100 * spec.search.confidence:g}": [low, high],
            "unit": unit,
            "verdict": kind,
        }
        for name, value, low, high, unit, _, kind, _, _ in rows(outcome)
    }


def _content(study: Study, spec: Spec, outcome: Outcome, words: list[str]) -> dict[str, Any]:
    shown = outcome.shown
    seen = outcome.seen
    return {
        "study": study.name,
        "words": words,
        "parameters": [dict(zip(HEAD, row, strict=True)) for row in rows(outcome)],
        "covariance": seen.matrix[np.ix_(shown, shown)],
        "covariance_of_white_residuals": seen.naive[np.ix_(shown, shown)],
        "experiments": [dict(zip(LOGS, row, strict=True)) for row in log_rows(outcome)],
        "noise": dict(zip(outcome.problem.signals, outcome.problem.readings.noise[0], strict=True)),
        "whiteness": [[w._asdict() for w in own] for own in seen.whiteness],
        "starts": [
            {"loss": loss, "converged": bool(done), "iterations": int(count)}
            for loss, done, count in zip(
                outcome.fits.loss, outcome.fits.converged, outcome.fits.iterations, strict=True
            )
        ],
        "profiles": [p._asdict() for p in outcome.profiles],
        "bootstrap": {
            "samples": len(outcome.bootstrap),
            "quantiles": _quantiles(outcome, spec.search.confidence),
        },
        "doubts": outcome.doubts,
        "logs_alone": [a._asdict() for a in outcome.alone],
        "parts": [p._asdict() for p in outcome.parts],
        "dt": outcome.problem.dt,
        "interrupted": outcome.interrupted,
    }


def _quantiles(outcome: Outcome, confidence: float) -> dict[str, list[float]]:
    if not len(outcome.bootstrap):
        return {}
    tails = 0.5 * (1.0 - confidence), 0.5 * (1.0 + confidence)
    return {
        outcome.names[i]: [float(np.quantile(outcome.bootstrap[:, i], q)) for q in tails]
        for i in outcome.shown
    }


def readings(outcome: Outcome, e: int, s: int) -> tuple[np.ndarray, ...]:
    """Times, readings, what the model gives, and which are used, of one signal of one log."""
    m = outcome.problem.experiments[e].measurements[s]
    count = len(m.times)
    left = outcome.evaluation.residuals[0, e, s, :count] * outcome.problem.readings.noise[e, s]
    model = np.where(m.used, m.values + left, np.nan)
    return m.times, np.where(m.used, m.values, np.nan), model, m.used


def _residuals(outcome: Outcome) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    table = []
    for e, recorded in enumerate(outcome.recorded):
        for s, signal in enumerate(outcome.problem.signals):
            for t, value, model, used in zip(*readings(outcome, e, s), strict=True):
                if used:
                    table.append((recorded.experiment.name, signal, t, value, model))
    return ("log", "signal", "time [s]", "reading", "model"), table


def write_csv(path: Path, head: Any, table: Any) -> None:
    """Rows below a head, written beside and renamed."""
    beside = path.with_name(path.name + ".part")
    with beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(table)
    beside.replace(path)
