"""Plant-steps per second: the engine next to C and numba on the same closed loop, in one run.

The bench with the switched law, 0.30 rad step, 0.3 s at dt = 2e-4 s; half_gap differs from member
to member. C folds the same three metrics, numba only the largest angle; neither locates events.
Small batches run for 6 s as well: what a call costs before its first step is a millisecond.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import measuring
import numpy as np
from compiled_reference import BENCH, compiler, reference
from numba_loop import run as numba_run

import jaxsim
from jaxsim.hybrid import Deadzone

SHORT, LONG = 0.3, 6.0
CASES = ((1, SHORT), (256, SHORT), (4096, SHORT), (65536, SHORT), (1, LONG), (256, LONG))
ENOUGH = 4096  # numba takes 12 s for the largest batch, and is no faster per drive
METRICS = ("itae_rad_s2", "largest_torque_Nm", "overshoot_rad")
MODES = {"plain": jaxsim.Plain(), "exact": jaxsim.Exact(), "smoothed": jaxsim.Smoothed()}


def engine(deadzone: Deadzone, members: int, duration: float, dtype: str) -> Callable[[], Any]:
    """A call that runs the batch and waits for its metrics."""
    study = jaxsim.load("bench_switched")
    scenario = replace(study.scenario, duration=duration)
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
        done = jaxsim.simulate(drives, study.law, scenario, **options)
        return jax.block_until_ready(done.metrics)

    return call


def half_gaps(members: int) -> np.ndarray:
    return 7.8e-3 * np.linspace(0.8, 1.2, members)


def calls(members: int, duration: float, dt: float) -> dict[str, Callable[[], Any]]:
    """Everything that is timed in one case, by name."""
    steps = round(duration / dt)
    found = {
        f"{mode} {dtype}": engine(deadzone, members, duration, dtype)
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
            found[f"C {dtype}, {threads} thread(s)"] = reference(
                BENCH, gaps, steps, dt, threads=threads
            )
    return found


def main() -> None:
    jaxsim.configure()
    dt = jaxsim.load("bench_switched").run.dt
    rows, ratios = [], {}
    for members, duration in measuring.progress(CASES, "Throughput ..."):
        steps = round(duration / dt)
        timings = measuring.interleaved(
            calls(members, duration, dt), repeats=3 if members > 10_000 else 5
        )
        rate = {name: members * steps / t.best_s / 1e6 for name, t in timings.items()}
        rows += [
            {
                "batch": members,
                "steps": steps,
                "what": n,
                "M_steps_per_s": rate[n],
                "first_call_s": t.first_s,
            }
            for n, t in timings.items()
        ]
        case = f"{members}" if duration == SHORT else f"{members}, {steps} steps"
        ratios |= _ratios(case, rate)
    measuring.save("throughput", {"rows": rows}, ratios)


def _ratios(case: str, rate: dict[str, float]) -> dict[str, float]:
    found = {
        f"exact of plain, float64, {case}": rate["exact float64"] / rate["plain float64"],
    }
    if "numba, 1 thread" in rate:
        found[f"exact of numba, {case}"] = rate["exact float64"] / rate["numba, 1 thread"]
    for dtype in ("float64", "float32"):
        best = max((rate[n] for n in rate if n.startswith(f"C {dtype}")), default=None)
        if best is not None:
            for mode in ("plain", "exact"):
                found[f"{mode} of C, {dtype}, {case}"] = rate[f"{mode} {dtype}"] / best
    return found


if __name__ == "__main__":
    main()
