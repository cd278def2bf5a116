"""What gearlash watch leaves: watch.csv, result.json, watch.png and report.html."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from jaxsim.html import Picture, Section, Summary, Table, Text, words, write_html
from jaxsim.plots import COLOURS, figure
from jaxsim.provenance import provenance, write_json
from jaxsim.study import Study
from tuning.identification.report import write_csv
from tuning.identification.watch import Trend, Watch

TRENDS = ("parameter", "unit", "first", "last", "per log", "+-", "chance", "limit", "alarm")
_METHOD = (
    "Every log is fitted by itself. The line is weighted by the errors of the logs, which are "
    "enlarged where the values scatter by more than they say; +- is the standard error of its "
    "slope, chance that of such a slope where nothing changes.",
    "Alarm: the whole interval of the last log lies above the limit; or the rise is sure and "
    "reaches the limit within as many logs as there were.",
)


def sentences(seen: Watch) -> list[str]:
    """The alarms first, or that there is none; then logs without a fit, and doubtful ones."""
    alarms = [t.alarm for t in seen.trends if t.alarm]
    watched = ", ".join(t.name for t in seen.trends if np.isfinite(t.limit))
    calm = f"No alarm in {len(seen.logs)} logs: {watched} within the limits"
    none = f"No alarm: no limits in [identify.watch], {len(seen.logs)} logs"
    found = [f"ALARM: {'; '.join(alarms)}." if alarms else f"{calm if watched else none}."]
    found += [f"{name}: no fit." for name in seen.failed]
    return [*found, *seen.doubts]


def rows(seen: Watch) -> list[tuple[Any, ...]]:
    """One line per unknown, as `TRENDS` names them; first and last of the logs with a fit."""
    return [
        (
            t.name, words(t.unit), *_ends(t), t.slope, t.slope_deviation, t.p,
            t.limit if np.isfinite(t.limit) else None, t.alarm or "none",
        )
        for t in seen.trends
    ]  # fmt: skip


def _ends(t: Trend) -> tuple[float | None, float | None]:
    good = t.values[np.isfinite(t.values)]
    return (float(good[0]), float(good[-1])) if good.size else (None, None)


def write(study: Study, seen: Watch, out: Path) -> None:
    """All files of the folder."""
    about = provenance(dtype="float64")
    head = ["log", *(f"{t.name}{more} [{t.unit}]" for t in seen.trends for more in ("", " error"))]
    values = [
        (log, *(v for t in seen.trends for v in (t.values[i], t.deviation[i])))
        for i, log in enumerate(seen.logs)
    ]
    write_csv(out / "watch.csv", head, values)
    told = sentences(seen)
    content = {"words": told, "logs": seen.logs, "failed": seen.failed, "doubts": seen.doubts}
    content["trends"] = [t._asdict() for t in seen.trends]
    write_json(out / "result.json", content | about)
    draw(seen, out / "watch.png")
    share = f"{100 * seen.confidence:g} %"
    picture = Picture(
        f"Each log with its {share} interval, the line through them, and the limit where there is "
        "one.",
        out / "watch.png",
    )
    sections = [
        Section("Trends", [picture, Table("What changes from log to log", TRENDS, rows(seen))]),
        Section("Logs", [Table("Value and standard error of every log", head, values)]),
        Section("How it is judged", [Text(_METHOD)]),
    ]
    bad = any(t.alarm for t in seen.trends)
    mood = "bad" if bad else ("plain" if seen.failed or seen.doubts else "good")
    title = f"Wear of {study.name}"
    write_html(out / "report.html", title, Summary(told[0], told[1:], mood), sections, about)


def draw(seen: Watch, path: Path) -> None:
    """One row per unknown: values with intervals, the line, the limit."""
    half = float(stats.norm.ppf(0.5 + 0.5 * seen.confidence))
    size = (7.2, 1.7 * len(seen.trends) + 1.1)
    with figure(path, len(seen.trends), sharex=True, squeeze=False, size=size) as axes:
        for ax, t in zip(axes[:, 0], seen.trends, strict=True):
            _trend(ax, t, half)
        axes[0, 0].set_title(f"Log by log, with {100 * seen.confidence:g} % intervals")
        axes[0, 0].figure.align_ylabels()
        long = max(map(len, seen.logs)) * len(seen.logs) > 70
        turned = {"rotation": 30, "ha": "right"} if long else {}
        axes[-1, 0].set_xticks(np.arange(len(seen.logs)), seen.logs, **turned)
        axes[-1, 0].set_xlim(-0.4, len(seen.logs) - 0.6)


def _trend(ax: Any, t: Trend, half: float) -> None:
    at = np.arange(len(t.values))
    good = np.isfinite(t.values) & np.isfinite(t.deviation)
    if np.isfinite(t.slope):
        weight = 1.0 / t.deviation[good] ** 2
        middle = np.average(at[good], weights=weight)
        mean = np.average(t.values[good], weights=weight)
        ax.plot(at, mean + t.slope * (at - middle), color="0.45", linewidth=1.0, label="line")
    look = {"fmt": "o", "markersize": 4, "capsize": 3, "color": COLOURS["after"]}
    ax.errorbar(at, t.values, half * t.deviation, label="log", **look)
    if np.isfinite(t.limit):
        ax.axhline(t.limit, color=COLOURS["limit"], linestyle="--", label="limit")
        ax.legend(loc="best")
    ax.ticklabel_format(axis="y", useOffset=False)
    name = f"{t.name}\n[{t.unit}]"
    ax.set_ylabel(name, color=COLOURS["limit"] if t.alarm else "black")
