"""How the figures of the 2018 paper are drawn: one panel, the paper's axes, a caption below."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.findings import Draw
from jaxsim.plots import COLOURS, figure
from jaxsim.reproduction._bench_2018 import DT, ONSET, STEP
from jaxsim.run import Run

# As in the paper: without damping solid, conventional dashed. Its third style is not in the text.
LINES: dict[str, dict[str, Any]] = {
    "none": {"color": COLOURS["none"], "linestyle": "-", "label": "without damping"},
    "linear": {"color": COLOURS["linear"], "linestyle": "--", "label": "conventional (linear)"},
    "switched": {
        "color": COLOURS["switched"],
        "linestyle": (0, (5, 1, 1, 1)),
        "linewidth": 1.7,
        "label": "proposed (switched)",
    },
}
REFERENCE: dict[str, Any] = {"color": "0.45", "linestyle": ":", "linewidth": 1.6}
AXES = {
    "theta_L": r"load-side angle $\theta_L$ [rad]",
    "T_s": r"joint torque $T_s$ [Nm]",
    "T_M": r"motor torque $T_M$ [Nm]",
}
METHOD = f"Contacts and switchings located exactly, dt\u00a0=\u00a0{1e3 * DT:g}\u00a0ms."
_SIZE = (6.6, 4.0)
_WIDTH = 118  # characters of a line of the caption


@contextmanager
def panel(path: Path, title: str, caption: str, **options: Any) -> Iterator[Any]:
    """One or more axes with a title above the first and the caption below all."""
    options = {"size": _SIZE, **options}
    with figure(path, **options) as axes:
        first = axes if not isinstance(axes, np.ndarray) else axes.flat[0]
        first.set_title(title)
        yield axes
        # constrained_layout keeps room for a supxlabel, which it does not for free text.
        width = int(_WIDTH * options["size"][0] / _SIZE[0])
        lines = textwrap.fill(caption, width, break_on_hyphens=False)
        first.figure.supxlabel(
            lines, x=0.012, ha="left", fontsize=7.5, color="0.3", linespacing=1.35
        )


def over_time(
    found: Mapping[str, Run],
    signal: str,
    window: tuple[float, float],
    title: str,
    caption: str,
    *,
    span: tuple[float, float] | None = None,
    marks: bool = False,
) -> Draw:
    """A signal of the three laws over a window of time; `marks` adds the step it should follow."""

    def draw(path: Path) -> None:
        with panel(path, title, caption) as ax:
            for kind, run in found.items():
                ax.plot(run.time, run.signals[signal], **LINES[kind])
            if marks:
                at = [window[0], max(ONSET, window[0]), max(ONSET, window[0]), window[1]]
                level = [0.0 if window[0] < ONSET else STEP] * 2 + [STEP] * 2
                ax.plot(at, level, **REFERENCE, label="reference", zorder=1)
            ax.set(xlabel="time [s]", ylabel=AXES[signal], xlim=window, ylim=span)
            ax.legend()

    return draw
