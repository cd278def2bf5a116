"""A million drives: how often does a law exceed its limit on gears that differ from each other?

    python examples/million_drives.py [OUT] [--drives N]

Half gap, stiffness and load inertia differ by up to 30 %; each drive makes one step of 0.3 s in
exact mode, and only its largest torque is kept. `gearlash montecarlo` does the same, keeps its
chunks and can use more machines.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import jaxsim
from jaxsim import plots, tree

CHUNK = 8192  # half a second on a core
SPREAD = {"half_gap": 0.3, "K": 0.3, "J_L": 0.3}
LIMIT = 1.8  # Nm, of the study's objective


def largest_torques(drives: int) -> np.ndarray:
    study = jaxsim.load("bench_worst_case")
    scenario = next(iter(study.scenarios.values()))
    random, found = np.random.default_rng(0), []
    for _ in range(-(-drives // CHUNK)):
        values = {
            name: tree.get(study.drive, name) * random.uniform(1.0 - share, 1.0 + share, CHUNK)
            for name, share in SPREAD.items()
        }
        run = jaxsim.simulate(
            jaxsim.spread(study.drive, **values),
            study.law,
            scenario,
            dt=study.run.dt,
            metrics=("largest_torque_Nm",),
            store=None,
        )
        found.append(np.asarray(run.metrics["largest_torque_Nm"]))
    return np.concatenate(found)[:drives]


def main(out: Path, drives: int) -> None:
    jaxsim.configure()
    began = time.perf_counter()
    torques = largest_torques(drives)
    took = time.perf_counter() - began
    over = int((torques > LIMIT).sum())
    print(
        f"{drives} drives x 0.3 s in {took:.0f} s; {over} exceed {LIMIT} Nm ({over / drives:.2g})"
    )
    print("quantiles 50, 99, 99.9, 100 %: " + ", ".join(
        f"{q:.4f}" for q in np.quantile(torques, (0.5, 0.99, 0.999, 1.0))) + " Nm")  # fmt: skip
    with plots.figure(out / "million_drives.png", size=(7.0, 3.6)) as ax:
        ax.hist(torques, bins=200, log=True)
        ax.axvline(LIMIT, color="#D55E00", linestyle="--", label=f"limit {LIMIT} Nm")
        ax.set_xlabel("largest joint torque [Nm]")
        ax.set_ylabel("drives")
        ax.set_title(f"{drives:,} drives, one step each")
        ax.legend()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", nargs="?", type=Path, default=Path("results/examples"))
    parser.add_argument("--drives", type=int, default=1_000_000)
    main(**vars(parser.parse_args()))
