"""Identification side by side: scipy's least_squares over solve_ivp with events, ours, optimistix.

    python benchmarks/identification_against_scipy.py

The same simulated log of the bench (0.3 s at 1 kHz, 20-bit encoders, torque noise 0.01 Nm), the
same start, 30 % off in half_gap, K, D_B and J_L, the same legs of a growing horizon. scipy gets
what an engineer would write: one affine field per contact mode, events on the walls, DOP853,
derivatives by differences. The third one is the Levenberg-Marquardt of optimistix on our engine
with forward derivatives, all of a leg in one compiled program. Wall times without compilation,
which is told apart; the optima must agree.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import jaxsim
from jaxsim import tree
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.laws.feedforward import Feedforward
from jaxsim.scenario import Scenario
from jaxsim.signals.chirp import Chirp
from tuning.identification.estimator import STAGES, fit
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.residuals import Problem
from tuning.identification.unknowns import free

NAMES = ("half_gap", "K", "D_B", "J_L")
J_M, D_M, D_L = 8.78e-4, 9.30e-2, 3.60e-2
DURATION, PERIOD = 0.3, 1e-3
COUNT = 2.0 * np.pi / 2**20
TORQUE_NOISE = 0.01
NOISE = np.array([COUNT / np.sqrt(12.0), COUNT / np.sqrt(12.0), TORQUE_NOISE])
WRONG = np.array([1.3, 0.7, 1.3, 0.7])
CHIRP = {"amplitude": 1.5, "f0": 5.0, "f1": 40.0}


class Answer(NamedTuple):
    """Estimates, loss (half the sum of squared residuals), wall and processor time in s."""

    values: np.ndarray
    loss: float
    seconds: float
    busy: float


def torque(t: float) -> float:
    """The chirp of the log, Nm, as jaxsim.signals.chirp defines it."""
    rate = (CHIRP["f1"] - CHIRP["f0"]) / DURATION
    return CHIRP["amplitude"] * np.sin(2.0 * np.pi * (CHIRP["f0"] + 0.5 * rate * t) * t)


def simulated(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(3, n) theta_M, theta_L and T_s of the two inertias, located by solve_ivp's events."""
    half_gap, K, D_B, J_L = values
    found = np.full((3, len(times)), np.nan)
    t, x, mode = 0.0, np.zeros(4), 0  # theta_L, omega_L, theta_B, omega_B

    def joint(x: np.ndarray, mode: int) -> Any:
        return mode**2 * (K * (x[2] - mode * half_gap) + D_B * x[3])

    while t < times[-1]:

        def field(t: float, x: np.ndarray, mode: int = mode) -> list[float]:
            T_s = joint(x, mode)
            load = (T_s - D_L * x[1]) / J_L
            motor = (torque(t) - T_s - D_M * (x[1] + x[3])) / J_M
            return [x[1], load, x[3], motor - load]

        walls = [_wall(side, half_gap, mode) for side in (-1, 1)]
        events = [w for side, w in zip((-1, 1), walls, strict=True) if mode in (0, side)]
        done = solve_ivp(
            field, (t, times[-1]), x, "DOP853", dense_output=True, events=events,
            rtol=1e-9, atol=1e-12,
        )  # fmt: skip
        inside = (times >= t) & (times <= done.t[-1])
        if inside.any():
            there = done.sol(times[inside])
            found[:, inside] = there[0] + there[2], there[0], joint(there, mode)
        hits = [i for i, e in enumerate(done.t_events) if len(e)]
        if not hits:
            break
        t, x = done.t[-1], done.y[:, -1].copy()
        side = (-1, 1)[hits[0]] if mode == 0 else mode
        x[2] = side * half_gap
        mode = side if mode == 0 else 0
    return found


def _wall(side: int, half_gap: float, mode: int) -> Any:
    def wall(t: float, x: np.ndarray, *_: Any) -> float:
        return x[2] - side * half_gap

    wall.terminal = True  # type: ignore[attr-defined]
    wall.direction = side if mode == 0 else -side  # type: ignore[attr-defined]
    return wall


def fastest(search: Callable[[], tuple[np.ndarray, float]], repeats: int) -> Answer:
    """The answer, and the least wall and the least processor time of several searches."""
    spent = []
    for _ in range(repeats):
        begun = time.perf_counter(), time.process_time()
        values, loss = search()
        spent.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    return Answer(values, loss, *np.min(spent, axis=0).tolist())


def by_scipy(
    times: np.ndarray, readings: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, float]:
    scaled = np.ones(len(start))
    for stage in STAGES:
        kept = times <= stage.horizon * times[-1] + 1e-9

        def residuals(z: np.ndarray, kept: np.ndarray = kept) -> np.ndarray:
            model = simulated(z * start, times[kept])
            return ((model - readings[:, kept]) / NOISE[:, None]).ravel()

        done = least_squares(
            residuals, scaled, "2-point", (0.2, 5.0), diff_step=1e-7, x_scale=0.1, ftol=1e-10
        )
        scaled = done.x
    return scaled * start, float(done.cost)


def by_us(times: np.ndarray, readings: np.ndarray, start: np.ndarray) -> tuple[Answer, float]:
    """Our answer, and the time to compile in s."""
    names = ("theta_M", "theta_L", "T_s")
    measured = tuple(
        measurement(n, times, v, s) for n, v, s in zip(names, readings, NOISE, strict=True)
    )
    chirp = Chirp(**CHIRP, duration=DURATION)
    asked = Scenario(chirp, duration=DURATION)
    log = Experiment("log", bench_2018(), Feedforward(), asked, measured)
    unknown = [free(log, n, 0.2 * v, 5.0 * v) for n, v in zip(NAMES, start, strict=True)]
    problem = Problem([log], unknown, dt=2e-4)
    begun = time.perf_counter()
    problem.evaluate(start[None])
    compiling = time.perf_counter() - begun

    def search() -> tuple[np.ndarray, float]:
        found = fit(problem, start[None])
        return found.values[0], float(found.loss[0])

    return fastest(search, 5), compiling


def by_optimistix(
    times: np.ndarray, readings: np.ndarray, start: np.ndarray
) -> tuple[Answer, float]:
    """The answer of optimistix, in the logarithms of the values, and the time to compile in s."""
    scenario = Scenario(Chirp(**CHIRP, duration=DURATION), duration=DURATION)
    noise = jnp.asarray(NOISE)[:, None]

    def residuals(y: Any, end: Any) -> Any:
        values = dict(zip(NAMES, start * jnp.exp(y), strict=True))
        drive = tree.replace(bench_2018(), values)
        run = jaxsim.simulate(
            drive, Feedforward(), scenario, dt=2e-4, store=5, metrics=(), throw=False
        )
        seen = jnp.stack([run.signals[n][1:] for n in ("theta_M", "theta_L", "T_s")])
        return jnp.where(times <= end, (seen - readings) / noise, 0.0)

    solver = optimistix.LevenbergMarquardt(rtol=1e-9, atol=1e-9)

    @eqx.filter_jit
    def leg(y: Any, end: Any) -> Any:
        done = optimistix.least_squares(
            residuals, solver, y, args=end, options={"jac": "fwd"}, max_steps=50, throw=False
        )
        return done.value, 0.5 * jnp.sum(residuals(done.value, end) ** 2)

    def search() -> tuple[np.ndarray, float]:
        y, loss = jnp.zeros(len(NAMES)), jnp.inf
        for stage in STAGES:
            y, loss = leg(y, stage.horizon * times[-1] + 1e-9)
        return start * np.exp(np.asarray(y)), float(loss)

    begun = time.perf_counter()
    jax.block_until_ready(leg(jnp.zeros(len(NAMES)), jnp.asarray(0.0)))
    compiling = time.perf_counter() - begun
    return fastest(search, 5), compiling


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()  # type: ignore[union-attr]
    jaxsim.configure()
    truth = np.array([float(tree.get(bench_2018(), name)) for name in NAMES])
    times = PERIOD * np.arange(1, round(DURATION / PERIOD) + 1)
    exact = simulated(truth, times)
    noise = TORQUE_NOISE * np.random.default_rng(0).standard_normal(len(times))
    readings = np.stack([*(COUNT * np.round(exact[:2] / COUNT)), exact[2] + noise])
    ours, compiling = by_us(times, readings, WRONG * truth)
    general, also = by_optimistix(times, readings, WRONG * truth)
    theirs = fastest(lambda: by_scipy(times, readings, WRONG * truth), 2)
    print(
        "             "
        + "".join(f"{n:>14}" for n in NAMES)
        + "          loss      wall s       cpu s"
    )
    for name, answer in (("scipy", theirs), ("gearlash", ours), ("optimistix", general)):
        shown = "".join(f"{v:14.8g}" for v in answer.values)
        print(f"{name:>12} {shown}{answer.loss:14.6f}{answer.seconds:12.3f}{answer.busy:12.3f}")
    print(f"{'truth':>12} " + "".join(f"{v:14.8g}" for v in truth))
    ratios = theirs.seconds / ours.seconds, theirs.busy / ours.busy
    print(f"ratio of wall times {ratios[0]:.0f}, of processor times {ratios[1]:.0f}")
    print(f"compiling took {compiling:.1f} s more, of optimistix {also:.1f} s")
    apart = np.abs(ours.values / theirs.values - 1.0).max()
    print(f"estimates differ by {apart:.1e} at most")


if __name__ == "__main__":
    main()
