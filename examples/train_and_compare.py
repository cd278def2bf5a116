"""Train an agent and compare it: a torque beside the switched law, against the law alone.

A tiny training, ten updates by analytic policy gradients through whole episodes. The agent is a law
like any other: both run on the same 256 drives, which differ by up to 20 % from the paper's bench.
The comparison that counts, with a tuned law, several seeds and intervals, is `gearlash compare`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import jaxsim
from jaxsim import plots
from rl.commands.train import command

NAMES = {
    "first_impact_Nm": "first impact [Nm]",
    "overshoot_pct": "overshoot [%]",
    "iae_rad_s": "IAE [mrad s]",
}
DRIVES = 256


def main(out: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        trained = Path(folder) / "agent"
        # As a command: gearlash train backlash_position_residual --set iterations=10 --out agent
        change = ["iterations=10", "validate_every=5"]
        command("backlash_position_residual", trained, change=change)
        agent = jaxsim.load("bench_switched", law=str(trained / "law.toml"))
    study = jaxsim.load("bench_switched")
    random = np.random.default_rng(0)
    share = random.uniform(0.8, 1.2, (2, DRIVES))
    drives = jaxsim.spread(study.drive, half_gap=7.8e-3 * share[0], K=300.0 * share[1])
    found = {}
    for name, law in (("switched law", study.law), ("with agent", agent.law)):
        options = {"metrics": tuple(NAMES), "store": None, "dtype": "float32"}
        found[name] = jaxsim.simulate(drives, law, study.scenario, **options).metrics
        told = (f"{n} {float(np.median(v)):.4g}" for n, v in found[name].items())
        print(f"{name}, median of {DRIVES} drives: {', '.join(told)}")
    draw(out / "train_and_compare.png", found)


def draw(path: Path, found: dict[str, Any]) -> None:
    with plots.figure(path, 1, len(NAMES), size=(8.5, 3.2)) as axes:
        for ax, (name, label) in zip(axes, NAMES.items(), strict=True):
            for who, numbers in found.items():
                scale = 1e3 if name == "iae_rad_s" else 1.0
                values = scale * np.sort(np.asarray(numbers[name], float))
                ax.plot(values, (np.arange(DRIVES) + 1.0) / DRIVES, label=who)
            ax.set_xlabel(label)
        axes[0].set_ylabel("share of drives below")
        axes[0].legend()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/examples"))
