"""Stiction at the motors of the arm; 2014 paper, Fig. 10."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxsim.drives.two_link_arm_2014 import two_link_arm_2014
from jaxsim.findings import Draw, Findings, Group, Row, below, claim, measured
from jaxsim.hybrid import Exact
from jaxsim.motors.friction import Stribeck
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run

FRICTION = Stribeck(Fc=0.010, Fs=0.015, ws=2.0)
READING = (
    "the paper gives no model: Stribeck friction at the motor shaft, Fc = 0.010, Fs = 0.015 Nm, "
    "ws = 2 rad/s (errata), with the ripple of section 3.3; full feedback, k_o = 2, start at rest "
    "at theta_L = (0, 0.5), record of 15 s at 1 kHz"
)
CASES = {"uncompensated": paper.NO_LEAD, "compensated": paper.LEAD}
EVENTS = 4000  # room for stops and starts of one run


class Stiction(Group):
    """Sticks that hold, located: every stop and start of a motor is an event."""

    paper = paper.PAPER
    title = "stiction with and without lead compensation (section 3.3.1, Fig. 10)"
    figures = ("fig14_10",)

    def find(self) -> Findings:
        found = stiction_runs()
        rows = [row for case, run in found.items() for row in _rows(case, run)]
        return Findings([*rows, *_claims(found)], _figures(found))


@functools.cache
def stiction_runs() -> dict[str, Run]:
    """Without and with lead."""
    arm = paper.rippled(two_link_arm_2014())
    drive = replace(arm, motor=tuple(replace(m, friction=FRICTION) for m in arm.motor))
    cases = {
        name: paper.Case(drive, paper.arm_law(lead=lead), paper.arm_scenario())
        for name, lead in CASES.items()
    }
    return paper.runs(cases, Exact(EVENTS), members=len(cases))


def stops(run: Run, joint: int) -> int:
    """How often the motor of a joint comes to rest."""
    names = {f"slip+[{joint}]", f"slip-[{joint}]"}
    return sum(e.surface in names and e.speed < 0.0 for e in run.events())


def _rows(case: str, run: Run) -> list[Row]:
    rows = []
    for joint, value in enumerate(paper.rms(paper.torque_error(run))):
        prefix = f"stiction.{case}"
        late = np.abs(paper.torque_error(run)[1000:, joint]).max()
        stuck = np.mean(np.abs(run.signals["omega_M"][:, joint]) < 1e-9)
        rows += [
            measured(f"{prefix}.rms_joint{joint + 1}_Nm", "RMS of T_s - tau_r", "Nm", value,
                     READING),
            measured(f"{prefix}.largest_joint{joint + 1}_Nm", "largest |T_s - tau_r| after 1 s",
                     "Nm", late, READING),
            measured(f"{prefix}.stuck_joint{joint + 1}_pct", "share of the record at rest", "%",
                     100.0 * stuck, READING),
            measured(f"{prefix}.stops_joint{joint + 1}", "stops of the motor", "1",
                     stops(run, joint), READING),
        ]  # fmt: skip
    return rows


def _claims(found: Mapping[str, Run]) -> list[Row]:
    without, lead = (paper.rms(paper.torque_error(found[c])) for c in CASES)
    quote = "3.3.1: 'the effects of stiction are reduced for the controller with the lead'"
    return [
        claim(f"stiction_reduced_joint{joint + 1}", "RMS with over without lead", "1",
              lead[joint] / without[joint], below(1.0), quote)
        for joint in (0, 1)
    ]  # fmt: skip


def _figures(found: Mapping[str, Run]) -> dict[str, Draw]:
    def draw(path: Path) -> None:
        caption = f"2014 paper, Fig. 10. Reading: {READING}."
        title = "Torque step with cyclic friction and stiction"
        with panel(path, title, caption, rows=2, size=(7.6, 5.2), sharex=True) as axes:
            labels = zip(found.items(), ("uncompensated (U)", "with lead (C)"), strict=True)
            for (_, run), label in labels:
                for joint, ax in enumerate(axes):
                    ax.plot(run.time, run.signals["T_s"][:, joint], linewidth=0.9, label=label)
            for joint, ax in enumerate(axes):
                ax.axhline((paper.STEP, 0.0)[joint], color="0.45", linestyle=":")
                ax.set(ylabel=rf"joint {joint + 1}: $T_s$ [Nm]", xlim=(0.0, 5.0))
            axes[0].set_ylim(2.4, 4.2)
            axes[0].legend()
            axes[1].set_xlabel("time [s]")

    return {"fig14_10": draw}
