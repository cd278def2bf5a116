"""Plots of trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from rl.store import Row


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
        ax.grid(alpha=0.3, which="both")
    axes[0].legend(frameon=False)
    figure.suptitle(f"Learning curves, {title}: least so far (thin: each validation)")
    figure.savefig(path, dpi=130)
