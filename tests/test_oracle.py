"""The oracle that everything else is judged by, judged itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import oracle
import pytest
from scipy.integrate import solve_ivp

REFERENCE = Path(__file__).parents[2] / "shared" / "reference" / "two_inertia_step.json"
LAWS = ("none", "linear", "switched")

# Peaks and times of the two agree to 2e-12.
FILE_TOLERANCE = 1e-11
# The file's IAE and ITAE are sums over a grid: with 4.8 million points the trapezoidal rule agrees
# with the oracle to 1e-14, and differs from the file by as much as the oracle does, 1.4e-8.
FILE_INTEGRALS = 2e-8
# Its names of the parameters, and the sizes to which its sensitivities are compared.
NAMES = {
    "JM": "J_M", "DM": "D_M", "K": "K", "DB": "D_B", "JL": "J_L", "DL": "D_L",
    "beta": "half_gap", "KP": "K_P", "KD": "K_D", "tau": "tau_D", "KB": "K_B",
}  # fmt: skip
GRADIENTS = "first_impact_peak_Nm", "braking_peak_Nm", "theta_max_rad"

needs_reference = pytest.mark.skipif(
    not REFERENCE.exists(), reason=f"the reference values are not here: {REFERENCE}"
)


@needs_reference
@pytest.mark.parametrize("law", LAWS)
def test_agrees_with_the_reference_file(law: oracle.Law) -> None:
    expected = json.loads(REFERENCE.read_text())["step"][law]
    found = oracle.solve(oracle.Params(), law, duration=1.2).metrics()
    for name, value in expected.items():
        tolerance = FILE_INTEGRALS if "AE_" in name else FILE_TOLERANCE
        assert found[name] == pytest.approx(value, rel=tolerance), name


@needs_reference
def test_differences_agree_with_the_sensitivities_of_the_reference_file() -> None:
    expected = json.loads(REFERENCE.read_text())["gradient_linear_law"]

    def values(p: oracle.Params) -> list[float]:
        metrics = oracle.solve(p, "linear").metrics()
        return [metrics[name] for name in GRADIENTS]

    found = oracle.central_differences(values, oracle.Params(), list(NAMES.values()))
    scale = np.array([abs(getattr(oracle.Params(), name)) for name in NAMES.values()])
    ours = np.array([found[name] for name in NAMES.values()]).T * scale
    theirs = np.array([expected[name] for name in NAMES]).T * scale
    error = np.linalg.norm(ours - theirs, axis=1) / np.linalg.norm(theirs, axis=1)
    assert np.all(error < 1e-6), error


class _Signs(NamedTuple):
    """Carried modes: side of the gap in contact, signs of omega_B and omega_L."""

    side: int = 0
    omega_B: int = 1
    omega_L: int = 1


def _field(t: float, x: np.ndarray, signs: _Signs, kind: str, target: float) -> list[float]:
    p = oracle.Params()
    w_L, w_B, q_L, q_B, z, r = x
    T_s = p.K * (q_B - signs.side * p.half_gap) + p.D_B * w_B if signs.side else 0.0
    e = r - q_L
    on = kind == "linear" or signs.omega_B * signs.omega_L > 0
    T_M = p.K_P * e + p.K_D * (e - z) / p.tau_D + (p.K_B * w_B if on else 0.0)
    a_L = (T_s - p.D_L * w_L) / p.J_L
    a_M = (T_M - p.D_M * (w_L + w_B) - T_s) / p.J_M
    return [a_L, a_M - a_L, w_L, w_B, (e - z) / p.tau_D, 2 * np.pi * p.f_ref * (target - r)]


def _surfaces(signs: _Signs, half_gap: float) -> list[tuple[Any, _Signs]]:
    """Guards that fall through zero when left, and the signs after it.

    A speed that is still exactly zero is no crossing.
    """
    s = signs
    speeds = [
        (lambda t, x, *_: s.omega_B * x[1] or 1e-300, s._replace(omega_B=-s.omega_B)),
        (lambda t, x, *_: s.omega_L * x[0] or 1e-300, s._replace(omega_L=-s.omega_L)),
    ]
    if s.side:
        return [(lambda t, x, *_: s.side * x[3] - half_gap, s._replace(side=0)), *speeds]
    walls = [(lambda t, x, *_, w=w: half_gap - w * x[3], s._replace(side=w)) for w in (1, -1)]
    return [*walls, *speeds]


def _integrate(kind: str, duration: float) -> np.ndarray:
    """The step by DOP853, restarted at every event and at the step; the final state."""
    t, x, signs = 0.0, np.zeros(6), _Signs()  # omega_L, omega_B, theta_L, theta_B, z, r
    while t < duration:
        target, until = (0.30, duration) if t >= 0.010 else (0.0, 0.010)
        surfaces = _surfaces(signs, oracle.Params().half_gap)
        for function, _ in surfaces:
            function.terminal, function.direction = True, -1
        run = solve_ivp(
            _field, (t, until), x, "DOP853", rtol=1e-12, atol=1e-14,
            events=[function for function, _ in surfaces], args=(signs, kind, target),
        )  # fmt: skip
        t, x = float(run.t[-1]), run.y[:, -1]
        for times, (_, after) in zip(run.t_events, surfaces, strict=True):
            signs = after if len(times) else signs
    return x


@pytest.mark.parametrize("law", ["linear", "switched"])
def test_agrees_with_an_adaptive_integration_stopped_at_every_event(law: oracle.Law) -> None:
    found = oracle.solve(oracle.Params(), law, duration=0.1).state(0.1)
    assert found == pytest.approx(_integrate(law, 0.1), abs=1e-9)


def test_energy_balance_of_a_free_run() -> None:
    """Without a position loop and damping, viscosity and impacts take what is missing."""
    p = oracle.Params(K_B=0.0)
    start = (3.0, 2.0, 0.0, 0.0)
    run = oracle.solve(p, "none", start=start, position_loop=False, duration=0.05, step=0.0)

    def energy(x: np.ndarray) -> float:
        beyond = max(abs(x[3]) - p.half_gap, 0.0)
        motor = 0.5 * p.J_M * (x[0] + x[1]) ** 2
        return motor + 0.5 * p.J_L * x[0] ** 2 + 0.5 * p.K * beyond**2

    t = np.linspace(0.0, 0.05, 20001)
    x = run.state(t)
    viscous = np.trapezoid(p.D_L * x[:, 0] ** 2 + p.D_M * (x[:, 0] + x[:, 1]) ** 2, t)
    lost = viscous + run.metrics()["impact_energy_J"]
    # The trapezoidal rule with 2.5 us steps over kinks of the power.
    assert energy(x[0]) - energy(x[-1]) == pytest.approx(lost, rel=1e-6)
