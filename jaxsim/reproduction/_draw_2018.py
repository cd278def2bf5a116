"""How the figures of the 2018 paper are drawn: one panel, the paper's axes, a caption below."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxsim.findings import Draw
from jaxsim.plots import COLOURS
from jaxsim.reproduction._bench_2018 import DT, ONSET, STEP
from jaxsim.reproduction._panel import panel
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
