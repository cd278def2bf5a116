"""Plots of trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.run import Run
from rl.comparison import Entry, Line
from rl.store import Row

_NARROW = 4.0  # a logarithmic axis from here to so many times of it has ticks like any other


def _plain_ticks(axis: Any) -> None:
    """0.7, 2 and 3M in place of powers of ten: most axes span less than a decade or two."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    def text(value: float, _: int) -> str:
        return f"{value:g}" if value < 1e4 else f"{value / 1e6:g}M"

    low, high = axis.get_view_interval()
    decade = (1.0, 2.0, 5.0) if high > 10.0 * low else (1.0, 2.0, 3.0, 5.0, 7.0)
    axis.set_major_locator(
        MaxNLocator(5, steps=[1, 2, 5, 10]) if high < _NARROW * low else LogLocator(subs=decade)
    )
    axis.set_major_formatter(FuncFormatter(text))
    axis.set_minor_formatter(NullFormatter())


def learning(path: Path, runs: Mapping[str, Sequence[Sequence[Row]]], title: str) -> None:
    """Median cost of the validation episodes over steps and CPU time; a line per training."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    colours = mpl.colormaps["tab10"].colors  # type: ignore[attr-defined]
    for (name, trainings), colour in zip(runs.items(), colours, strict=False):
        for i, rows in enumerate(trainings):
            cost = np.minimum.accumulate([row.cost for row in rows])
            label = name if i == 0 else None
            for ax, x in zip(axes, ("steps", "cpu"), strict=True):
                at = [getattr(row, x) for row in rows]
                ax.plot(at, [row.cost for row in rows], color=colour, alpha=0.3, lw=0.8)
                ax.plot(at, cost, color=colour, lw=1.4, label=label)
    axes[0].set(xlabel="steps of control", ylabel="median cost (1: the paper's law, nominal)")
    axes[1].set(xlabel="CPU time [s]")
    for ax in axes:
        ax.set(xscale="log", yscale="log")
        ax.grid(alpha=0.3)
        _plain_ticks(ax.xaxis)
        _plain_ticks(ax.yaxis)
    axes[0].legend(frameon=False)
    figure.suptitle(f"Learning curves, {title}: least so far (thin: each validation)")
    figure.savefig(path, dpi=130)


def costs(path: Path, entries: Sequence[Entry], lines: Sequence[Line]) -> None:
    """The distribution of the cost of every contestant, the least first."""
    from matplotlib.figure import Figure

    by_name = {entry.name: entry for entry in entries}
    ordered = [by_name[line.name] for line in reversed(lines)]
    tuned = next(line for line in lines if line.name == "tuned")
    figure = Figure(figsize=(8.0, 0.42 * len(ordered) + 1.2), layout="constrained")
    ax = figure.subplots()
    values = [entry.numbers["cost"].ravel() for entry in ordered]
    boxes = ax.boxplot(
        values, orientation="horizontal", whis=(5, 95), showfliers=False, patch_artist=True,
        tick_labels=[entry.name for entry in ordered], medianprops={"color": "black"},
    )  # fmt: skip
    for box, entry in zip(boxes["boxes"], ordered, strict=True):
        box.set_facecolor("#9ecae1" if entry.learned else "#d9d9d9")
    ax.axvline(tuned.median, color="black", lw=0.8, ls="--")
    ax.set(xscale="log", xlabel="cost of an episode (box: quartiles, whiskers: 5 and 95 %)")
    ax.grid(alpha=0.3, axis="x")
    _plain_ticks(ax.xaxis)
    ax.set_title("Cost; agents blue, classical laws grey, dashed: tuned law", fontsize=10)
    figure.savefig(path, dpi=130)


def responses(path: Path, runs: Mapping[str, Run], signals: Sequence[str]) -> None:
    """Signals of the nominal case, one column of plots."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 2.3 * len(signals) + 0.6), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(signals), 1, sharex=True))
    colours = mpl.colormaps["tab10"].colors  # type: ignore[attr-defined]
    units = next(iter(runs.values())).units
    for i, (name, run) in enumerate(runs.items()):
        for ax, signal in zip(axes, signals, strict=True):
            y = np.asarray(run.signals[signal])
            ax.plot(1e3 * np.asarray(run.time), y, color=colours[i % 10], lw=1.1, label=name)
    for ax, signal in zip(axes, signals, strict=True):
        ax.set_ylabel(f"{signal} [{units[signal]}]")
        ax.grid(alpha=0.3)
    axes[-1].set_xlabel("time [ms]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4,
                  frameon=False, fontsize=8)  # fmt: skip
    figure.savefig(path, dpi=130)
