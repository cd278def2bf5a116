"""Torque control of a two-link arm: what positive feedback changes, and what 1 mrad play costs.

PI control alone is slow, since the poles of the load are zeros of the joint torque; positive
feedback of the load's velocity, acceleration and jerk cancels them. With play in both joints the
torque is late by the crossing of the gap and overshoots more, and the feedback still pays.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import jaxsim
from jaxsim import plots

STUDIES = {
    "PI alone, with play": "arm_backlash_none",
    "PI + positive feedback": "arm_torque",
    "PI + positive feedback, 1 mrad half gap": "arm_backlash",
}


def main(out: Path) -> None:
    jaxsim.configure()
    runs = {}
    for label, name in STUDIES.items():
        study = jaxsim.load(name)
        runs[label] = jaxsim.simulate(
            study.drive,
            study.law,
            study.scenario,
            dt=study.run.dt,
            deadzone=study.run.deadzone,
        )
        rms = float(runs[label].metrics["torque_error_rms_Nm"][0])
        print(f"{label}: RMS torque error of joint 1 over 1 s {rms:.4f} Nm")
    draw(out / "torque_control.png", runs)


def draw(path: Path, runs: dict[str, jaxsim.Run]) -> None:
    with plots.figure(path, 2, sharex=True, size=(7.5, 4.8)) as axes:
        for label, run in runs.items():
            time = 1e3 * np.asarray(run.time)
            axes[0].plot(time, run.signals["T_s"][:, 0], label=label)
            axes[1].plot(time, 1e3 * np.asarray(run.signals["theta_B"][:, 0]))
        axes[0].axhline(3.0, color="black", linestyle=":", linewidth=1.0)
        axes[0].set_ylabel("joint 1 torque [Nm]")
        axes[1].set_ylabel("deflection [mrad]")
        axes[1].set_xlabel("time [ms]")
        axes[1].set_xlim(0.0, 200.0)
        axes[0].set_title("3 Nm torque step at t = 0")
        axes[0].legend()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/examples"))
