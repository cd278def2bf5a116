"""Env-seconds per wall second against what people use today, at equal accuracy, in one run.

The bench with the switched law, 0.3 s. Every method is first set to the loosest tolerance or step
from which on the largest joint torque is right to ACCURACY; that setting is timed. diffrax's Heun
and plain mode run at the same fixed step, whatever their accuracy. Engine and diffrax run BATCH
drives at once, the others one after another. diffrax is timed without looking for the torque.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import closed_loop
import jax
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


class Method(NamedTuple):
    """A way to run the loop. drives: that one call of `run(setting)` does.

    peak(setting): of the study's drive, Nm; None where the setting is fixed. settings: loose ones
    first.
    """

    drives: int
    run: Callable[[float], Any]
    settings: tuple[float, ...]
    peak: Callable[[float], float] | None = None


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


def scipy_run(method: str, tolerance: float) -> None:
    """The same without looking for the torque."""
    span, start = (0.0, SPAN), np.zeros(6)
    solve_ivp(closed_loop.field, span, start, method, rtol=tolerance, atol=1e-2 * tolerance)


def control_peak(tolerance: float) -> float:
    """Largest joint torque by python-control, which hands the loop to SciPy."""
    import control

    plant = control.nlsys(
        lambda t, x, u, params: np.array(closed_loop.field(t, x)), inputs=0, states=6
    )
    done = control.input_output_response(
        plant,
        np.arange(0.0, SPAN, 1e-4),
        solve_ivp_method="RK45",
        solve_ivp_kwargs={"rtol": tolerance, "atol": 1e-2 * tolerance},
    )
    return closed_loop.peak(np.asarray(done.states))


@contextlib.contextmanager
def diffrax() -> Iterator[Callable[[str], float]]:
    """Asks diffrax, which runs in a process of its own and so takes its turn among the others."""
    command = [sys.executable, str(Path(__file__).with_name("diffrax_loop.py"))]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        sent, answers = process.stdin, process.stdout

        def ask(words: str) -> float:
            print(words, file=sent, flush=True)
            return float(answers.readline())

        yield ask
        sent.close()


def methods(ask: Callable[[str], float]) -> dict[str, Method]:
    """All of them by name."""
    exact, plain, one = jaxsim.Exact(), jaxsim.Plain(), np.array([closed_loop.HALF_GAP])
    return {
        "engine, exact": Method(
            BATCH, lambda h: engine(h, exact, GAPS), STEPS[:5],
            lambda h: float(engine(h, exact, one)[0]),
        ),
        "engine, plain, fixed step": Method(BATCH, lambda h: engine(h, plain, GAPS), (FIXED,)),
        "numba RK4": Method(
            1, lambda h: numba_peak(one, h), STEPS, lambda h: float(numba_peak(one, h)[0])
        ),
        **{
            f"scipy {name}": Method(
                1, lambda r, n=name: scipy_run(n, r), TOLERANCES,
                lambda r, n=name: scipy_peak(n, r),
            )
            for name in ("LSODA", "RK45")
        },
        "python-control": Method(1, control_peak, TOLERANCES, control_peak),
        "diffrax Tsit5": Method(
            BATCH, lambda r: ask(f"run Tsit5 {r}"), TOLERANCES[:7],
            lambda r: ask(f"peak Tsit5 {r}"),
        ),
        "diffrax Heun, fixed step": Method(BATCH, lambda h: ask(f"run Heun {h}"), (FIXED,)),
    }  # fmt: skip


def loosest(method: Method, truth: float) -> float | None:
    """The first setting from which on the peak is right to ACCURACY; None if none is."""
    if method.peak is None:
        return method.settings[0]
    right = [abs(method.peak(s) / truth - 1.0) <= ACCURACY for s in method.settings]
    last_wrong = max((i for i, fine in enumerate(right) if not fine), default=-1)
    return next(iter(method.settings[last_wrong + 1 :]), None)


def main() -> None:
    jaxsim.configure()
    truth = float(engine(2e-5, jaxsim.Exact(), closed_loop.HALF_GAP)[0])
    with diffrax() as ask:
        every = methods(ask)
        names = measuring.progress(every, "Settings ...")
        found = {name: loosest(every[name], truth) for name in names}
        # Of one that is never accurate enough, the finest setting flatters it.
        used = {n: every[n].settings[-1] if s is None else s for n, s in found.items()}
        calls = {n: (lambda m=m, s=used[n]: m.run(s)) for n, m in every.items()}
        timings = measuring.interleaved(calls)
    rate = {n: closed_loop.END * every[n].drives / t.best_s for n, t in timings.items()}
    rows = [
        {
            "what": name,
            "setting": used[name],
            "peak": _reached(method, found[name]),
            "drives": method.drives,
            "env_s_per_s": rate[name],
        }
        for name, method in every.items()
    ]
    measuring.save("peers", {"rows": rows}, _ratios(rate))


def _reached(method: Method, setting: float | None) -> str:
    """How right the setting is that was timed."""
    if method.peak is None:
        return "not asked"
    return f"not to {ACCURACY:g}" if setting is None else f"to {ACCURACY:g}"


def _ratios(rate: dict[str, float]) -> dict[str, float]:
    plain, heun = "engine, plain, fixed step", "diffrax Heun, fixed step"
    others = [n for n in rate if n not in ("engine, exact", plain, heun)]
    found = {f"exact of {name}": rate["engine, exact"] / rate[name] for name in others}
    return found | {"plain of diffrax Heun, same step": rate[plain] / rate[heun]}


if __name__ == "__main__":
    main()
