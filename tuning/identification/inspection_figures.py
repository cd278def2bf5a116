"""Pictures of a log: its columns with what is suspicious marked, and its sampling."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxsim.plots import COLOURS, figure
from tuning.identification.inspection import clock, facts
from tuning.log import Log

_MOST = 12  # columns on one picture


def draw(log: Log, time: str | None, out: Path) -> list[tuple[str, Path]]:
    """columns.png and, where there are time stamps, sampling.png; with captions."""
    made = [_columns(log, time, out / "columns.png")]
    if time is not None:
        made.append(_sampling(log, time, out / "sampling.png"))
    return made


def _columns(log: Log, time: str | None, path: Path) -> tuple[str, Path]:
    names = [n for n in log.columns if n != time]
    shown = names[:_MOST]
    with figure(
        path, len(shown), sharex=True, squeeze=False, size=(8.4, 1.35 * len(shown) + 0.8)
    ) as axes:
        for ax, name in zip(axes[:, 0], shown, strict=True):
            values = log.columns[name]
            same = time is not None and values.shape == log.columns[time].shape
            x = log.columns[time] if same else np.arange(values.size)  # type: ignore[index]
            ax.plot(x, values, color=COLOURS["after"], linewidth=0.9)
            spikes = facts(name, values).spikes
            ax.plot(x[spikes], values[spikes], "x", color=COLOURS["limit"], markersize=5)
            for gone in x[~np.isfinite(values)][:200]:
                ax.axvline(gone, color=COLOURS["linear"], linewidth=0.6, alpha=0.5)
            ax.set_ylabel(name, fontsize=8)
        axes[0, 0].set_title(log.path.name)
        axes[-1, 0].set_xlabel(time or "sample")
        axes[0, 0].figure.align_ylabels()
    more = f" The first {_MOST} of {len(names)}." if len(names) > _MOST else ""
    words = "All columns over time; crosses are lone spikes, vertical lines missing samples."
    return words + more, path


def _sampling(log: Log, time: str, path: Path) -> tuple[str, Path]:
    stamps = log.columns[time]
    c = clock(time, stamps)
    steps = np.diff(stamps)
    with figure(path, 1, 2, squeeze=False, size=(8.4, 2.8)) as axes:
        left, right = axes[0]
        left.plot(stamps[1:], steps, ".", markersize=2.5, color=COLOURS["after"])
        left.axhline(c.step, color="0.3", linestyle=":")
        left.set(xlabel=time, ylabel="step to the one before", title="Time steps")
        near = np.clip((steps - c.step) / c.step, -1.0, 2.0)
        right.hist(100.0 * near[np.isfinite(near)], 60, color=COLOURS["after"])
        right.set(xlabel="off the median step [%]", ylabel="samples", yscale="log", title="Jitter")
    caption = (
        f"Median step {c.step:.6g}, jitter {c.jitter:.2g} (scaled median deviation), "
        f"{c.gaps.size} gaps, {c.repeated.size} repeated stamps, {c.backwards.size} backwards."
    )
    return caption, path
