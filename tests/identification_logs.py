"""Simulated logs of the 2018 bench: what a person would have recorded on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import jaxsim
from jaxsim import tree
from jaxsim.batch import spread
from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.laws.feedforward import Feedforward
from jaxsim.scenario import Scenario
from jaxsim.signals.samples import Samples
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.unknowns import Free, free

PERIOD, SAMPLES = 1e-3, 300  # s; 0.3 s
COUNT = 2.0 * np.pi / 2**20  # rad, 20-bit encoders
TORQUE_NOISE = 0.01  # Nm rms
NAMES = ("half_gap", "K", "D_B", "J_L")
TRUTH = np.array([float(tree.get(bench_2018(), name)) for name in NAMES])
TIMES = PERIOD * np.arange(SAMPLES + 1)


def chirp(to: float = 40.0, amplitude: float = 1.5) -> np.ndarray:
    """Motor torque, Nm: a chirp from 5 Hz that crosses the play some twenty times."""
    sweep = 0.5 * (to - 5.0) / TIMES[-1]
    return amplitude * np.sin(2.0 * np.pi * (5.0 + sweep * TIMES) * TIMES)


def scenario(torque: np.ndarray) -> Scenario:
    return Scenario(Samples(torque, PERIOD, "hold", on_ticks=True), duration=float(TIMES[-1]))


def quantised(angle: np.ndarray) -> np.ndarray:
    return COUNT * np.round(np.asarray(angle) / COUNT)


def random_bench_logs(
    count: int, signals: tuple[str, ...] = ("theta_M", "theta_L", "T_s"), seed: int = 0
) -> tuple[list[Experiment], np.ndarray]:
    """Logs of so many benches, parameters within 20 %, noise of their own; and the truth (n, 4)."""
    rng = np.random.default_rng(seed)
    truth = TRUTH * rng.uniform(0.8, 1.2, (count, len(NAMES)))
    asked = scenario(chirp())
    drives = spread(bench_2018(), **dict(zip(NAMES, truth.T, strict=True)))
    many = jaxsim.simulate(drives, Feedforward(), asked, store=5, metrics=())

    def read(i: int, name: str) -> object:
        values = np.asarray(many.signals[name][i])[1:]
        if name != "T_s":
            return measurement(name, TIMES[1:], quantised(values), COUNT / np.sqrt(12.0))
        noisy = values + TORQUE_NOISE * rng.standard_normal(SAMPLES)
        return measurement(name, TIMES[1:], noisy, TORQUE_NOISE)

    logs = [
        Experiment(
            f"seed {i}", bench_2018(), Feedforward(), asked,
            tuple(read(i, name) for name in signals),  # type: ignore[misc]
        )
        for i in range(count)
    ]  # fmt: skip
    return logs, truth


def unknown(log: Experiment) -> list[Free]:
    """The four parameters, each between a fifth of its value and five times it."""
    return [free(log, n, 0.2 * v, 5.0 * v) for n, v in zip(NAMES, TRUTH, strict=True)]


def write_csv(path: Path, torque: np.ndarray, drive: Drive | None = None, seed: int = 0) -> None:
    """A log in the units that people have: ms, deg, counts."""
    run = jaxsim.simulate(
        drive or bench_2018(), Feedforward(), scenario(torque), store=5, metrics=()
    )
    noise = TORQUE_NOISE * np.random.default_rng(seed).standard_normal(SAMPLES + 1)
    columns = {
        "t [ms]": 1e3 * TIMES,
        "torque [Nm]": torque,
        "motor [deg]": np.rad2deg(quantised(run.signals["theta_M"])),
        "load [counts]": np.round(np.asarray(run.signals["theta_L"]) / COUNT),
        "T_s [Nm]": np.asarray(run.signals["T_s"]) + noise,
    }
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, "%.12g", ",", header=",".join(columns), comments="")


STUDY = """
name = "bench_logs"
[drive]
preset = "bench_2018"
half_gap = "10 mrad"
K = 210.0
D_B = 0.13
J_L = 6.2e-4
[law]
type = "feedforward"
[scenario]
duration = 0.3
[identify]
starts = 2
[identify.columns]
time = { column = "t [ms]", unit = "ms" }
reference = { column = "torque [Nm]" }
theta_M = { column = "motor [deg]", unit = "deg" }
theta_L = { column = "load [counts]", unit = "counts", counts = 1048576 }
T_s = { column = "T_s [Nm]", noise = 0.01 }
[identify.free]
half_gap = { lower = "2 mrad", upper = "40 mrad" }
K = { lower = 60, upper = 1500 }
D_B = { lower = 0.02, upper = 0.5 }
J_L = { lower = 2e-4, upper = 4e-3 }
[[identify.experiments]]
log = "a.csv"
[[identify.experiments]]
log = "b.csv"
[[identify.experiments]]
log = "c.csv"
use = "test"
"""
