"""Positive feedback by a law whose own model is wrong, or whose sensors are; 2014 paper, 2.3."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.drives.two_link_arm_2014 import two_link_arm_2014
from jaxsim.findings import Draw, Findings, Group, Row, above, below, claim, measured
from jaxsim.linear.joints import JointSystem
from jaxsim.linear.stability import abscissa, bisected_intervals, stable_gains
from jaxsim.linear.torque_loop import closed_loop
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.reproduction._loci_2014 import over_alpha
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run
from jaxsim.sampled import Encoders, Sampled, TrueSpeeds

LINKS = ("inertia_1", "inertia_2", "coupling")
WEIGHTS = ("gravity_1", "gravity_2")
DRIVES = ("Gamma_j", "Gamma_a", "Gamma_v")
BITS, PERIOD, SPAN = 19, 2.5e-4, 3.0
READING = (
    "the law's own model is off, the arm is not; full feedback, k_o = 2, 3 Nm on joint 1 from rest "
    "at (0, 0.5) rad, no ripple"
)
SENSORS = (
    "full feedback with the right model, sampled at 4 kHz, k_o = 2, 3 Nm on joint 1 from rest at "
    "(0, 0.5) rad, 3 s; angles of 19 bits on motor and load, speeds as their differences; the "
    "torque as it is"
)


class Wrong(NamedTuple):
    """Which parameters of the law are off, and by what factor."""

    names: tuple[str, ...]
    factor: float


CASES = {
    "exact": Wrong((), 1.0),
    "inertia_plus20": Wrong(LINKS, 1.2),
    "inertia_minus20": Wrong(LINKS, 0.8),
    "gravity_plus20": Wrong(WEIGHTS, 1.2),
    "gravity_minus20": Wrong(WEIGHTS, 0.8),
    "gammas_plus20": Wrong(DRIVES, 1.2),
    "gammas_minus20": Wrong(DRIVES, 0.8),
    "all_minus20": Wrong((*LINKS, *WEIGHTS, *DRIVES), 0.8),
}


class ModelError(Group):
    """Errors of 20 % in the law's inertias, weights and Gammas; encoders of 19 bits."""

    paper = paper.PAPER
    title = "positive feedback under model errors of 20 % and encoder noise (section 2.3)"
    figures = ("model_error",)

    def find(self) -> Findings:
        drive, asked = paper.rippled(two_link_arm_2014(), 0.0), paper.arm_scenario()
        found = paper.runs({n: paper.Case(drive, _law(w), asked) for n, w in CASES.items()})
        rows = [row for case, run in found.items() for row in _rows(case, run)]
        rows = [*rows, _largest_share(), *_sensors()]
        return Findings([*rows, *_claims(rows)], _figures(found))


def _law(wrong: Wrong) -> Any:
    law = paper.arm_law()
    own = [p for p in tree.paths(law) if p.rpartition(".")[2] in wrong.names]
    return tree.replace(law, {p: wrong.factor * np.asarray(tree.get(law, p)) for p in own})


def _linear(wrong: Wrong) -> Any:
    """The law of the linear analysis with the same errors, k_o = 1."""
    true, law = paper.arm(), paper.FULL
    model: JointSystem = true
    if "inertia_1" in wrong.names:
        model = replace(model, M_L=wrong.factor * true.M_L)
    if "gravity_1" in wrong.names:
        model = replace(model, K_L=wrong.factor * true.K_L)
    if "Gamma_j" in wrong.names:
        law = law.weighted(wrong.factor)
    return replace(law, model=model)


def _largest_share() -> Row:
    """By what factor all Gammas may be too large."""
    loop = over_alpha(paper.arm(), paper.FULL.scaled(paper.K_O))
    ((_, high),) = bisected_intervals(loop, np.linspace(0.5, 1.5, 101))
    words = "largest stable factor on the Gammas, linear"
    return measured("model_error.gammas.largest_factor", words, "1", high, "k_o = 2, (0, 0.5)")


def late(run: Run) -> np.ndarray:
    """RMS of T_s - tau_r from 0.2 s to 3 s, per joint, Nm."""
    time = np.asarray(run.time)
    return paper.rms(paper.torque_error(run)[(time >= 0.2) & (time <= SPAN)])


def _rows(case: str, run: Run) -> list[Row]:
    law = _linear(CASES[case])
    intervals = stable_gains(paper.arm(), law)
    told = ", ".join(f"({low:.6g}, {high:.6g})" for low, high in intervals) or "nowhere"
    pole = abscissa(closed_loop(paper.arm(), law.scaled(paper.K_O)).A)
    top = max((high for _, high in intervals), default=0.0)
    over, prefix = run.metrics["torque_overshoot_pct"][0], f"model_error.{case}"
    return [
        measured(f"{prefix}.overshoot_pct", "overshoot of joint 1, 15 s", "%", over, READING),
        *(measured(f"{prefix}.rms_joint{i + 1}_Nm", "RMS of T_s - tau_r, 0.2-3 s", "Nm", value,
                   READING) for i, value in enumerate(late(run))),
        measured(f"{prefix}.rightmost_pole_1_s", "rightmost pole, linear", "1/s", pole, "k_o = 2"),
        measured(f"{prefix}.stable_to_k_o", "largest stable k_o, linear", "1", top,
                 f"stable on {told}"),
    ]  # fmt: skip


def _sensors() -> list[Row]:
    """The same law with true speeds and with encoders."""
    drive = paper.rippled(two_link_arm_2014(), 0.0)
    asked = replace(paper.arm_scenario(), duration=SPAN)
    rows = []
    for name, sensors in (("true_speeds", TrueSpeeds()), ("encoders_19bit", Encoders(2**BITS))):
        law = Sampled(paper.arm_law(), PERIOD, sensors=sensors)
        run = simulate(drive, law, asked, dt=paper.DT, store=paper.STORE, metrics=())
        run = jax.tree.map(np.asarray, run)
        volts = np.diff(np.asarray(run.signals["command"]), axis=0)
        rows += [
            *(measured(f"model_error.{name}.rms_joint{i + 1}_Nm", "RMS of T_s - tau_r, 0.2-3 s",
                       "Nm", value, SENSORS) for i, value in enumerate(late(run))),
            measured(f"model_error.{name}.voltage_noise_V", "RMS change of v_1 in 1 ms", "V",
                     paper.rms(volts[200:])[0], SENSORS),
        ]  # fmt: skip
    return rows


def _claims(rows: list[Row]) -> list[Row]:
    at = {row.id.removeprefix("model_error."): row.value for row in rows}
    worst = max(at[f"{case}.rightmost_pole_1_s"] for case in CASES)
    steady = [case for case in CASES if at[f"{case}.rightmost_pole_1_s"] < 0.0]
    rise = {case: at[f"{case}.rms_joint1_Nm"] / at["exact.rms_joint1_Nm"] for case in steady}
    top = max(rise, key=lambda case: rise[case])
    return [
        claim("model_error_stable", "rightmost pole at k_o = 2 of all cases", "1/s", worst,
              below(0.0), "2.3: the model-based derivatives need the parameters 'accurately'; are "
              "20 % errors still stable? All but one: Gammas too large by more than a factor "
              f"{at['gammas.largest_factor']:.4f} are unstable. Underestimate them, as [7] does"),
        claim("model_error_matters", f"RMS of joint 1, {top} over exact", "1", rise[top],
              above(2.0), "2.3: 'requires knowing the Coriolis, gravity and dynamic parameters of "
              "the system accurately'"),
    ]  # fmt: skip


def _figures(found: Mapping[str, Run]) -> dict[str, Draw]:
    def draw(path: Path) -> None:
        title = "Torque step with a wrong model in the positive feedback"
        caption = f"{READING}. Left out: Gammas 20 % too large, which is unstable."
        with panel(path, title, caption, rows=2, size=(7.6, 5.4), sharex=True) as axes:
            for case in [name for name in found if name != "gammas_plus20"]:
                run = found[case]
                for joint, ax in enumerate(axes):
                    torque = run.signals["T_s"][:, joint]
                    ax.plot(run.time, torque, linewidth=1.0, label=case.replace("_", " "))
            for joint, ax in enumerate(axes):
                ax.set(ylabel=rf"joint {joint + 1}: $T_s$ [Nm]", xlim=(0.0, 2.0),
                       ylim=((1.0, 4.5), (-1.0, 1.0))[joint])  # fmt: skip
            axes[0].legend(ncols=3)
            axes[1].set_xlabel("time [s]")

    return {"model_error": draw}
