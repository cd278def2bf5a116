"""What `gearlash certify` leaves: certificate.json, a picture, one page."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from jaxsim import tree
from jaxsim._certify import NORM, OWN, STEPS, Row
from jaxsim.html import Picture, Section, Summary, Table, Text, words, write_html
from jaxsim.plots import CYCLE, figure
from jaxsim.provenance import provenance, write_json
from jaxsim.study import Study

FILES = ("certificate.json", "certificate.png", "report.html")
_MEANING = (
    "Right: the gradient agrees with central differences of the located run for two neighbouring "
    "steps, within 1 % of its size or 1e-4 of the scaled gradient, and forward mode with reverse. "
    "Zero: the metric depends on none of these parameters. Jumps: the metric itself is "
    "discontinuous here. Wrong: none of these."
)
_LEAST = 1e-9  # errors below this share of what is allowed are drawn there


def write(out: Path, study: Study, rows: list[Row]) -> None:
    """All of `FILES`."""
    about = provenance(dtype=study.run.dtype)
    content = {"study": study.name, "rows": [row._asdict() for row in rows]}
    write_json(out / "certificate.json", content | about)
    _draw(out / "certificate.png", rows)
    caption = (
        "Error of each gradient against the difference over a step, as a share of what is allowed: "
        "large steps cut off, small ones drown in rounding; right is what stays below the line in "
        "between."
    )
    sections = [
        Section("Gradients", [Text([_MEANING]), *(_table(rows, m) for m in _metrics(rows))]),
        Section("Steps of the differences", [Picture(caption, out / "certificate.png")]),
    ]
    write_html(out / "report.html", f"Gradients of {study.name}", summary(rows), sections, about)


def summary(rows: list[Row]) -> Summary:
    """How many are right, and which are not."""
    counts = Counter(row.verdict for row in rows)
    bad, jumps = _those(rows, "wrong"), _those(rows, "jumps")
    good = counts["right"] + counts["zero"]
    if bad:
        told = f"{counts['wrong']} of {len(rows)} gradients are wrong."
        return Summary(told, (*bad, *jumps), "bad")
    if jumps:
        told = f"{good} of {len(rows)} gradients are right; the other metrics jump."
        return Summary(told, jumps, "plain")
    return Summary(f"All {len(rows)} gradients are right.", (), "good")


def _those(rows: list[Row], verdict: str) -> list[str]:
    """The parameters with a verdict, metric by metric, in words."""
    names = short(rows)
    every = {
        m: [names[r.parameter] for r in rows if (r.metric, r.verdict) == (m, verdict)]
        for m in _metrics(rows)
    }
    what = {"wrong": "is wrong for", "jumps": "jumps with"}[verdict]
    return [f"{m} {what} {', '.join(own)}." for m, own in every.items() if own]


def short(rows: list[Row]) -> dict[str, str]:
    """The shortest name of each parameter, by its path."""
    paths = list(dict.fromkeys(row.parameter for row in rows))
    return dict(zip(paths, tree.shortest(paths), strict=True))


def _metrics(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(row.metric for row in rows))


def _table(rows: list[Row], metric: str) -> Table:
    own = [r for r in rows if r.metric == metric]
    names = short(rows)
    cells = [
        [names[r.parameter], r.value, words(r.unit), r.forward, r.forward - r.reverse,
         *r.differences[1:3], r.verdict]
        for r in own
    ]  # fmt: skip
    head = ["parameter p", "p", "unit", "d/dp, forward", "less reverse"]
    head += [f"difference, {h:g} p" for h in STEPS[1:3]]
    return Table(f"d {metric}/dp, SI.", [*head, "verdict"], cells)


def _draw(path: Path, rows: list[Row]) -> None:
    """Per metric: error over step, over what is allowed."""
    metrics = [r.metric for r in rows if r.forward != 0.0 or any(r.differences)]
    metrics = list(dict.fromkeys(metrics)) or _metrics(rows)
    names = short(rows)
    size = (8.0, 2.4 * len(metrics) + 0.6)
    with figure(path, len(metrics), sharex=True, squeeze=False, size=size) as axes:
        for ax, metric in zip(axes[:, 0], metrics, strict=True):
            own = [r for r in rows if r.metric == metric]
            norm = float(np.linalg.norm([r.scale * r.forward for r in own]))
            for k, r in enumerate(own):
                allowed = max(OWN * abs(r.scale * r.forward), NORM * norm, 1e-300)
                errors = r.scale * np.abs(np.asarray(r.differences) - r.forward) / allowed
                look = ("o-", "s--", "^:")[k // len(CYCLE) % 3]  # the colours begin anew
                shown = np.maximum(errors, _LEAST)
                ax.plot(STEPS, shown, look, markersize=3, label=names[r.parameter])
            ax.axhline(1.0, color="0.3", linestyle="--", linewidth=1.0)
            ax.set(xscale="log", yscale="log")
            ax.set_xticks(STEPS, [f"{h:g}" for h in STEPS], minor=False)
            ax.minorticks_off()
            ax.set_title(metric)
            ax.set_ylabel("error / allowed")
        axes[0, 0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        axes[-1, 0].set_xlabel("step, share of the parameter")
