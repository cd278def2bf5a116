"""Logs as machines write them: different rates, jitter, late sensors, offsets, starts."""

from __future__ import annotations

import identification_logs as logs
import numpy as np
import pytest

import jaxsim
from jaxsim import tree
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.laws.feedforward import Feedforward
from jaxsim.scenario import Scenario, Start
from tuning.identification.estimator import Fits, fit
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.residuals import Problem
from tuning.identification.unknowns import free

FINE, DT = 5e-5, 2e-4  # s: steps of the run that stands for the machine, and of the fit
NOISE = {"theta_M": 1e-5, "theta_L": 1e-5, "T_s": 0.01}


def _recorded(times: dict[str, np.ndarray], **late: float) -> Experiment:
    """A log of the bench whose signals are read at `times`, some of them late by so many s."""
    run = jaxsim.simulate(
        bench_2018(), Feedforward(), logs.scenario(logs.chirp()), dt=FINE, metrics=()
    )
    rng = np.random.default_rng(5)

    def read(name: str, t: np.ndarray) -> object:
        exact = np.interp(t - late.get(name, 0.0), np.asarray(run.time), run.signals[name])
        return measurement(name, t, exact + NOISE[name] * rng.standard_normal(t.size), NOISE[name])

    read_ = tuple(read(name, t) for name, t in times.items())
    asked = logs.scenario(logs.chirp())
    return Experiment("log", bench_2018(), Feedforward(), asked, read_)  # type: ignore[arg-type]


def _found(log: Experiment, *more: object) -> tuple[dict[str, float], float]:
    """All unknowns, from 20 % wrong, and the rms of what is left."""
    unknown = [*logs.unknown(log), *more]
    problem = Problem([log], unknown, dt=DT)  # type: ignore[arg-type]
    start = problem.initial()
    start[:4] *= [1.2, 0.8, 1.2, 0.8]
    found: Fits = fit(problem, start[None])
    assert found.converged[0]
    left = float(np.sqrt(2.0 * found.loss[0] / problem.readings.used.sum()))
    return dict(zip(problem.unknowns.names, found.values[0], strict=True)), left


def _are_the_truth(found: dict[str, float]) -> None:
    for name, value in zip(logs.NAMES, logs.TRUTH, strict=True):
        assert found[name] == pytest.approx(value, rel=0.01), name


def test_signals_of_different_rates() -> None:
    """Encoders at 2 kHz and 1 kHz, torque every 0.7 ms, one begins late."""
    end = logs.TIMES[-1]
    times = {
        "theta_M": np.arange(1, 601) * 5e-4,
        "theta_L": logs.TIMES[1:],
        "T_s": np.arange(0.02, end, 7e-4),
    }
    _are_the_truth(_found(_recorded(times))[0])


def test_jittered_time_stamps_are_read_where_they_are() -> None:
    """Stamps off their grid by up to 0.4 ms: taken for the grid, they would be 6 mrad off."""
    rng = np.random.default_rng(6)
    jittered = {name: logs.TIMES[1:-1] + rng.uniform(-4e-4, 4e-4, 299) for name in NOISE}
    log = _recorded(jittered)
    found, left = _found(log)
    _are_the_truth(found)
    # Noise alone: a torque that is read between ticks of which one is free does not count.
    assert left == pytest.approx(1.0, abs=0.05)
    even = tuple(m._replace(times=logs.TIMES[1:-1]) for m in log.measurements)
    blind, much = _found(log._replace(measurements=even))
    assert much > 50.0  # what the stamps are worth
    assert abs(blind["half_gap"] / logs.TRUTH[0] - 1.0) > 0.01


def test_the_delay_between_two_sensors_is_found() -> None:
    """The torque sensor is 1.3 ms behind the encoders."""
    log = _recorded(dict.fromkeys(NOISE, logs.TIMES[1:]), T_s=1.3e-3)
    found, _ = _found(log, free(log, "T_s.delay", 0.0, 5e-3))
    _are_the_truth(found)
    # Half-way between ticks, where a straight line over impacts was 36 us off; error 1.7 us.
    assert found["T_s.delay"] == pytest.approx(1.3e-3, abs=5e-6)


def test_what_each_experiment_has_for_itself_is_found() -> None:
    """Three logs: one J_L; a start, a speed and an encoder's zero for each of them."""
    angles, speeds, zeros = [0.3, -0.2, 0.05], [1.0, -2.0, 0.0], [0.02, -0.03, 0.01]
    torque = logs.scenario(logs.chirp())
    recorded = []
    rng = np.random.default_rng(7)
    for i, (angle, speed, zero) in enumerate(zip(angles, speeds, zeros, strict=True)):
        asked = Scenario(
            torque.reference, torque.load_torque,
            Start(theta_L=angle, omega_L=speed), duration=torque.duration,
        )  # fmt: skip
        run = jaxsim.simulate(bench_2018(), Feedforward(), asked, store=5, metrics=())
        read = tuple(
            measurement(
                name, logs.TIMES[1:],
                np.asarray(run.signals[name])[1:] + shift + 1e-5 * rng.standard_normal(300), 1e-5,
            )
            for name, shift in (("theta_M", zero), ("theta_L", 0.0))
        )  # fmt: skip
        recorded.append(Experiment(f"log {i}", bench_2018(), Feedforward(), torque, read))
    first = recorded[0]
    unknown = [
        free(first, "J_L", 2e-4, 4e-3),
        free(first, "start.theta_L", -1.0, 1.0, own=True),
        free(first, "start.omega_L", -5.0, 5.0, own=True),
        free(first, "theta_M.offset", -0.1, 0.1, own=True),
    ]
    problem = Problem(recorded, unknown, dt=DT)
    start = problem.initial()
    start[0] *= 1.3
    values = fit(problem, start[None]).values[0]
    truth = float(tree.get(bench_2018(), "J_L"))
    assert values[0] == pytest.approx(truth, rel=1e-3)
    np.testing.assert_allclose(values[1:4], angles, atol=5e-6)
    np.testing.assert_allclose(values[4:7], speeds, atol=1e-3)
    np.testing.assert_allclose(values[7:10], zeros, atol=5e-6)
