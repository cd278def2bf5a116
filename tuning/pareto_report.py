"""A front in files: its laws, a table, a plot and one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxsim import plots
from jaxsim.components import dump
from jaxsim.html import Picture, Section, Summary, Table, write_html
from jaxsim.metric import unit_of
from jaxsim.objective import Goal
from jaxsim.provenance import provenance, write_json, write_toml
from jaxsim.study import Study
from tuning import space
from tuning.front import Front, Point
from tuning.pareto import WIDE
from tuning.report import write_csv
from tuning.spec import Spec, describe

# A law beats a marked one if it is better by this share; rounding is no news.
_TELLING = 1e-3
_STYLES = {"study": ("s", "#7F7F7F"), "tuned": ("*", "#D55E00")}


def write(study: Study, spec: Spec, front: Front, out: Path) -> tuple[str, ...]:
    """front.csv, front.json, laws/, and where there is a front pareto.png; report.html."""
    out.mkdir(parents=True, exist_ok=True)
    about = provenance(seed=spec.seed, dtype=study.run.dtype)
    head, rows = _rows(spec, front)
    write_csv(out / "front.csv", head, rows)
    write_json(out / "front.json", _content(study, spec, front) | about)
    files = ["front.csv", "front.json"]
    for k, point in enumerate(front.points):
        law = space.with_gains(study.law, spec.free, point.gains)
        words = f"Point {k} of the front of {study.name}: " + _told(front, point)
        write_toml(out / "laws" / f"{k:02d}.toml", {"law": dump(law), "provenance": about}, words)
    if front.points:
        draw(spec, front, out / "pareto.png")
        files += ["laws", "pareto.png"]
    _page(study, spec, front, out, about)
    return (*files, "report.html")


def sentences(spec: Spec, front: Front) -> list[str]:
    """What was found, and how the marked laws compare."""
    ended = " The search was interrupted." if front.interrupted else ""
    count = len(front.drives)
    if not front.points:
        return [f"NO LAW that keeps the study's limits on all {count} drives was found.{ended}"]
    lines = [
        f"{len(front.points)} laws on the front, each keeping the study's limits on {count} "
        f"drive{'s' if count > 1 else ''} by fresh runs of the exact model.{ended}"
    ]
    ends = ((front.pair[1].metric, front.points[0]), (front.pair[0].metric, front.points[-1]))
    lines += [f"Least {metric}: {_told(front, point)}" for metric, point in ends]
    lines += [_compared(front, name, mark) for name, mark in front.marks.items()]
    return lines + [f"Left out, drive {i}: {why}." for i, why in front.left_out.items()]


def _told(front: Front, point: Point) -> str:
    pairs = zip(front.pair, point.goals, strict=True)
    told = [f"{g.metric} ({g.over}) = {v:.4g} {unit_of(g.metric)}".rstrip() for g, v in pairs]
    return ", ".join(told) + "."


def _compared(front: Front, name: str, mark: Point) -> str:
    """A marked law against the points that beat it in both goals."""
    told = f"The {name} law: {_told(front, mark)}"
    kept = "" if mark.feasible else " It exceeds a limit of the study."
    goals = np.array(mark.goals)
    better = [p for p in front.points if np.all(p.goals < goals - _TELLING * np.abs(goals))]
    if not better:
        return f"{told} No point of the front beats it in both goals.{kept}"
    best = min(better, key=lambda p: p.goals[0])
    change = (
        f"{100.0 * (b / m - 1.0):+.1f} % {g.metric}"
        for g, b, m in zip(front.pair, best.goals, mark.goals, strict=True)
        if m
    )
    return f"{told} One that beats it in both has {' and '.join(change)}.{kept}"


def _rows(spec: Spec, front: Front) -> tuple[list[str], list[list[Any]]]:
    """Points and marks: goals, gains, and the worst value of each limited metric."""
    limits = list(dict.fromkeys(x.metric for x in spec.objective.limits))
    head = ["law", *(f"{g.metric}_{g.over}" for g in front.pair), *(f.name for f in spec.free)]

    def worst(p: Point) -> list[float]:
        return [p.scores.worst(m, spec.objective)[0] for m in limits]

    named = {str(k): p for k, p in enumerate(front.points)} | front.marks
    rows = [[name, *p.goals, *p.gains.tolist(), *worst(p), p.feasible] for name, p in named.items()]
    return [*head, *(f"{m}_worst" for m in limits), "limits_hold"], rows


def _content(study: Study, spec: Spec, front: Front) -> dict[str, Any]:
    def point(p: Point) -> dict[str, Any]:
        gains = dict(zip((f.name for f in spec.free), p.gains.tolist(), strict=True))
        return {"goals": p.goals, "gains": gains, "limits_hold": p.feasible}

    return {
        "study": study.name,
        "between": [g._asdict() for g in front.pair],
        "words": sentences(spec, front),
        "points": [point(p) for p in front.points],
        "marks": {name: point(p) for name, p in front.marks.items()},
        "drives": front.drives,
        "left_out": front.left_out,
        "interrupted": front.interrupted,
        "dt": study.run.dt,
        "specification": describe(spec),
    }


def table(spec: Spec, front: Front) -> Any:
    """Points and marks for the screen."""
    from rich.table import Table as Shown

    shown = Shown(title="The front, by fresh runs of the exact model", title_justify="left")
    head, rows = _rows(spec, front)
    kept = 3 + len(spec.free)
    for k, name in enumerate(head[:kept]):
        shown.add_column(name, justify="left" if k == 0 else "right")
    for row in rows:
        shown.add_row(row[0], *(f"{v:.5g}" for v in row[1:kept]))
    return shown


def draw(spec: Spec, front: Front, path: Path) -> None:
    """The front with the marked laws, and the gains along it within their bounds."""
    first, second = front.pair
    goals = np.array([p.goals for p in front.points])
    with plots.figure(path, 1, 2, size=(10.4, 4.0)) as (left, right):
        left.plot(goals[:, 1], goals[:, 0], "o-", color=plots.COLOURS["after"], ms=4, label="front")
        for name, mark in front.marks.items():
            marker, colour = _STYLES[name]
            face = colour if mark.feasible else "white"
            what = f"{name} law" + ("" if mark.feasible else " (exceeds a limit)")
            at = mark.goals[::-1]
            left.plot(*at, marker, color=colour, mfc=face, ms=8, ls="none", label=what)
        for x in spec.objective.limits:
            line = {second.metric: left.axvline, first.metric: left.axhline}.get(x.metric)
            if line is not None:
                line(x.bound, color=plots.COLOURS["limit"], ls="--", lw=1.0, label="limit")
        left.set_xlabel(_axis(second))
        left.set_ylabel(_axis(first))
        _scale_axes(left, goals)
        left.legend()
        places = np.array([space.to_unit(spec.free, p.gains) for p in front.points])
        for k, f in enumerate(spec.free):
            right.plot(goals[:, 1], places[:, k], "o-", ms=3, label=_range(f))
        right.set_xlabel(_axis(second))
        right.set_ylabel("place between its bounds")
        if left.get_xscale() == "log":
            plots.logarithmic(right, "x")
        right.set_ylim(-0.03, 1.03)
        right.set_title("gains along the front")
        right.legend(fontsize=7.5)


def _scale_axes(ax: Any, goals: np.ndarray) -> None:
    """A goal that spans more than a decade along the front gets a logarithmic axis."""
    for k, axis in ((1, "x"), (0, "y")):
        low, high = float(goals[:, k].min()), float(goals[:, k].max())
        if low > 0.0 and high > WIDE * low:
            plots.logarithmic(ax, axis)
        else:
            ax.ticklabel_format(axis=axis, scilimits=(-3, 4))


def _axis(goal: Goal) -> str:
    over = goal.over if isinstance(goal.over, str) else f"{100.0 * goal.over:g} % quantile"
    return f"{goal.metric}, {over}"


def _range(f: Any) -> str:
    return f"{f.name}: {f.lower:g} to {f.upper:g} {f.unit}{', log' if f.log else ''}"


def sections(spec: Spec, front: Front, out: Path) -> list[Section]:
    """What a page says of a front, from the plot in its folder."""
    head, rows = _rows(spec, front)
    caption = (
        "Laws that none beats in both goals; open marks exceed a limit of the study. Right: where "
        "each gain stands between its bounds."
    )
    picture = [Picture(caption, out / "pareto.png")] if front.points else []
    first, second = (g.metric for g in front.pair)
    return [
        Section(f"Front between {first} and {second}", picture),
        Section("Laws along the front", [Table("Goals, gains, limited metrics.", head, rows)]),
    ]


def _page(study: Study, spec: Spec, front: Front, out: Path, about: dict[str, Any]) -> None:
    first, *rest = sentences(spec, front)
    between = " and ".join(g.metric for g in front.pair)
    title = f"{study.name}: front between {between}"
    summary = Summary(first, rest, "good" if front.points else "bad")
    write_html(out / "report.html", title, summary, sections(spec, front, out), about)
