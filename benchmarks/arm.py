"""Arm-steps per second: the engine next to C with the same mathematics, in one run.

The two-link arm of the 2014 paper under PI torque control, 1 s at 2.5e-4 s, float64; the
stiffness of joint 1 differs from arm to arm. Both give the RMS torque errors, and have to agree.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import measuring
import numpy as np
from compiled_reference import ARM, compiler, reference

import jaxsim
from jaxsim.hybrid import Deadzone

ARMS = 1024
METRIC = "torque_error_rms_Nm"
MODES = {"plain": jaxsim.Plain(), "exact": jaxsim.Exact()}
AGREED = 1e-5  # relative; C sums the square over the ticks


def stiffnesses() -> np.ndarray:
    return 912.0 * np.linspace(0.9, 1.1, ARMS)


def engine(deadzone: Deadzone) -> Callable[[], np.ndarray]:
    """A call that runs the arms and returns the RMS errors, (arms, joints)."""
    study = jaxsim.load("arm_torque")
    law = study.law.laws[0]  # without the positive feedback
    arms = jaxsim.spread(study.drive, **{"transmission[0]__K": stiffnesses()})
    options: dict[str, Any] = {"dt": study.run.dt, "metrics": (METRIC,), "store": None}

    def call() -> np.ndarray:
        run = jaxsim.simulate(arms, law, study.scenario, deadzone=deadzone, **options)
        return np.asarray(jax.block_until_ready(run.metrics[METRIC]))

    return call


def main() -> None:
    jaxsim.configure()
    study = jaxsim.load("arm_torque")
    dt, duration = study.run.dt, study.scenario.duration
    steps = round(duration / dt)
    calls: dict[str, Callable[[], Any]] = {m: engine(deadzone) for m, deadzone in MODES.items()}
    if compiler() is not None:
        for threads in (1, 2):
            made = reference(ARM, stiffnesses(), steps, dt, threads=threads)
            error = np.max(np.abs(np.sqrt(made().T / duration) / calls["plain"]() - 1.0))
            assert error < AGREED, f"C and the engine differ by {error:.1e}"
            calls[f"C, {threads} thread(s)"] = made
    timings = measuring.interleaved(calls)
    rate = {name: ARMS * steps / t.best_s / 1e6 for name, t in timings.items()}
    rows = [{"what": name, "M_steps_per_s": value} for name, value in rate.items()]
    best = max((v for name, v in rate.items() if name.startswith("C")), default=None)
    ratios = {f"{mode} of C": rate[mode] / best for mode in MODES} if best else {}
    measuring.save("arm", {"rows": rows}, ratios)


if __name__ == "__main__":
    main()
