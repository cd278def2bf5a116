"""Derivatives by a Butterworth filter and differences: where they suit; 2014 paper, section 4."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsim.findings import Findings, Group, Row, above, below, claim, measured
from jaxsim.linear.frequency import bandwidth
from jaxsim.linear.joints import JointSystem
from jaxsim.linear.stability import abscissa, bisected_intervals
from jaxsim.linear.state_space import poles
from jaxsim.linear.torque_loop import Butterworth, TorqueLaw, characteristic, closed_loop
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.reproduction import _leg_2014 as leg

READING = "third order, 50 Hz; the differences in the limit of fast sampling"


class Filtered(Group):
    """Stable on the leg, which is damped; unstable on the arm, which is not."""

    paper = paper.PAPER
    title = "load derivatives by filter and differences, on the leg and on the arm (section 4)"

    def find(self) -> Findings:
        on_leg = closed_loop(paper.leg(), leg.linear("full", filtered=True))
        on_arm = _on_arm(leg.CUTOFF)
        cutoff, damping = _cutoffs()[0][0], _dampings()[0][0]
        rows = [
            measured("filtered.leg.rightmost_pole_1_s", "rightmost pole on the leg", "1/s",
                     np.real(poles(on_leg))[0], READING),
            measured("filtered.leg.bandwidth_Hz", "bandwidth on the leg", "Hz",
                     bandwidth(on_leg.channel(["T_s"], ["reference"])) / paper.HZ, READING),
            measured("filtered.arm.rightmost_pole_1_s", "rightmost pole on the arm, B_L = 0.01",
                     "1/s", abscissa(closed_loop(paper.arm(), on_arm).A), READING),
            paper.two_ways(
                measured("filtered.arm.stable_cutoff_Hz", "cut-off from which the arm is stable",
                         "Hz", cutoff, "k_o = 2, B_L = 0.01"), _by_state_space_cutoff(cutoff)),
            paper.two_ways(
                measured("filtered.arm.stable_BL_Nms_rad", "B_L from which the arm is stable",
                         "Nm s/rad", damping, "k_o = 2, cut-off 50 Hz"),
                _by_state_space_damping(damping)),
        ]  # fmt: skip
        return Findings([*rows, *_sampled(), *_claims(rows)], {})


def _on_arm(cutoff: float) -> TorqueLaw:
    law = paper.FULL.scaled(paper.K_O)
    return replace(law, derivatives=Butterworth(cutoff * paper.HZ, leg.ORDER))


def _damped(B_L: float) -> JointSystem:
    return paper.arm(B_L=(B_L, B_L))


def _cutoffs() -> list[tuple[float, float]]:
    """By the roots of Lemma 6."""
    return bisected_intervals(
        lambda f: characteristic(paper.arm(), _on_arm(f)).roots(), np.geomspace(5.0, 1e4, 60)
    )


def _dampings() -> list[tuple[float, float]]:
    law = _on_arm(leg.CUTOFF)
    return bisected_intervals(
        lambda b: characteristic(_damped(b), law).roots(), np.geomspace(1e-3, 1.0, 60)
    )


def _by_state_space_cutoff(near_by: float) -> float:
    """By the eigenvalues of the interconnected loop."""
    grid = near_by * np.array([0.9, 1.1])
    return bisected_intervals(lambda f: poles(closed_loop(paper.arm(), _on_arm(f))), grid)[0][0]


def _by_state_space_damping(near_by: float) -> float:
    grid, law = near_by * np.array([0.9, 1.1]), _on_arm(leg.CUTOFF)
    return bisected_intervals(lambda b: poles(closed_loop(_damped(b), law)), grid)[0][0]


def _sampled() -> list[Row]:
    """The leg as in the experiment: sampled at 1 kHz."""
    runs = leg.runs(filtered=True, amplitude=0.0)
    note = "sampled at 1 kHz, filter by Tustin's rule, differences of it, no lead"
    rows = []
    for case in leg.ALPHAS:
        error = np.abs(leg.after_step(runs[case])[-500:]).max()
        over = runs[case].metrics["torque_overshoot_pct"]
        prefix = f"filtered.leg_sampled.{case}"
        rows += [
            measured(f"{prefix}.overshoot_pct", "overshoot of T_s", "%", over, note),
            measured(f"{prefix}.final_error_Nm", "largest |T_s - tau_r|, last 0.5 s of 6 s", "Nm",
                     error, note),
        ]  # fmt: skip
    return rows


def _claims(rows: list[Row]) -> list[Row]:
    at = {row.id.removeprefix("filtered."): row.value for row in rows}
    return [
        claim("filtered_leg_stable", "rightmost pole on the leg", "1/s",
              at["leg.rightmost_pole_1_s"], below(0.0),
              "4: full feedback by the 50 Hz filter and differences works in the experiment"),
        claim("filtered_arm_unstable", "rightmost pole on the arm, B_L = 0.01", "1/s",
              at["arm.rightmost_pole_1_s"], above(0.0),
              "not in the paper, whose arm takes its derivatives from the model: the filter of "
              "section 4 would not do there"),
    ]  # fmt: skip
