"""Section II.C of the 2018 paper: the half gap from both encoders, Fig. 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxsim._simulate import simulate
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.findings import Draw, Findings, Group, against_paper, measured
from jaxsim.laws.feedforward import Feedforward
from jaxsim.plots import COLOURS
from jaxsim.reproduction import _bench_2018 as bench
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run
from jaxsim.scenario import Scenario
from jaxsim.signals.multisine import Multisine

# Slow and small: T_s presses the spring by 5 urad at most, and the gap is crossed in a third of
# each half period. The first period is left out.
AMPLITUDE, FREQUENCY, PERIODS = 5e-3, 0.2, 2  # Nm, Hz
DT = 4e-4
COUNT = 2.0 * np.pi / 2**20  # rad, 20-bit encoders
READING = (
    f"T_M = {1e3 * AMPLITUDE:g} mNm sin(2 pi {FREQUENCY:g} Hz t), open loop, second period; both "
    "angles rounded to 20 bit. Amplitude and frequency are ours: the paper says small and slow"
)


class GapIdentification(Group):
    """Half of the distance between the two levels on which the measured theta_M - theta_L rests."""

    paper = bench.PAPER
    title = "half gap from a slow small sine and both encoders (section II.C, Fig. 2)"
    figures = ("fig_2",)

    def find(self) -> Findings:
        theta_M, theta_L, time = _record(_run())
        upper, lower = levels(theta_M - theta_L)
        half_gap = 0.5 * (upper - lower)
        rows = [
            against_paper(
                "gap_identification.half_gap_rad",
                "half gap",
                "rad",
                half_gap,
                7.80e-3,
                5e-6,
                f"half of the last digit; {READING}",
            ),
            measured("gap_identification.amplitude_Nm", "amplitude of T_M", "Nm", AMPLITUDE),
            measured("gap_identification.frequency_Hz", "frequency of T_M", "Hz", FREQUENCY),
            measured(
                "gap_identification.torsion_range_rad",
                "theta_M - theta_L, peak to peak",
                "rad",
                np.ptp(theta_M - theta_L),
                "twice the half gap and what the impacts press",
            ),
        ]
        return Findings(rows, {"fig_2": _figure(theta_M, theta_L, time, half_gap)})


def _run() -> Run:
    sine = Multisine([AMPLITUDE], [FREQUENCY], [0.0])
    asked = Scenario(sine, duration=PERIODS / FREQUENCY)
    return simulate(bench_2018(), Feedforward(), asked, dt=DT, metrics=(), store=5)


def _record(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both encoders over the last period, rad, and the time, s."""
    time = np.asarray(run.time)
    last = time >= (PERIODS - 1) / FREQUENCY
    angles = (np.asarray(run.signals[name])[last] for name in ("theta_M", "theta_L"))
    theta_M, theta_L = (COUNT * np.round(angle / COUNT) for angle in angles)
    return theta_M, theta_L, time[last]


def levels(torsion: np.ndarray) -> tuple[float, float]:
    """The levels on which a torsion rests at the upper and lower wall: medians near the extremes.

    The extremes themselves contain the rebounds and the quantisation.
    """
    upper = torsion[torsion > 0.9 * torsion.max()]
    lower = torsion[torsion < 0.9 * torsion.min()]
    return float(np.median(upper)), float(np.median(lower))


def _figure(theta_M: np.ndarray, theta_L: np.ndarray, time: np.ndarray, half_gap: float) -> Draw:
    told = (
        f"2018 paper, Fig. 2. Reading: {READING}. The paper's axes are not in its text: the loop "
        f"and the torsion are our choice. Contacts located exactly, dt = {1e3 * DT:g} ms."
    )

    def draw(path: Path) -> None:
        title = f"Backlash identification: half gap {1e3 * half_gap:.2f} mrad"
        with panel(path, title, told, columns=2, size=(9.6, 4.0)) as axes:
            axes[0].plot(1e3 * theta_M, 1e3 * theta_L, color=COLOURS["none"])
            axes[0].set(
                xlabel=r"motor-side angle $\theta_M$ [mrad]",
                ylabel=r"load-side angle $\theta_L$ [mrad]",
            )
            _width(axes[0], theta_M, theta_L, half_gap)
            axes[1].plot(time, 1e3 * (theta_M - theta_L), color=COLOURS["none"])
            for side in (-1.0, 1.0):
                axes[1].axhline(side * 1e3 * half_gap, color="0.45", linestyle=":")
            axes[1].set(xlabel="time [s]", ylabel=r"torsion $\theta_M - \theta_L$ [mrad]")

    return draw


def _width(ax: Any, theta_M: np.ndarray, theta_L: np.ndarray, half_gap: float) -> None:
    """An arrow across the loop at half height: the play."""
    x, y = (0.5e3 * (angle.min() + angle.max()) for angle in (theta_M, theta_L))
    arrow = {"arrowstyle": "<->", "color": "0.35", "shrinkA": 0.0, "shrinkB": 0.0}
    ax.annotate("", (x - 1e3 * half_gap, y), (x + 1e3 * half_gap, y), arrowprops=arrow)
    ax.text(x, y, r"$2\,\beta$", ha="center", va="bottom", color="0.35")
