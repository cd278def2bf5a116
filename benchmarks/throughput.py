"""Plant-steps per second of exact and plain mode next to a plain numba loop, in one run.

The closed loop is the bench with the switched law, 0.30 rad step, 0.3 s at dt = 2e-4 s; half_gap
differs from member to member. Each figure is the best of three interleaved repeats, compile time
apart; each timing blocks on its result.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from numba_loop import run as numba_run
from rich.console import Console
from rich.progress import track
from rich.table import Table

import jaxsim
from jaxsim._simulate import simulate
from jaxsim.batch import spread
from jaxsim.hybrid import Deadzone, Exact, Plain
from jaxsim.provenance import provenance, write_json
from jaxsim.study import load

BATCHES = (1, 256, 4096, 65536)
REPEATS = 3
METRICS = ("itae_rad_s2", "largest_torque_Nm", "overshoot_rad")
OUT = Path("results/bench/throughput.json")


def engine(deadzone: Deadzone, members: int) -> Callable[[], object]:
    """A call that runs the batch and waits for its metrics."""
    study = load("bench_switched")
    drives = spread(study.drive, half_gap=half_gaps(members))

    def call() -> object:
        done = simulate(
            drives,
            study.law,
            study.scenario,
            dt=study.run.dt,
            deadzone=deadzone,
            metrics=METRICS,
            store=None,
            throw=False,
        )
        return jax.block_until_ready(done.metrics)

    return call


def half_gaps(members: int) -> np.ndarray:
    return 7.8e-3 * np.linspace(0.8, 1.2, members)


def main() -> None:
    jaxsim.configure()
    study = load("bench_switched")
    steps = round(study.scenario.duration / study.run.dt)
    rows = []
    for members in track(BATCHES, description="Measuring ..."):
        calls = {
            "exact": engine(Exact(), members),
            "plain": engine(Plain(), members),
            "numba, one core, no metrics": lambda m=members: numba_run(
                half_gaps(m), steps, study.run.dt
            ),
        }
        best = dict.fromkeys(calls, np.inf)
        first = {}
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            first[name] = time.perf_counter() - begin
        for _ in range(REPEATS):
            for name, call in calls.items():
                begin = time.perf_counter()
                call()
                best[name] = min(best[name], time.perf_counter() - begin)
        rows += [
            {
                "batch": members,
                "what": name,
                "first_call_s": first[name],
                "best_s": best[name],
                "million_steps_per_s": members * steps / best[name] / 1e6,
            }
            for name in calls
        ]
    show(rows)
    write_json(OUT, {"rows": rows, **provenance()})
    Console().print(f"Wrote {OUT}")


def show(rows: list[dict]) -> None:
    table = Table(title="Million plant-steps per second, 0.3 s of the bench at dt = 2e-4 s")
    table.add_column("batch", justify="right")
    names = list(dict.fromkeys(row["what"] for row in rows))
    for name in names:
        table.add_column(name, justify="right")
    for members in BATCHES:
        own = {r["what"]: r["million_steps_per_s"] for r in rows if r["batch"] == members}
        table.add_row(str(members), *(f"{own[name]:.2f}" for name in names))
    Console().print(table)


if __name__ == "__main__":
    main()
