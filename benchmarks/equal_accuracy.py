"""What a run costs in each mode when all have to be right to 1e-5 at the peaks.

64 benches with the switched law, 0.30 rad step, 0.3 s, half_gap differing from one to the next. The
error of a step is the largest over the drives of |value/true - 1|, of the largest |T_s| and of
the overshoot; true is exact mode at 2.5e-5 s (tests/test_values.py holds it to the oracle). Plain
mode converges erratically, O(dt): its steps are halved until ALL shorter ones measured are right.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import measuring
import numpy as np

import jaxsim
from jaxsim.hybrid import Deadzone

DRIVES = 64
WANTED = 1e-5
PEAKS = ("largest_torque_Nm", "overshoot_rad")
TRUE_DT = 2.5e-5
STEPS = {
    "exact": (jaxsim.Exact(), [2e-3 / 2**k for k in range(6)]),
    "plain": (jaxsim.Plain(), [2e-4 / 2**k for k in range(12)]),
}


def peaks(deadzone: Deadzone, dt: float) -> np.ndarray:
    """The peaks of all drives, (peaks, drives)."""
    study = jaxsim.load("bench_switched")
    drives = jaxsim.spread(study.drive, half_gap=7.8e-3 * np.linspace(0.8, 1.2, DRIVES))
    run = jaxsim.simulate(
        drives, study.law, study.scenario, dt=dt, deadzone=deadzone, metrics=PEAKS, store=None
    )
    return np.array([jax.block_until_ready(run.metrics[name]) for name in PEAKS])


def enough(rows: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The longest step such that it and all shorter ones are right; None if there is none."""
    right = None
    for row in reversed(rows):
        if row["error"] > WANTED:
            break
        right = row
    return right


def main() -> None:
    jaxsim.configure()
    true, rows, found = peaks(jaxsim.Exact(), TRUE_DT), [], {}
    for mode, (deadzone, lengths) in STEPS.items():
        own = []
        for dt in measuring.progress(lengths, f"Equal accuracy, {mode} ..."):
            error = float(np.max(np.abs(peaks(deadzone, dt) / true - 1.0)))
            best = measuring.interleaved({mode: lambda d=deadzone, h=dt: peaks(d, h)}, 3)[mode]
            own.append({"mode": mode, "dt_s": dt, "error": error, "ms": 1e3 * best.best_s})
        rows += own
        found[mode] = enough(own)
    measuring.save("equal_accuracy", {"rows": rows}, _ratio(found, rows[-1]))


def _ratio(found: dict[str, Any], last: dict[str, Any]) -> dict[str, float]:
    exact, plain = found["exact"], found["plain"]
    if exact is None:
        return {}
    if plain is None:
        return {"plain, not there yet at its shortest step, of exact": last["ms"] / exact["ms"]}
    return {"plain of exact, time to 1e-5": plain["ms"] / exact["ms"]}


if __name__ == "__main__":
    main()
