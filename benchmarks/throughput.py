"""Plant-steps per second: the engine next to C and numba on the same closed loop, in one run.

The bench with the switched law, 0.30 rad step, 0.3 s at dt = 2e-4 s; half_gap differs from member
to member. C folds the same three metrics, numba only the largest angle; neither locates events.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import measuring
import numpy as np
from compiled_reference import compiler, reference
from numba_loop import run as numba_run

import jaxsim
from jaxsim.hybrid import Deadzone

BATCHES = (1, 256, 4096, 65536)
ENOUGH = 4096  # numba takes 12 s for the largest batch, and is no faster per drive
METRICS = ("itae_rad_s2", "largest_torque_Nm", "overshoot_rad")
MODES = {"plain": jaxsim.Plain(), "exact": jaxsim.Exact(), "smoothed": jaxsim.Smoothed()}


def engine(deadzone: Deadzone, members: int, dtype: str) -> Callable[[], Any]:
    """A call that runs the batch and waits for its metrics."""
    study = jaxsim.load("bench_switched")
    drives = jaxsim.spread(study.drive, half_gap=half_gaps(members))
    options: dict[str, Any] = {
        "dt": study.run.dt,
        "deadzone": deadzone,
        "metrics": METRICS,
        "store": None,
        "dtype": dtype,
        "throw": False,
    }

    def call() -> Any:
        done = jaxsim.simulate(drives, study.law, study.scenario, **options)
        return jax.block_until_ready(done.metrics)

    return call


def half_gaps(members: int) -> np.ndarray:
    return 7.8e-3 * np.linspace(0.8, 1.2, members)


def calls(members: int, steps: int, dt: float) -> dict[str, Callable[[], Any]]:
    """Everything that is timed at one batch size, by name."""
    found = {
        f"{mode} {dtype}": engine(deadzone, members, dtype)
        for mode, deadzone in MODES.items()
        for dtype in ("float64", "float32")
    }
    if members <= ENOUGH:
        found["numba, 1 thread"] = lambda: numba_run(half_gaps(members), steps, dt)
    if compiler() is None:
        return found
    for dtype in ("float64", "float32"):
        for threads in (1, 2):
            gaps = half_gaps(members).astype(dtype)
            found[f"C {dtype}, {threads} thread(s)"] = reference(gaps, steps, dt, threads=threads)
    return found


def main() -> None:
    jaxsim.configure()
    study = jaxsim.load("bench_switched")
    steps = round(study.scenario.duration / study.run.dt)
    rows, ratios = [], {}
    for members in measuring.progress(BATCHES, "Throughput ..."):
        timings = measuring.interleaved(
            calls(members, steps, study.run.dt), repeats=3 if members > 10_000 else 5
        )
        rate = {name: members * steps / t.best_s / 1e6 for name, t in timings.items()}
        rows += [
            {"batch": members, "what": n, "M_steps_per_s": rate[n], "first_call_s": t.first_s}
            for n, t in timings.items()
        ]
        ratios |= _ratios(members, rate)
    measuring.save("throughput", {"rows": rows}, ratios)


def _ratios(members: int, rate: dict[str, float]) -> dict[str, float]:
    found = {
        f"exact of plain, float64, {members}": rate["exact float64"] / rate["plain float64"],
    }
    if "numba, 1 thread" in rate:
        found[f"exact of numba, {members}"] = rate["exact float64"] / rate["numba, 1 thread"]
    for dtype in ("float64", "float32"):
        best = max((rate[n] for n in rate if n.startswith(f"C {dtype}")), default=None)
        if best is not None:
            for mode in ("plain", "exact"):
                found[f"{mode} of C, {dtype}, {members}"] = rate[f"{mode} {dtype}"] / best
    return found


if __name__ == "__main__":
    main()
