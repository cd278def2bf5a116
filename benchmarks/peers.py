"""Env-seconds per wall second against what people use today, at equal accuracy, in one run.

The bench with the switched law, 0.3 s. Every method is first set to the loosest tolerance or step
from which on the largest joint torque is right to ACCURACY; that setting is timed. diffrax's Heun
and plain mode run at the same fixed step, whatever their accuracy. Engine and diffrax run BATCH
drives at once, the others one after another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import closed_loop
import jax
import jax.numpy as jnp
import measuring
import numpy as np
from numba_loop import peak as numba_peak
from scipy.integrate import solve_ivp

import jaxsim

ACCURACY = 1e-5
BATCH = 1024
FIXED = 2e-4
SPAN = closed_loop.END - closed_loop.AT
GAPS = 7.8e-3 * np.linspace(0.8, 1.2, BATCH)
METRICS = ("largest_torque_Nm",)
STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)


def engine(dt: float, deadzone: Any, half_gap: Any) -> Any:
    """Largest joint torque by the engine, Nm."""
    study = jaxsim.load("bench_switched")
    drives = jaxsim.spread(study.drive, half_gap=np.atleast_1d(half_gap))
    run = jaxsim.simulate(
        drives,
        study.law,
        study.scenario,
        dt=dt,
        deadzone=deadzone,
        metrics=METRICS,
        store=None,
        throw=False,
    )
    return jax.block_until_ready(run.metrics[METRICS[0]])


def scipy_peak(method: str, tolerance: float) -> float:
    """Largest joint torque over the steps that SciPy took, refined eightfold by its interpolant."""
    done = solve_ivp(
        closed_loop.field,
        (0.0, SPAN),
        np.zeros(6),
        method=method,
        rtol=tolerance,
        atol=1e-2 * tolerance,
        dense_output=True,
    )
    fine = np.interp(np.arange(8 * len(done.t)) / 8.0, np.arange(len(done.t)), done.t)
    return closed_loop.peak(done.sol(fine))


def control_peak(tolerance: float) -> float:
    """Largest joint torque by python-control, which hands the loop to SciPy."""
    import control

    plant = control.nlsys(
        lambda t, x, u, params: np.array(closed_loop.field(t, x)), inputs=0, states=6
    )
    time = np.arange(0.0, SPAN, 1e-4)
    done = control.input_output_response(
        plant,
        time,
        solve_ivp_method="RK45",
        solve_ivp_kwargs={"rtol": tolerance, "atol": 1e-2 * tolerance},
    )
    return closed_loop.peak(np.asarray(done.states))


def diffrax_peaks(solver: Any, control: Any, dt: float | None) -> Callable[[Any], Any]:
    """Largest joint torques of a batch by diffrax, seen at every step it takes, Nm."""
    import diffrax

    term = diffrax.ODETerm(closed_loop.jax_field)

    def one(half_gap: Any) -> Any:
        start = tuple(jnp.zeros(()) for _ in range(6))
        done = diffrax.diffeqsolve(
            term,
            solver,
            0.0,
            SPAN,
            dt,
            start,
            args=half_gap,
            saveat=diffrax.SaveAt(steps=True),
            stepsize_controller=control,
            max_steps=4096,
        )
        _, _, _, theta_B, _, _ = states = done.ys
        rate = closed_loop.D_B * (states[1] - states[0])
        above = jnp.where(theta_B >= half_gap, rate + closed_loop.K * (theta_B - half_gap), 0.0)
        return jnp.max(jnp.where(jnp.isfinite(above), above, 0.0))

    return jax.jit(jax.vmap(one))


def loosest(
    settings: Iterable[float], peak: Callable[[float], float], truth: float
) -> float | None:
    """The first setting from which on the peak is right to ACCURACY; None if none is."""
    settings = tuple(settings)
    right = [abs(peak(s) / truth - 1.0) <= ACCURACY for s in settings]
    last_wrong = max((i for i, fine in enumerate(right) if not fine), default=-1)
    return settings[last_wrong + 1] if last_wrong + 1 < len(settings) else None


def settings() -> dict[str, float | None]:
    """Of each method the loosest step (fixed) or tolerance (adaptive) that is accurate enough."""
    exact = jaxsim.Exact()
    truth = float(engine(2e-5, exact, closed_loop.HALF_GAP)[0])
    one = np.array([closed_loop.HALF_GAP])
    return {
        "engine, exact": loosest(STEPS[:5], lambda h: float(engine(h, exact, one)[0]), truth),
        "numba RK4": loosest(STEPS, lambda h: float(numba_peak(one, h)[0]), truth),
        "scipy LSODA": loosest(TOLERANCES, lambda r: scipy_peak("LSODA", r), truth),
        "scipy RK45": loosest(TOLERANCES, lambda r: scipy_peak("RK45", r), truth),
        "python-control": loosest(TOLERANCES, control_peak, truth),
        "diffrax Tsit5": loosest(TOLERANCES[:6], lambda r: float(tsit5(r)(one)[0]), truth),
    }


def tsit5(tolerance: float) -> Callable[[Any], Any]:
    """diffrax's adaptive Tsit5 over a batch."""
    import diffrax

    control = diffrax.PIDController(rtol=tolerance, atol=1e-2 * tolerance)
    return diffrax_peaks(diffrax.Tsit5(), control, None)


def heun(dt: float) -> Callable[[Any], Any]:
    """diffrax's Heun over a batch, fixed step."""
    import diffrax

    return diffrax_peaks(diffrax.Heun(), diffrax.ConstantStepSize(), dt)


def calls(found: dict[str, float | None]) -> dict[str, tuple[int, Callable[[], Any]]]:
    """Name -> (drives, a call that runs them)."""
    exact, plain, gaps = jaxsim.Exact(), jaxsim.Plain(), jnp.asarray(GAPS)
    step, tolerance = found["engine, exact"], found["diffrax Tsit5"]
    adaptive, fixed = tsit5(tolerance or TOLERANCES[5]), heun(FIXED)
    return {
        "engine, exact": (BATCH, lambda: engine(step or STEPS[4], exact, GAPS)),
        "engine, plain, fixed step": (BATCH, lambda: engine(FIXED, plain, GAPS)),
        "numba RK4": (1, lambda: numba_peak(GAPS[:1], found["numba RK4"] or STEPS[-1])),
        "scipy LSODA": (1, lambda: scipy_peak("LSODA", found["scipy LSODA"] or TOLERANCES[-1])),
        "scipy RK45": (1, lambda: scipy_peak("RK45", found["scipy RK45"] or TOLERANCES[-1])),
        "python-control": (1, lambda: control_peak(found["python-control"] or TOLERANCES[-1])),
        "diffrax Tsit5": (BATCH, lambda: jax.block_until_ready(adaptive(gaps))),
        "diffrax Heun, fixed step": (BATCH, lambda: jax.block_until_ready(fixed(gaps))),
    }


def main() -> None:
    jaxsim.configure()
    found = settings()
    timed = calls(found)
    timings = measuring.interleaved({name: call for name, (_, call) in timed.items()}, repeats=3)
    rate = {name: closed_loop.END * timed[name][0] / t.best_s for name, t in timings.items()}
    rows = [
        {
            "what": name,
            "setting": found.get(name, FIXED),
            "drives": timed[name][0],
            "env_s_per_s": rate[name],
        }
        for name in timed
    ]
    mine = rate["engine, exact"]
    ratios = {f"exact of {name}": mine / rate[name] for name in found if name != "engine, exact"}
    ratios["plain of diffrax Heun, same step"] = (
        rate["engine, plain, fixed step"] / rate["diffrax Heun, fixed step"]
    )
    measuring.save("peers", rows, ratios)


if __name__ == "__main__":
    main()
