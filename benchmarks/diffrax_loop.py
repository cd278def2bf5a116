"""diffrax on the bench's closed loop, in a process that another one talks to.

    peak SOLVER SETTING   the largest joint torque of the study's drive, from the interpolant, Nm
    run SOLVER SETTING    BATCH drives to the end, without looking for the torque; answers 0

SOLVER is Tsit5, with its relative tolerance as setting, or Heun, with its step in s. JAX is as its
users have it: float64, none of our compiler options (jaxlib 0.10 dies on Tsit5 with them, and Heun
is no faster).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import closed_loop
import diffrax
import jax
import jax.numpy as jnp
import numpy as np

BATCH = 1024
GAPS = 7.8e-3 * np.linspace(0.8, 1.2, BATCH)
FINE = 20_001
SPAN = closed_loop.END - closed_loop.AT


@cache
def solved(solver: str, setting: float, *, fine: bool) -> Callable[[Any], Any]:
    """States of a batch: at the end, or on a fine grid."""
    seen = diffrax.SaveAt(ts=jnp.linspace(0.0, SPAN, FINE)) if fine else diffrax.SaveAt(t1=True)
    if solver == "Heun":
        method, control, dt = diffrax.Heun(), diffrax.ConstantStepSize(), setting
    else:
        control = diffrax.PIDController(rtol=setting, atol=1e-2 * setting)
        method, dt = diffrax.Tsit5(), None

    def one(half_gap: Any) -> Any:
        done = diffrax.diffeqsolve(
            diffrax.ODETerm(closed_loop.jax_field),
            method,
            0.0,
            SPAN,
            dt,
            tuple(jnp.zeros(()) for _ in range(6)),
            args=half_gap,
            saveat=seen,
            stepsize_controller=control,
            max_steps=4096,
        )
        return done.ys

    return jax.jit(jax.vmap(one))


def peak(solver: str, setting: float) -> float:
    """The largest joint torque of the study's drive, Nm."""
    states = np.array(solved(solver, setting, fine=True)(jnp.array([closed_loop.HALF_GAP])))
    return closed_loop.peak(states[:, 0])


def run(solver: str, setting: float) -> float:
    """All drives to the end."""
    jax.block_until_ready(solved(solver, setting, fine=False)(jnp.asarray(GAPS)))
    return 0.0


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    for line in sys.stdin:
        what, solver, setting = line.split()
        print({"peak": peak, "run": run}[what](solver, float(setting)), flush=True)


if __name__ == "__main__":
    main()
