"""What gearlash design-experiment leaves: tables, result.json, plots and report.html."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim.html import Picture, Section, Summary, Table, Text, words, write_html
from jaxsim.plots import COLOURS, figure, logarithmic
from jaxsim.provenance import provenance, write_json
from jaxsim.study import Study
from tuning.identification.design import Ranked
from tuning.identification.report import write_csv
from tuning.identification.residuals import Problem

_DRAWN = 3  # excitations
_METHOD = (
    "Each candidate is simulated at the study's own values. Expected standard errors are those of "
    "(sum of J^T J / noise^2)^-1 over its readings. The best one has the least largest error, as a "
    "share of the parameter's value (of half the width of its bounds for those of either sign).",
    "They hold for the drive as the study has it: measure, identify, and design again.",
)


class Designed(NamedTuple):
    """Candidates, best first; shown: how many are told. times: (n,) s. unit: of the command."""

    ranked: Sequence[Ranked]
    problem: Problem
    times: np.ndarray
    unit: str
    shown: int

    @property
    def names(self) -> tuple[str, ...]:
        return self.problem.unknowns.names

    @property
    def units(self) -> list[str]:
        unknowns = self.problem.unknowns
        return [words(unknowns.free[i].unit) for i in unknowns.of]


def sentences(d: Designed) -> list[str]:
    """The best excitation and what it would show; what keeps others from it."""
    best = d.ranked[0]
    if best.reason or not np.isfinite(best.worst):
        why = best.reason or "some unknown would not be seen"
        return [f"No candidate will do. The best is {best.candidate.name}: {why}."]
    least = d.names[int(np.argmax(best.deviation / _sizes(d)))]
    gap = "both walls are touched" if best.crosses else "NOT both walls are touched"
    told = [
        f"{best.candidate.name}: every parameter to {100.0 * best.worst:.2g} % or better, {least} "
        f"least well.",
        f"Peak joint torque {best.peak:.3g} Nm; {gap}.",
    ]
    out = sum(bool(r.reason) for r in d.ranked)
    if out:
        told.append(f"{out} of {len(d.ranked)} candidates break a limit or fail.")
    return told


def _sizes(d: Designed) -> np.ndarray:
    frees = [d.problem.unknowns.free[i] for i in d.problem.unknowns.of]
    half = np.array([0.5 * (f.upper - f.lower) for f in frees])
    signed = np.array([f.lower < 0.0 < f.upper for f in frees])
    return np.where(signed, half, np.abs(d.problem.initial()))


def write(study: Study, d: Designed, out: Path) -> None:
    """All files of the folder."""
    best, about = d.ranked[0], provenance(dtype="float64")
    command = zip(d.times, best.candidate.samples, strict=True)
    write_csv(out / "excitation.csv", ("time [s]", f"command [{d.unit}]"), command)
    head = (
        "excitation", "worst", *(f"error of {n}" for n in d.names), "crosses", "peak [Nm]", "why",
    )  # fmt: skip
    write_csv(out / "candidates.csv", head, [_row(r) for r in d.ranked])
    expected = dict(zip(d.names, np.asarray(best.deviation).tolist(), strict=True))
    content = {"words": sentences(d), "best": best.candidate.name, "expected_errors": expected}
    write_json(out / "result.json", content | {"crosses": best.crosses} | about)
    _draw_best(d, out / "best.png")
    _draw_ranking(d, out / "ranking.png")
    _page(study, d, out, about)


def _row(r: Ranked) -> tuple[Any, ...]:
    return (r.candidate.name, r.worst, *r.deviation, r.crosses, r.peak, r.reason)


def _page(study: Study, d: Designed, out: Path, about: dict[str, Any]) -> None:
    first, *rest = sentences(d)
    best = d.ranked[0]
    errors = Table(
        "Expected standard errors under the best excitation",
        ("parameter", "value", "error", "unit", "share [%]"),
        [
            (name, float(value), float(error), unit, float(100.0 * error / size))
            for name, value, error, unit, size in zip(
                d.names, d.problem.initial(), best.deviation, d.units, _sizes(d), strict=True
            )
        ],
    )
    head = ("excitation", "worst [%]", *d.names, "both walls", "peak [Nm]", "remark")
    table = [
        (r.candidate.name, 100.0 * r.worst, *r.deviation, r.crosses, r.peak, r.reason)
        for r in d.ranked[: d.shown]
    ]
    sections = [
        Section("The best", [Picture(_BEST, out / "best.png"), errors]),
        Section(
            "Against the others",
            [
                Picture(_RANKING, out / "ranking.png"),
                Table(f"Best {len(table)} of {len(d.ranked)}, with expected errors", head, table),
            ],
        ),
        Section("How it is judged", [Text(_METHOD)]),
    ]
    mood = "bad" if best.reason or not np.isfinite(best.worst) else "good"
    title = f"What to record of {study.name}"
    write_html(out / "report.html", title, Summary(first, rest, mood), sections, about)


_BEST = "The commands of the best excitations; excitation.csv has the first."
_RANKING = (
    "Expected error of every parameter, as a share of its size, under the best excitations; the "
    "rightmost point of a row is what ranks it."
)


def _draw_best(d: Designed, path: Path) -> None:
    drawn = d.ranked[:_DRAWN]
    size = (7.2, 1.5 * len(drawn) + 0.6)
    with figure(path, len(drawn), sharex=True, sharey=True, squeeze=False, size=size) as axes:
        for place, (ax, r) in enumerate(zip(axes[:, 0], drawn, strict=True), 1):
            ax.plot(d.times, r.candidate.samples, color=COLOURS["after"], linewidth=1.1)
            remark = f" ({r.reason})" if r.reason else ""
            ax.set_title(f"{place}. {r.candidate.name}{remark}", fontsize=9)
            ax.set_ylabel(f"command [{d.unit}]", fontsize=8)
        axes[-1, 0].set_xlabel("time [s]")


def _draw_ranking(d: Designed, path: Path) -> None:
    drawn = [r for r in d.ranked[: d.shown] if np.isfinite(r.worst)] or list(d.ranked[:1])
    sizes = _sizes(d)
    with figure(path, size=(7.2, 0.3 * len(drawn) + 1.5)) as ax:
        at = np.arange(len(drawn))
        for i, name in enumerate(d.names):
            share = [100.0 * r.deviation[i] / sizes[i] for r in drawn]
            ax.plot(share, at, "o", markersize=4.5, label=name)
        ax.set_yticks(at, [r.candidate.name for r in drawn])
        ax.invert_yaxis()
        ax.grid(axis="y", alpha=0.3)
        logarithmic(ax, "x")
        ax.set_xlabel("expected standard error [% of the parameter's size]")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
