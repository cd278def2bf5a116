"""Results as one picture: throughput by batch, and the peers.

python benchmarks/chart.py FOLDER PICTURE
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from jaxsim import plots

LINES = {
    "C float64, 2 thread(s)": ("C, 2 threads, no events", plots.CYCLE[-1], "--"),
    "C float64, 1 thread(s)": ("C, 1 thread, no events", plots.CYCLE[-1], ":"),
    "plain float64": ("gearlash plain", plots.CYCLE[0], "-"),
    "exact float64": ("gearlash exact", plots.CYCLE[2], "-"),
    "smoothed float64": ("gearlash smoothed", plots.CYCLE[3], "-"),
    "numba, 1 thread": ("numba, 1 thread, no events", plots.CYCLE[4], "--"),
}


def draw(folder: Path, picture: Path) -> None:
    """What of throughput.json and peers.json is in a folder."""
    drawn = {"throughput": _throughput, "peers": _peers}
    found = {name: folder / f"{name}.json" for name in drawn if (folder / f"{name}.json").exists()}
    if not found:
        return
    size = (4.8 * len(found), 3.9)
    with plots.figure(picture, columns=len(found), squeeze=False, size=size) as axes:
        for ax, (name, file) in zip(axes.ravel(), found.items(), strict=True):
            drawn[name](ax, json.loads(file.read_text("utf-8"))["tables"]["rows"])


def _throughput(ax: Any, rows: list[dict[str, Any]]) -> None:
    shortest = [r for r in rows if r["steps"] == min(row["steps"] for row in rows)]
    for name, (label, colour, style) in LINES.items():
        own = [(r["batch"], r["M_steps_per_s"]) for r in shortest if r["what"] == name]
        if own:
            ax.plot(*zip(*own, strict=True), style, color=colour, label=label, marker=".")
    ax.set(xscale="log", yscale="log", xlabel="drives in a batch", title="Bench drive, float64")
    ax.set_ylabel("million plant-steps per second")
    ax.legend(loc="lower right")


def _peers(ax: Any, rows: list[dict[str, Any]]) -> None:
    own = sorted(rows, key=lambda r: r["env_s_per_s"])
    names = [r["what"].replace("engine", "gearlash") for r in own]
    ours, theirs = plots.CYCLE[2], plots.COLOURS["before"]
    rates = [r["env_s_per_s"] for r in own]
    colours = [ours if name.startswith("gearlash") else theirs for name in names]
    bars = ax.barh(names, rates, color=colours)
    ax.bar_label(bars, [f"{v:,.0f}" if v >= 10.0 else f"{v:.2g}" for v in rates], padding=3)
    ax.set(xscale="log", xlabel="simulated seconds per second", title="Same closed loop")
    ax.set_xlim(0.3 * min(rates), 8.0 * max(rates))
    ax.set_axisbelow(True)
    ax.grid(visible=False, axis="y")


if __name__ == "__main__":
    draw(*map(Path, sys.argv[1:3]))
