"""report.html of an identification: the verdict first, then the evidence."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxsim.html import Picture, Section, Summary, Table, Text, write_html
from jaxsim.provenance import provenance
from jaxsim.study import Study
from tuning.identification.compare import Rival, sentence
from tuning.identification.report import HEAD, LOGS, exit_code, log_rows, rows, sentences
from tuning.identification.session import Outcome
from tuning.identification.spec import Spec

_BAND = 1.96  # standard deviations that hold 95 %
_METHOD = (
    "Intervals: a covariance in which every signal counts with the size and the colour of its own "
    "residuals; where residuals are coloured, at least the sandwich estimate. They hold if the "
    "model is right; what a wrong model shifts they cannot know: hence the held-out logs.",
    "Determined: the standard error is below 10 % of the parameter's size (of half the width of "
    "its bounds, for those of either sign). Combination: it would be with the others known. Not "
    "visible: not even then. Contradicted: the record speaks against the model where this unknown "
    "is concerned (logs or parts of them disagree by more than their errors, more is left of a "
    "signal than its noise, or the value lies on its bound); its interval does not hold.",
)


def write(
    study: Study, spec: Spec, outcome: Outcome, rivals: list[Rival],
    pictures: list[tuple[str, Path]], out: Path,
) -> None:  # fmt: skip
    """report.html, with the pictures embedded."""
    first, *rest = sentences(outcome) + ([sentence(rivals)] if rivals else [])
    known = all(outcome.verdicts[i].kind == "determined" for i in outcome.shown)
    shown = {path.name: Picture(caption, path) for caption, path in pictures}
    fits = [p for name, p in shown.items() if name.startswith("fit_")]
    others = [p for name, p in shown.items() if name.startswith(("profile_", "logs_"))]
    confidence = f"{100 * spec.search.confidence:g} %"
    sections = [
        Section(
            "Parameters",
            [Table(f"Estimates with {confidence} intervals", HEAD, rows(outcome)), Text(_METHOD)],
        ),
        Section("Logs", [_logs(outcome), *fits]),
        Section("What is left", [_whiteness(outcome), shown["residuals.png"], _parts(outcome)]),
        Section("How sure", [*_sure(outcome, confidence), *others]),
        Section("The search", [_search(outcome)]),
    ]
    if rivals:
        sections.insert(2, Section("Other structures", [_rivals(outcome, rivals)]))
    about = provenance(seed=spec.search.seed, dtype="float64")
    wrong = exit_code(outcome) == 1
    mood = "bad" if wrong else ("good" if known else "plain")
    title = f"Identification of {study.name}"
    write_html(out / "report.html", title, Summary(first, rest, mood), sections, about)


def _logs(outcome: Outcome) -> Table:
    caption = (
        "Rms of model - reading with the study's own values (before) and with those found (after). "
        "Contact: share of the run against each wall of the play."
    )
    return Table(caption, LOGS, log_rows(outcome))


def _whiteness(outcome: Outcome) -> Table:
    """Size, coverage and colour of what is left; held-out logs have no test of colour."""
    table = []
    place = {int(e): k for k, e in enumerate(outcome.train)}
    for e, s in np.ndindex(outcome.error.shape):
        r = outcome.evaluation.residuals[0, e, s][outcome.problem.readings.used[e, s]]
        w = outcome.seen.whiteness[place[e]][s] if e in place else None
        table.append(
            (
                outcome.recorded[e].experiment.name,
                outcome.problem.signals[s],
                float(np.sqrt(np.mean(r * r))),
                float(100.0 * np.mean(np.abs(r) <= _BAND)),
                w.p if w else None,
                w.inflation if w else None,
                r.size,
            )
        )
    head = (
        "log", "signal", "rms / noise", "within 1.96 noise [%]", "p (Ljung-Box)",
        "readings per information", "readings",
    )  # fmt: skip
    caption = (
        "Residuals. White ones of the assumed noise lie within 1.96 of it 95 % of the time; "
        "held-out logs are not tested for colour."
    )
    return Table(caption, head, table)


def _parts(outcome: Outcome) -> Table:
    head = ("parameter", "chance of this", "spread", "furthest part", "it alone would say")
    caption = (
        "Every log in thirds, signal by signal: do the parts agree? Spread: their weighted rms "
        "distance from the fit. A small chance means that the model leaves something out."
    )
    return Table(caption, head, outcome.parts)


def _sure(outcome: Outcome, confidence: str) -> list[Table]:
    tables = []
    if outcome.profiles:
        table = [(p.name, *p.interval) for p in outcome.profiles]
        tables.append(
            Table(f"Profile likelihood, {confidence}", ("parameter", "low", "high"), table)
        )
    if len(outcome.bootstrap):
        low, high = np.quantile(outcome.bootstrap, [0.025, 0.975], axis=0)
        table = [(outcome.names[i], low[i], high[i]) for i in outcome.shown]
        caption = f"Bootstrap over the logs, {len(outcome.bootstrap)} samples, 95 %"
        tables.append(Table(caption, ("parameter", "low", "high"), table))
    shown = outcome.shown
    d = outcome.seen.deviation
    correlation = outcome.seen.matrix / np.maximum(d[:, None] * d[None, :], 1e-300)
    if len(shown) <= 12:
        names = [outcome.names[i] for i in shown]
        table = [(outcome.names[i], *(float(correlation[i, j]) for j in shown)) for i in shown]
        tables.append(Table("Correlation of the errors", ("", *names), table))
    return tables


def _search(outcome: Outcome) -> Table:
    fits = outcome.fits
    order = np.argsort(fits.loss)
    table = [
        (int(i), float(fits.loss[i]), bool(fits.converged[i]), int(fits.iterations[i]))
        for i in order
    ]
    caption = (
        "Starts, best first; start 0 is the study itself, start 1 a regression of the readings "
        "where they allow one, the others a Latin hypercube"
    )
    return Table(caption, ("start", "loss", "converged", "iterations"), table)


def _rivals(outcome: Outcome, rivals: list[Rival]) -> Table:
    head = (
        "structure",
        "unknowns",
        "loss, fitted",
        "loss, held out",
        "behind",
        "preferred",
        "remark",
    )
    table = [(r.name, r.unknowns, r.train, r.test, r.behind, r.preferred, r.remark) for r in rivals]
    caption = (
        "Structures fitted to the same logs. Loss: half the mean square of residuals per reading, "
        "in the noise of this study's own. Behind: standard errors above the lowest on held-out "
        "logs. Preferred: the fewest unknowns among those that are not surely above it."
    )
    return Table(caption, head, table)
