"""Torque steps of the one-DoF leg; 2014 paper, section 4, Figs. 16-19."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy import signal

from jaxsim.findings import Draw, Findings, Group, Row, above, below, claim, measured, near
from jaxsim.linear.frequency import bandwidth, response
from jaxsim.linear.state_space import StateSpace
from jaxsim.linear.torque_loop import closed_loop
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.reproduction import _leg_2014 as leg
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run

READING = (
    "step of 3 Nm at 0.4 s from hanging rest, G_c = 2 (s + 10)/s, derivatives from the leg's model"
)
RIPPLE = (
    "excitation, which the paper does not give: cyclic friction 0.013 cos(2 theta_M + pi) Nm at "
    "the motor, as for the arm"
)
BAND = np.linspace(15.0, 20.0, 51)  # Hz
BANDWIDTH = {"full": (46.0, 45.2, 0.05), "none": (0.7, 0.712, 0.0005)}  # paper, errata, Hz
PARTS = dict(zip("abcd", leg.ALPHAS, strict=True))


class Leg(Group):
    """In place of the experiment: the linearised leg with the drive that gives its Gammas."""

    paper = paper.PAPER
    title = "torque steps of the leg (section 4, Figs. 16-19)"
    figures = ("fig14_16", "fig14_17", "fig14_18", "fig14_19")

    def find(self) -> Findings:
        smooth, rough = leg.runs(amplitude=0.0), leg.runs()
        rows = [
            row for case in leg.CASES for row in _rows(case, smooth[case], rough, _channels(case))
        ]
        return Findings([*rows, *_claims(rows)], _figures(rough))


def _channels(case: str) -> tuple[StateSpace, StateSpace]:
    """T_s from the reference and from tau_d."""
    loop = closed_loop(paper.leg(), leg.linear(case))
    return loop.channel(["T_s"], ["reference"]), loop.channel(["T_s"], ["tau_d"])


def _rows(
    case: str, run: Run, rough: Mapping[str, Run], channels: tuple[StateSpace, StateSpace]
) -> list[Row]:
    width = bandwidth(channels[0]) / paper.HZ
    row = measured(f"leg.{case}.bandwidth_Hz", "-3 dB bandwidth", "Hz", width, "linear")
    if case in BANDWIDTH:
        printed, reference, within = BANDWIDTH[case]
        row = row._replace(
            paper=printed, ok=bool(abs(width - reference) <= within),
            tolerance=f"within {within:g} Hz of the reference",
            note=f"reference {reference:g} ({paper.ERRATA}): one drive for all printed Gammas",
        )  # fmt: skip
    over, settling = (run.metrics[n] for n in ("torque_overshoot_pct", "torque_settle_2pct_s"))
    rows = [
        row,
        measured(f"leg.{case}.overshoot_pct", "overshoot of T_s", "%", over, READING),
        measured(f"leg.{case}.settling_s", "settling of T_s, 2 %", "s", settling, READING),
        measured(f"leg.{case}.ripple_15_20Hz_Nm", "RMS of T_s - tau_r in 15-20 Hz", "Nm",
                 band_rms(rough[case]), f"{RIPPLE}; {READING}"),
    ]  # fmt: skip
    return [*rows, *_ratios(case, rough)] if case.endswith("_lead") else rows


def _ratios(case: str, rough: Mapping[str, Run]) -> list[Row]:
    """With lead over without."""
    plain = case.removesuffix("_lead")
    simulated = band_rms(rough[case]) / band_rms(rough[plain])
    sizes = [_flat(_channels(c)[1]) for c in (case, plain)]
    note = f"{RIPPLE}; {READING}"
    return [
        measured(f"leg.{case}.ripple_ratio_15_20Hz", "ripple in 15-20 Hz, with over without lead",
                 "1", simulated, note)._replace(paper=0.5),
        measured(f"leg.{case}.ripple_ratio_linear_15_20Hz",
                 "|T_s/tau_d|, RMS over 15-20 Hz, with over without lead", "1",
                 sizes[0] / sizes[1], "linear: any small torque at the motor with a flat spectrum"),
    ]  # fmt: skip


def _flat(channel: StateSpace) -> float:
    return float(np.sqrt(np.mean(np.abs(response(channel, paper.HZ * BAND)) ** 2)))


def spectrum(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and spectral density (Nm^2/Hz) of T_s - tau_r after the step."""
    rate = 1.0 / (paper.DT * paper.STORE)
    return signal.welch(leg.after_step(run), rate, nperseg=1024)


def band_rms(run: Run) -> float:
    """Root of the power of T_s - tau_r in 15-20 Hz, Nm."""
    frequency, density = spectrum(run)
    inside = (frequency >= 15.0) & (frequency <= 20.0)
    return float(np.sqrt(density[inside].sum() * frequency[1]))


def _claims(rows: list[Row]) -> list[Row]:
    at = {row.id.removeprefix("leg."): row.value for row in rows}
    widths = [at[f"{c}.bandwidth_Hz"] for c in ("velocity", "velocity_acceleration", "full")]
    return [
        claim("leg_bandwidth", "bandwidth with full feedback", "Hz", widths[-1], near(46.0, 1.0),
              "4: 'designed to have 46 Hz closed loop bandwidth with full positive feedback'",
              paper=46.0),
        claim("leg_bandwidth_without", "bandwidth without positive feedback", "Hz",
              at["none.bandwidth_Hz"], near(0.7, 0.05), "4: 'substantially reduced to 0.7 Hz'",
              paper=0.7),
        claim("leg_velocity_bandwidth", "bandwidth with velocity feedback only", "Hz", widths[0],
              near(46.0, 2.0), "4: 'the bandwidth ... with the velocity feedback increases to "
              "46 Hz'", paper=46.0),
        claim("leg_terms_ignored", "least over largest bandwidth of the three feedbacks", "1",
              min(widths) / max(widths), above(0.9),
              "4: 'since B_L = 1.5 is large we can ignore the acceleration and jerk feedback'"),
        claim("leg_lead_ripple", "ripple in 15-20 Hz, with over without lead, full feedback", "1",
              at["full_lead.ripple_ratio_15_20Hz"], near(0.5, 0.1),
              "4: 'oscillations around 15-20 Hz are considerably reduced by 50%'; for a flat "
              f"spectrum {at['full_lead.ripple_ratio_linear_15_20Hz']:.3f}", paper=0.5),
        claim("leg_lead_transient", "overshoot with over without lead, full feedback", "1",
              at["full_lead.overshoot_pct"] / at["full.overshoot_pct"], below(1.0),
              "4: lead 'to improve disturbance attenuation ... and transient response'"),
    ]  # fmt: skip


def _figures(rough: Mapping[str, Run]) -> dict[str, Draw]:
    filtered = leg.runs(filtered=True)
    return {
        "fig14_16": _steps(rough, filtered, "", 16),
        "fig14_17": _spectra(rough, "", 17),
        "fig14_18": _steps(rough, filtered, "_lead", 18),
        "fig14_19": _spectra(rough, "_lead", 19),
    }


def _steps(rough: Mapping[str, Run], filtered: Mapping[str, Run], suffix: str, number: int) -> Draw:
    def draw(path: Path) -> None:
        title = f"Torque step of the leg{', with lead' if suffix else ''}"
        caption = (
            f"2014 paper, Fig. {number}, simulated. Parts (a)-(d): PI, and with velocity, "
            "acceleration, jerk. Solid: derivatives from the model. Dashed: 50 Hz Butterworth "
            f"filter and differences, sampled at 1 kHz. {RIPPLE}."
        )
        with panel(path, title, caption, rows=2, columns=2, size=(8.6, 5.6), sharex=True) as axes:
            for ax, (part, case) in zip(axes.flat, PARTS.items(), strict=True):
                for runs, line in ((rough, "-"), (filtered, "--")):
                    run = runs[case + suffix]
                    ax.plot(run.time, run.signals["T_s"], line, linewidth=1.0)
                ax.step([0.0, leg.ONSET, 2.0], [0.0, paper.STEP, paper.STEP], color="0.45",
                        linestyle=":", where="post")  # fmt: skip
                ax.set(ylabel=rf"({part}) $T_s$ [Nm]", xlim=(0.2, 2.0), ylim=(-0.2, 4.5))
            for ax in axes[1]:
                ax.set_xlabel("time [s]")

    return draw


def _spectra(rough: Mapping[str, Run], suffix: str, number: int) -> Draw:
    def draw(path: Path) -> None:
        title = f"Spectrum of the leg's torque error{', with lead' if suffix else ''}"
        caption = (
            f"2014 paper, Fig. {number}, simulated, after the step; Welch's method, segments of "
            f"1.024 s. {RIPPLE}."
        )
        with panel(path, title, caption) as ax:
            for part, case in PARTS.items():
                frequency, density = spectrum(rough[case + suffix])
                label = f"({part}) {case.replace('_', ' and ')}"
                ax.semilogy(frequency, density, label=label)
            ax.axvspan(15.0, 20.0, color="0.9", zorder=0, label="15-20 Hz")
            ax.set(xlabel="frequency [Hz]", ylabel=r"spectral density [Nm$^2$/Hz]",
                   xlim=(0.0, 60.0), ylim=(1e-7, 1.0))  # fmt: skip
            ax.legend(ncols=2)

    return draw
