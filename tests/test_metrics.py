"""Metrics of runs in either direction, that never settle, never touch, never step."""

from __future__ import annotations

from functools import cache
from typing import Any

import bench
import jax.numpy as jnp
import numpy as np
import oracle
import pytest

from jaxsim import batch
from jaxsim._simulate import simulate
from jaxsim.hybrid import Exact
from jaxsim.loop import ClosedLoop
from jaxsim.metric import task_of
from jaxsim.run import Run
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.chirp import Chirp
from jaxsim.signals.constant import Constant
from jaxsim.signals.multisine import Multisine
from jaxsim.signals.step import FilteredStep, Step
from jaxsim.signals.table import Table

DURATION = 0.2
# Peaks and crossings between grid points are those of the cubic of each step, dt^4.
RELATIVE = 1e-5

# step rad, start omega_L omega_B theta_L theta_B
CASES: dict[str, tuple[float, tuple[float, float, float, float]]] = {
    "step up": (0.3, (0.0, 0.0, 0.0, 0.0)),
    "step down": (-0.3, (0.0, 0.0, 0.0, 0.0)),
    "ends inside the band": (0.3, (2.0, 1.0, 0.0, 0.004)),
    "never touches": (1e-4, (0.0, 0.0, 0.0, 0.0)),
    "no step, moving": (0.0, (-3.0, 0.0, 0.0, 0.0)),
    "no step, at rest": (0.0, (0.0, 0.0, 0.0, 0.0)),
    "starts in contact": (0.2, (0.0, 0.0, 0.0, -0.009)),
    "passes the target before the step": (0.05, (8.0, 0.0, 0.0, 0.0)),
}


@cache
def found() -> Run:
    scenarios = [
        bench.scenario(DURATION, step=step, start=Start(s[2], s[0], s[3], s[1]))
        for step, s in CASES.values()
    ]
    return simulate(
        bench.drive(), bench.law("switched"), batch.stack(scenarios), store=None, dt=2e-4
    )


def numbers(name: str) -> dict[str, float]:
    index = list(CASES).index(name)
    return {key: float(value[index]) for key, value in found().metrics.items()}


@cache
def expected(name: str) -> oracle.Metrics:
    step, start = CASES[name]
    return oracle.solve(
        bench.PAPER, "switched", step=step, start=start, duration=DURATION
    ).metrics()


# What the oracle calls nan (it never happens) is a number that an optimiser can use here.
NEVER = {
    "first_contact_s": np.inf, "entry_speed_rad_s": 0.0, "first_impact_Nm": 0.0,
    "first_separation_s": np.inf, "braking_contact_s": np.inf, "braking_peak_Nm": 0.0,
    "overshoot_rad": np.nan, "overshoot_pct": np.nan, "rise_10_90_s": np.nan, "t50_s": np.nan,
    "settle_2pct_s": np.nan,
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_every_metric_is_that_of_the_oracle(name: str) -> None:
    ours, theirs = numbers(name), expected(name)
    for key, same in bench.SAME.items():
        right = NEVER[same] if np.isnan(theirs[key]) else theirs[key]
        if same in ("theta_max_rad", "command_max", "command_min"):
            assert ours[same] == pytest.approx(right, rel=RELATIVE, abs=1e-7), same
        else:
            assert ours[same] == pytest.approx(right, rel=RELATIVE, abs=1e-9, nan_ok=True), same


def test_a_step_down_is_judged_as_one_up() -> None:
    up, down = numbers("step up"), numbers("step down")
    assert down["overshoot_pct"] == pytest.approx(up["overshoot_pct"], rel=1e-12)
    assert down["rise_10_90_s"] == pytest.approx(up["rise_10_90_s"], rel=1e-12)
    assert down["first_impact_Nm"] == pytest.approx(-up["first_impact_Nm"], rel=1e-12)
    assert down["braking_peak_Nm"] == pytest.approx(-up["braking_peak_Nm"], rel=1e-12)
    assert down["theta_min_rad"] == pytest.approx(-up["theta_max_rad"], rel=1e-12)
    assert down["T_s_min_Nm"] == pytest.approx(-up["T_s_max_Nm"], rel=1e-12)
    assert up["driving_torque_max_Nm"] == up["T_s_max_Nm"] > 0.0
    assert up["braking_torque_max_Nm"] == -up["T_s_min_Nm"] > 0.0
    for name in ("driving_torque_max_Nm", "braking_torque_max_Nm"):
        assert down[name] == pytest.approx(up[name], rel=1e-12)


def test_a_run_at_rest_has_no_numbers_that_are_not_documented() -> None:
    rest = numbers("no step, at rest")
    zero = {
        "theta_max_rad", "theta_min_rad", "final_error_rad", "iae_rad_s", "itae_rad_s2",
        "error_rms_rad", "impact_loss_J", "largest_torque_Nm", "T_s_max_Nm", "T_s_min_Nm",
        "command_max", "command_min", "command_peak", "command_rms", "command_variation",
        "limit_cycle_rad", "limit_cycle_Nm", "limit_cycle_Hz", "driving_torque_max_Nm",
        "braking_torque_max_Nm",
    }  # fmt: skip
    assert {name for name, value in rest.items() if value == 0.0} >= zero
    assert rest["limit_cycle_growth"] == 1.0


def test_rms_and_variation_are_those_of_a_fine_grid() -> None:
    run = oracle.solve(bench.PAPER, "switched", duration=DURATION)
    ours = numbers("step up")
    t = np.linspace(0.0, DURATION, 400_001)
    after = t >= bench.ONSET
    error = np.trapezoid((0.3 - run.state(t[after])[:, 2]) ** 2, t[after])
    command = run.motor_torque(t)
    expected_rms = np.sqrt(error / (DURATION - bench.ONSET))
    assert ours["error_rms_rad"] == pytest.approx(expected_rms, rel=1e-5)
    rms = np.sqrt(np.trapezoid(command**2, t) / DURATION)
    assert ours["command_rms"] == pytest.approx(rms, rel=1e-4)
    variation = np.sum(np.abs(np.diff(command)))
    # Between the ends of a step a turning point is left out: dt^2 of curvature at each.
    assert ours["command_variation"] == pytest.approx(variation, rel=2e-3)


def _task(reference: Any) -> Any:
    scenario = Scenario(reference, duration=DURATION)
    loop = ClosedLoop(bench.drive(), bench.law("none"), scenario, Exact(), 2e-4)
    return task_of(loop, 0, "rad")


def test_the_task_of_a_reference() -> None:
    """When it first moves, from where, and where it ends."""
    step, table = Step(0.2, 0.05), Table([0.05, 0.1, 0.3], [0.1, 0.3, 0.7])
    cases = {
        "constant": (Constant(0.1), (0.1, 0.1, 0.0)),
        "on top of a constant": (Constant(0.1) + step, (0.1, 0.3, 0.05)),
        "two steps": (step + Step(-0.3, 0.08), (0.0, -0.1, 0.05)),
        "table": (table, (0.1, 0.5, 0.05)),
        "after the end": (Step(0.2, 0.5), (0.0, 0.0, 0.5)),
    }
    for name, (reference, right) in cases.items():
        task = _task(reference)
        found = [float(task.initial), float(task.target), float(task.onset)]
        assert found == pytest.approx(right), name


def test_values_and_breakpoints_of_signals() -> None:
    t = jnp.asarray(0.13)
    sweep = 0.2 * np.sin(2 * np.pi * (2.0 * 0.13 + 0.5 * (8.0 - 2.0) * 0.13**2 / 0.4))
    lines = Multisine([0.1, 0.2], [3.0, 7.0], [0.5, 0.0])
    sines = 0.1 * np.sin(6 * np.pi * 0.13 + 0.5) + 0.2 * np.sin(14 * np.pi * 0.13)
    held = Table([0.0, 0.1, 0.13, 0.2], [1.0, 2.0, 3.0, 4.0], "hold")
    slope = Table([0.0, 0.1, 0.2], [1.0, 2.0, 4.0])
    cases = [
        (Chirp(0.2, 2.0, 8.0, 0.4), sweep, np.inf),
        (lines, sines, np.inf),
        (held, 3.0, 0.2),
        (slope, 2.6, 0.2),
        (FilteredStep(0.3, 0.1, 20.0), 0.3 * (1 - np.exp(-2 * np.pi * 20 * 0.03)), np.inf),
        (slope + Step(1.0, 0.15), 2.6, 0.15),
    ]
    for signal, value, after in cases:
        assert float(signal.value(t, t)) == pytest.approx(value), signal
        assert float(signal.next_break(t)) == pytest.approx(after), signal
    # A step that ends on a breakpoint does not see what comes after it.
    assert float(held.value(t, jnp.asarray(0.12))) == 2.0
