"""Identify a geared servo from a log: half gap, stiffness, damping, load inertia, with intervals.

The log is generated here: a step of the position loop, encoder angles of 20 bit and a noisy torque
sensor, 1 kHz for 0.3 s. The fit starts 30 % off and does not know the true numbers.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import jaxsim
from jaxsim import plots, tree
from tuning.identification.estimator import fit
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.residuals import Problem
from tuning.identification.robust import Squares
from tuning.identification.uncertainty import covariance
from tuning.identification.unknowns import free

TRUE = {"half_gap": 7.8e-3, "K": 300.0, "D_B": 0.1, "J_L": 8.78e-4}
ANGLE = 2.0 * np.pi / 2**20
NOISE = {"theta_L": ANGLE, "theta_M": ANGLE, "T_s": 0.01}


def main(out: Path) -> None:
    jaxsim.configure()
    study = jaxsim.load("bench_switched")
    run = jaxsim.simulate(study.drive, study.law, study.scenario, store=5)
    log = recorded(run, np.random.default_rng(0))
    wrong = tree.replace(study.drive, {n: 0.7 * v for n, v in TRUE.items()})
    times = np.asarray(run.time)
    measured = tuple(measurement(n, times, log[n], noise=NOISE[n]) for n in NOISE)
    experiment = Experiment("bench", wrong, study.law, study.scenario, measured)
    unknown = [free(experiment, n, 0.4 * v, 2.5 * v) for n, v in TRUE.items()]
    problem = Problem([experiment], unknown, dt=2e-4, width=1)
    fits = fit(problem, problem.initial())
    values = fits.values[fits.best]
    seen = problem.evaluate(values)
    deviation = covariance(problem, seen, values, Squares()).deviation
    for name, value, error in zip(TRUE, values, deviation, strict=True):
        print(f"{name:>8} = {value:.6g} +- {1.96 * error:.2g} (true {TRUE[name]:g})")
    found = tree.replace(wrong, dict(zip(TRUE, values, strict=True)))
    draw(
        out / "identify_geared_servo.png", study, {"start": wrong, "identified": found}, times, log
    )


def draw(path: Path, study: Any, drives: dict[str, Any], times: np.ndarray, log: Any) -> None:
    with plots.figure(path, 2, sharex=True, size=(7.5, 4.6)) as axes:
        for ax, name in zip(axes, ("theta_M", "T_s"), strict=True):
            ax.plot(1e3 * times, log[name], ".", color="0.6", markersize=3, label="log")
            for label, drive in drives.items():
                run = jaxsim.simulate(drive, study.law, study.scenario)
                ax.plot(1e3 * np.asarray(run.time), run.signals[name], label=label)
            ax.set_ylabel(plots.LABELS[name])
        axes[0].legend()
        axes[1].set_xlabel("time [ms]")


def recorded(run: jaxsim.Run, random: np.random.Generator) -> dict[str, np.ndarray]:
    """What the sensors make of the run."""
    exact = {n: np.asarray(run.signals[n]) for n in ("theta_L", "theta_M")}
    angles = {n: ANGLE * np.round(v / ANGLE) for n, v in exact.items()}
    torque = np.asarray(run.signals["T_s"])
    return {**angles, "T_s": torque + NOISE["T_s"] * random.standard_normal(len(torque))}


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/examples"))
