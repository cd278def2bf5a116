"""Spot a worn gear: one short recording a month, and the half gap that each of them shows.

The logs are generated here: a chirp of the motor torque, encoders of 20 bit, a noisy torque sensor;
the play grows by 4 % a month and the stiffness stays. `watch` fits every log by itself, draws the
trend with its intervals, and raises the alarm before the limit is reached.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import typer

import jaxsim
from jaxsim import tree
from jaxsim.laws.feedforward import Feedforward
from jaxsim.signals.samples import Samples
from tuning.commands.watch import command

MONTHS = 5
PERIOD, SAMPLES = 1e-3, 300  # s
ANGLE = 2.0 * np.pi / 2**20
STUDY = """
name = "monthly"
drive.preset = "bench_2018"
law.type = "feedforward"
scenario.duration = 0.3

[identify]
starts = 1
watch.half_gap = "10 mrad"
columns.time = { column = "t", unit = "s" }
columns.reference = { column = "torque", unit = "Nm" }
columns.theta_M = { column = "motor", unit = "rad" }
columns.theta_L = { column = "load", unit = "rad" }
columns.T_s = { column = "joint", unit = "Nm", noise = 0.01 }
free.half_gap = { lower = "2 mrad", upper = "40 mrad" }
free.K = { lower = 60, upper = 1500 }

[[identify.experiments]]
log = "month*.csv"
"""


def main(out: Path) -> None:
    jaxsim.configure()
    with tempfile.TemporaryDirectory() as folder:
        record(Path(folder))
        study, found = Path(folder) / "monthly.toml", Path(folder) / "found"
        study.write_text(STUDY, "utf-8")
        try:  # as a command: gearlash watch monthly.toml --out found
            command(str(study), found)
        except typer.Exit as ended:
            print(f"exit code {ended.exit_code}: an alarm")
        out.mkdir(parents=True, exist_ok=True)
        shutil.copy(found / "watch.png", out / "worn_gear.png")


def record(folder: Path) -> None:
    """The logs, month1.csv and on."""
    time = PERIOD * np.arange(SAMPLES + 1)
    torque = 1.5 * np.sin(2.0 * np.pi * (5.0 + 58.0 * time) * time)
    scenario = jaxsim.Scenario(
        Samples(torque, PERIOD, "hold", on_ticks=True), duration=float(time[-1])
    )
    new = jaxsim.load("bench_switched").drive
    half_gaps = tree.get(new, "half_gap") * 1.04 ** np.arange(MONTHS)
    worn = jaxsim.spread(new, half_gap=half_gaps)
    run = jaxsim.simulate(worn, Feedforward(), scenario, store=5, metrics=())
    random = np.random.default_rng(0)
    for month in range(MONTHS):
        motor, load, joint = (
            np.asarray(run.signals[n])[month] for n in ("theta_M", "theta_L", "T_s")
        )
        motor, load = (ANGLE * np.round(v / ANGLE) for v in (motor, load))
        joint = joint + 0.01 * random.standard_normal(len(joint))
        rows = np.stack([time, torque, motor, load, joint], axis=1)
        path = folder / f"month{month + 1}.csv"
        np.savetxt(path, rows, "%.12g", ",", header="t,torque,motor,load,joint", comments="")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/examples"))
