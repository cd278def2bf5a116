"""Gradients through contact and switching, against central differences of the oracle."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import bench
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracle
import pytest

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.hybrid import Deadzone, Exact, Plain

LAWS = ("none", "linear", "switched")
GAINS, PHYSICAL = ("K_B", "K_P", "K_D", "tau_D"), ("half_gap", "K", "D_B", "J_L")
NAMES = GAINS + PHYSICAL
METRICS = {
    "first_impact_Nm": "first_impact_peak_Nm",
    "itae_rad_s2": "ITAE_rad_s2",
    "overshoot_rad": "overshoot_rad",
    "braking_peak_Nm": "braking_peak_Nm",
}
OBJECTIVES = (*METRICS, "sum_of_squares")
ITAE = OBJECTIVES.index("itae_rad_s2")

DT = 2e-4
SAMPLES = np.linspace(0.001, 0.3, 300)
SIZES = np.array([[0.01], [0.01], [0.3]])  # of theta_L, theta_M, T_s
DETUNED = 1.05

# What issue 2 asks for.
L2, OWN, SHARE = 1e-3, 1e-2, 1e-4
# Steps of the differences. T_s jumps at contact, so the sum of squares jumps where an event
# passes a sample: a step of 1e-5 on K_B = 0 does, and is off by 7 %; 1e-6 and 1e-8 agree to 1e-7.
STEP = 1e-6
# Measured 1e-14 to 1e-13.
REVERSE = 1e-10


def gains_of(kind: str) -> oracle.Params:
    """The law 'none' is the linear one at K_B = 0, so that it has a derivative in K_B."""
    return replace(bench.PAPER, K_B=0.0) if kind == "none" else bench.PAPER


def scales(p: oracle.Params) -> np.ndarray:
    """The size of each parameter, and 0.8 for K_B = 0."""
    return np.array([abs(getattr(p, name)) or 0.8 for name in NAMES])


# The oracle.


def solve(kind: str, p: oracle.Params) -> oracle.Solution:
    return oracle.solve(p, "switched" if kind == "switched" else "linear")


def samples(run: oracle.Solution) -> np.ndarray:
    x = run.state(SAMPLES)
    return np.stack([x[:, 2], x[:, 2] + x[:, 3], run.torque(SAMPLES)]) / SIZES


@cache
def record(kind: str) -> np.ndarray:
    """What a drive with every parameter 5 % larger does."""
    p = gains_of(kind)
    return samples(solve(kind, replace(p, **{n: DETUNED * getattr(p, n) for n in NAMES})))


def expected_values(kind: str, p: oracle.Params) -> np.ndarray:
    run = solve(kind, p)
    numbers = run.metrics()
    squares = np.sum((samples(run) - record(kind)) ** 2)
    return np.array([*(numbers[name] for name in METRICS.values()), squares])


@cache
def expected_gradient(kind: str) -> np.ndarray:
    """(objectives, parameters): p_i dJ/dp_i."""
    p = gains_of(kind)
    columns = []
    for name, size in zip(NAMES, scales(p), strict=True):
        up, down = (
            expected_values(kind, replace(p, **{name: getattr(p, name) + sign * STEP * size}))
            for sign in (1, -1)
        )
        columns.append((up - down) / (2.0 * STEP))
    return np.stack(columns, axis=1)


# The package.


def objectives(values: Any, law: Any, data: Any, deadzone: Deadzone, dt: float) -> Any:
    """All objectives as one vector, and once more as what the run says besides."""
    given = dict(zip(NAMES, values, strict=True))
    run = simulate(
        tree.replace(bench.drive(), {n: given[n] for n in PHYSICAL}),
        tree.replace(law, {n: given[n] for n in GAINS}),
        bench.scenario(),
        dt=dt,
        deadzone=deadzone,
        metrics=tuple(METRICS),
        store=round(1e-3 / dt),
    )
    s = run.signals
    seen = jnp.stack([s["theta_L"], s["theta_M"], s["T_s"]])[:, 1:] / SIZES
    numbers = [run.metrics[name] for name in METRICS]
    vector = jnp.stack([*numbers, jnp.sum((seen - data) ** 2)])
    return vector, vector


@eqx.filter_jit
def values_only(*args: Any) -> Any:
    return objectives(*args)[0]


@eqx.filter_jit
def forward(*args: Any) -> Any:
    return jax.jacfwd(objectives, has_aux=True)(*args)


@eqx.filter_jit
def reverse(*args: Any) -> Any:
    return jax.jacrev(objectives, has_aux=True)(*args)


class Found(NamedTuple):
    """values (objectives,) and gradient (objectives, parameters), scaled."""

    values: np.ndarray
    gradient: np.ndarray


def arguments(kind: str, deadzone: Deadzone, dt: float) -> tuple:
    p = gains_of(kind)
    point = jnp.array([getattr(p, name) for name in NAMES])
    return point, bench.law(kind, p), jnp.asarray(record(kind)), deadzone, dt


def run(function: Any, kind: str, deadzone: Deadzone, dt: float) -> Found:
    gradient, values = function(*arguments(kind, deadzone, dt))
    return Found(np.asarray(values), np.asarray(gradient) * scales(gains_of(kind)))


@cache
def located(kind: str) -> Found:
    return run(forward, kind, Exact(), DT)


@pytest.mark.parametrize("kind", LAWS)
def test_scaled_gradients_are_those_of_the_oracle(kind: str) -> None:
    found, expected = located(kind).gradient, expected_gradient(kind)
    error = np.abs(found - expected)
    norm = np.linalg.norm(expected, axis=1)
    relative = dict(zip(OBJECTIVES, np.linalg.norm(error, axis=1) / norm, strict=True))
    assert max(relative.values()) <= L2, relative
    allowed = np.maximum(OWN * np.abs(expected), SHARE * norm[:, None])
    assert np.all(error <= allowed), [
        (OBJECTIVES[i], NAMES[j], found[i, j], expected[i, j])
        for i, j in np.argwhere(error > allowed)
    ]


@pytest.mark.parametrize("kind", LAWS)
def test_reverse_mode_is_forward_mode_and_neither_changes_a_value(kind: str) -> None:
    there, back = located(kind), run(reverse, kind, Exact(), DT)
    norm = np.linalg.norm(there.gradient, axis=1, keepdims=True)
    assert np.all(np.abs(back.gradient - there.gradient) <= REVERSE * norm)
    plain = np.asarray(values_only(*arguments(kind, Exact(), DT)))
    # Equal but for what the compiler contracts differently: a few units in the last place.
    assert there.values == pytest.approx(plain, rel=1e-12)
    assert back.values == pytest.approx(plain, rel=1e-12)


def test_gradients_without_location_are_wrong_however_small_the_step() -> None:
    """Why exact mode exists: the saltation term is missing, and a smaller dt does not bring it.

    Measured for ITAE: 2040 times the true gradient at dt, 2240 times at dt/4; d(first impact)/d
    half_gap is 0.49 and 0.66 of the true one.
    """
    expected = expected_gradient("switched")
    gradient = run(forward, "switched", Plain(), 0.25 * DT).gradient
    norm = np.linalg.norm(expected, axis=1)
    error = np.linalg.norm(gradient - expected, axis=1) / norm
    assert error[ITAE] > 100.0, dict(zip(OBJECTIVES, error, strict=True))
