"""The arm of the 2014 paper with the play of the 2018 paper in its joints: no paper has it."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.batch import stack
from jaxsim.findings import Draw, Findings, Group, Row, above, below, claim, measured, near
from jaxsim.hybrid import Exact
from jaxsim.linear.step import step_response
from jaxsim.linear.torque_loop import closed_loop
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run
from jaxsim.scenario import Scenario
from jaxsim.signals.step import Step
from jaxsim.study import load

REVERSAL, DURATION = 1.0, 5.0  # s
EVENTS = 8000
STUDIES = {"full": "arm_backlash", "none": "arm_backlash_none", "damped": "arm_backlash_damped"}
LABELS = {
    "full": "full positive feedback",
    "none": "without",
    "damped": "full, with switched damping",
}
GAPS = {"gap": 1e-3, "no_gap": 0.0}
METRICS = ("entry_speed_rad_s", "torque_overshoot_pct", "command_peak")
READING = (
    "k_o = 2, start at rest at (0, 0.5) rad in mid-gap; step of joint 1 to 3 Nm at t = 0 and to -3 "
    "Nm at 1 s, joint 2 to 0 and 0.5 Nm; damping -10 V s/rad on omega_B, switched as in the 2018 "
    "paper"
)
RIPPLE = (
    "3 Nm on joint 1, 0 on joint 2, with the ripple of section 3.3, 0-5 s, samples at 4 kHz; k_o = "
    "2, start at rest at (0, 0.5) rad in mid-gap"
)


class Combined(Group):
    """Studies arm_backlash, arm_backlash_none, arm_backlash_damped; half_gap 0 beside 1 mrad."""

    paper = f"{paper.PAPER}, with the play of 2018"
    title = "what 1 mrad half gap per joint does to the arm under torque control"
    figures = ("combined_step", "combined_ripple")

    def find(self) -> Findings:
        steps, ripple = combined_runs()
        rows = [row for case in steps for row in _rows(case, steps[case], ripple[case])]
        return Findings([*rows, *_claims(rows, steps)], _figures(steps, ripple))


@functools.cache
def combined_runs(dt: float = paper.DT) -> tuple[dict[str, Run], dict[str, Run]]:
    """By `<law>_<gap>`: steps without ripple, and the paper's step with ripple."""
    cases = [(law, gap) for law in STUDIES for gap in GAPS]
    both = []
    for amplitude, back, second in ((0.0, -2.0 * paper.STEP, paper.STEP_2), (None, 0.0, 0.0)):
        drives, laws, asked = [], [], []
        for law, gap in cases:
            study = load(STUDIES[law])
            drives.append(_changed(study.drive, GAPS[gap], amplitude))
            laws.append(study.law)
            references = (Step(paper.STEP) + Step(back, REVERSAL), Step(second, REVERSAL))
            start = study.scenario
            asked.append(Scenario(references, start.load_torque, start.start, DURATION))
        both.append(_simulated(drives, laws, asked, dt))
    names = [f"{law}_{gap}" for law, gap in cases]
    steps, ripple = ({n: b.member(i) for i, n in enumerate(names)} for b in both)
    return steps, ripple


def _changed(drive: Any, half_gap: float, amplitude: float | None) -> Any:
    values = {p: half_gap for p in tree.paths(drive) if p.endswith("half_gap")}
    if amplitude is not None:
        values |= {p: amplitude for p in tree.paths(drive) if p.endswith("amplitude")}
    return tree.replace(drive, values)


def _simulated(drives: list[Any], laws: list[Any], asked: list[Scenario], dt: float) -> Run:
    batch = simulate(
        stack(drives), stack(laws), stack(asked), dt=dt, store=round(paper.DT / dt),
        metrics=METRICS, deadzone=Exact(EVENTS),
    )  # fmt: skip
    return jax.tree.map(np.asarray, batch)


def settled(run: Run) -> float:
    """From the step of joint 1 to the last time outside 2 % before the reversal, ms; inf: never."""
    first = np.asarray(run.time) < REVERSAL
    outside = np.flatnonzero(np.abs(paper.torque_error(run)[first, 0]) > 0.02 * paper.STEP)
    last = outside[-1] + 1
    return float(1e3 * run.time[last]) if last < first.sum() else float("inf")


def reversed_after(run: Run) -> float:
    """From the reversal to T_s = 0 on its way to -3 Nm, joint 1, and on to -1.5 Nm, ms."""
    later = np.asarray(run.time) >= REVERSAL
    torque, time = np.asarray(run.signals["T_s"])[later, 0], np.asarray(run.time)[later]
    k = int(np.argmax(torque < -0.5 * paper.STEP))
    if not torque[k] < -0.5 * paper.STEP:
        return float("inf")
    share = (torque[k - 1] + 0.5 * paper.STEP) / (torque[k - 1] - torque[k])
    return float(1e3 * (time[k - 1] + share * (time[k] - time[k - 1]) - REVERSAL))


def in_gap(run: Run, joint: int) -> float:
    """Share of the samples without contact, %."""
    return float(100.0 * np.mean(np.asarray(run.signals["contact"])[:, joint] == 0.0))


def landings(run: Run, joint: int) -> int:
    """How often contact is made."""
    names = {f"contact+[{joint}]", f"contact-[{joint}]"}
    return sum(e.surface in names and e.speed > 0.0 for e in run.events())


def _rows(case: str, steps: Run, ripple: Run) -> list[Row]:
    first = np.asarray(steps.time) < REVERSAL
    peak = float(np.asarray(steps.signals["T_s"])[first, 0].max())
    over = 100.0 * (peak / paper.STEP - 1.0)
    numbers = [
        ("overshoot_pct", "largest T_s before the reversal, beyond 3 Nm, joint 1", "%", over,
         READING),
        ("entry_speed_rad_s", "omega_B at the first contact, joint 1", "rad/s",
         steps.metrics["entry_speed_rad_s"][0], READING),
        ("settling_ms", "settling of T_s before the reversal, 2 %, joint 1", "ms", settled(steps),
         READING),
        ("reversal_t50_ms", "from the reversal to T_s = -1.5 Nm, joint 1", "ms",
         reversed_after(steps), READING),
        ("reversal_overshoot_pct", "beyond -3 Nm after the reversal, joint 1, of 3 Nm", "%",
         steps.metrics["torque_overshoot_pct"][0], READING),
        ("peak_voltage_V", "largest |v| of joint 1", "V", steps.metrics["command_peak"][0],
         READING),
    ]  # fmt: skip
    rms = paper.rms(paper.torque_error(ripple))
    for joint in (0, 1):
        where = f"joint {joint + 1}"
        numbers.append(
            (f"ripple_rms_joint{joint + 1}_Nm", f"RMS of T_s - tau_r, {where}", "Nm", rms[joint],
             RIPPLE)
        )  # fmt: skip
        if case.endswith("_no_gap"):
            continue
        numbers += [
            (f"ripple_in_gap_joint{joint + 1}_pct", f"share of time in the gap, {where}", "%",
             in_gap(ripple, joint), RIPPLE),
            (f"ripple_landings_joint{joint + 1}", f"contacts made, {where}", "1",
             landings(ripple, joint), RIPPLE),
        ]  # fmt: skip
    return [measured(f"combined.{case}.{name}", *rest) for name, *rest in numbers]


def _claims(rows: list[Row], steps: Mapping[str, Run]) -> list[Row]:
    at = {row.id.removeprefix("combined."): row.value for row in rows}

    def ratio(name: str, case: str, other: str) -> float:
        return at[f"{case}.{name}"] / at[f"{other}.{name}"]

    return [
        claim("gap_fast", "settling of joint 1, full feedback, with over without gap", "1",
              ratio("settling_ms", "full_gap", "full_no_gap"), below(2.0),
              "does a gap leave the torque step fast, as in Fig. 3?"),
        claim("gap_needs_feedback", "RMS with ripple, joint 1, without over with positive feedback",
              "1", ratio("ripple_rms_joint1_Nm", "none_gap", "full_gap"), above(1.5),
              "does positive feedback still pay with a gap?"),
        claim("gap_decoupled", "T_s of joint 1 against (20), largest difference before 1 s", "Nm",
              _from_linear(steps["full_gap"]), near(0.0, 0.05),
              "does Remark 1 hold with a gap? (without, the difference is "
              f"{_from_linear(steps['full_no_gap']):.4f} Nm, from the start at (0, 0.5)). It does "
              "not: the load is free until contact, and lands"),
        claim("gap_overshoot", "overshoot of joint 1, full feedback", "%",
              at["full_gap.overshoot_pct"], near(32.4, 5.0),
              "does the linear overshoot predict the impact?"),
        claim("gap_reversal", "overshoot after the reversal, with over without gap", "1",
              ratio("reversal_overshoot_pct", "full_gap", "full_no_gap"), below(1.1),
              "does a torque reversal through the gap keep the overshoot?"),
        claim("gap_ripple_joint1", "RMS with ripple, joint 1, with over without gap", "1",
              ratio("ripple_rms_joint1_Nm", "full_gap", "full_no_gap"), near(1.0, 0.5),
              "do the ripple RMS values of section 3.3 hold with a gap?"),
        claim("gap_joint2_held", "share of time in the gap, joint 2, tau_r = 0, with ripple", "%",
              at["full_gap.ripple_in_gap_joint2_pct"], below(50.0),
              "is a joint without torque reference still in contact? With full feedback the motor "
              "follows the link and its torque error is no torque at all"),
        claim("gap_damping_pays", "overshoot of joint 1, switched damping over none, with gap", "1",
              ratio("overshoot_pct", "damped_gap", "full_gap"), below(0.5),
              "does the damping of the 2018 paper serve a torque loop? Without a gap the "
              f"ratio is {ratio('overshoot_pct', 'damped_no_gap', 'full_no_gap'):.3f}: it damps "
              "the loop, not the gap, and settling takes "
              f"{at['damped_gap.settling_ms']:.0f} instead of {at['full_gap.settling_ms']:.0f} "
              "ms"),
    ]  # fmt: skip


def _from_linear(run: Run) -> float:
    first = np.asarray(run.time) < REVERSAL
    loop = closed_loop(paper.arm(), paper.FULL.scaled(paper.K_O))
    response = step_response(loop.channel(["T_s[0]"], ["reference[0]"]), paper.DT, int(first.sum()))
    linear = paper.STEP * response.y[:, 0, 0]
    return float(np.abs(np.asarray(run.signals["T_s"])[first, 0] - linear).max())


def _figures(steps: Mapping[str, Run], ripple: Mapping[str, Run]) -> dict[str, Draw]:
    def draw_steps(path: Path) -> None:
        title = "Torque steps of the arm with 1 mrad half gap per joint"
        caption = f"Joint 1, left the step, right its reversal. Dotted: no gap. {READING}."
        with panel(path, title, caption, rows=3, columns=2, size=(8.6, 7.2), sharex="col") as axes:
            for row, (case, label) in zip(axes, LABELS.items(), strict=True):
                for ax, window in zip(row, ((0.0, 0.15), (0.98, 1.2)), strict=True):
                    for gap, line in (("no_gap", ":"), ("gap", "-")):
                        run = steps[f"{case}_{gap}"]
                        ax.plot(run.time, run.signals["T_s"][:, 0], line, color="C0")
                    ax.set(xlim=window, ylim=(-5.5, 5.0))
                row[0].set_ylabel(f"{label}\n$T_s$ [Nm]")
            for ax in axes[-1]:
                ax.set_xlabel("time [s]")

    def draw_ripple(path: Path) -> None:
        title = "Torque with ripple and 1 mrad half gap per joint"
        caption = f"Left joint 1, right joint 2. Grey: no gap. {RIPPLE}."
        with panel(path, title, caption, rows=3, columns=2, size=(8.6, 7.2), sharex=True) as axes:
            for row, (case, label) in zip(axes, LABELS.items(), strict=True):
                for joint, ax in enumerate(row):
                    for gap, colour in (("no_gap", "0.7"), ("gap", "C0")):
                        run = ripple[f"{case}_{gap}"]
                        ax.plot(run.time, run.signals["T_s"][:, joint], color=colour, linewidth=0.8)
                    ax.set(xlim=(0.0, 3.0), ylim=((2.0, 4.5), (-1.0, 1.0))[joint])
                row[0].set_ylabel(f"{label}\n$T_s$ [Nm]")
            for ax in axes[-1]:
                ax.set_xlabel("time [s]")

    return {"combined_step": draw_steps, "combined_ripple": draw_ripple}
