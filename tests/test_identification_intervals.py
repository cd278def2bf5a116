"""Standard errors and bootstrap against closed forms: unknowns that the readings are linear in."""

from __future__ import annotations

import identification_logs as logs
import numpy as np
import pytest
from scipy.linalg import toeplitz

import jaxsim
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.laws.feedforward import Feedforward
from tuning.identification import uncertainty
from tuning.identification.estimator import fit
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.residuals import Problem
from tuning.identification.robust import Squares
from tuning.identification.unknowns import free

NOISE = 1e-3  # rad
COLOUR = 0.8  # of a first-order autoregression
ASKED = logs.scenario(logs.chirp(10.0))


def _angle() -> np.ndarray:
    run = jaxsim.simulate(bench_2018(), Feedforward(), ASKED, store=5, metrics=())
    return np.asarray(run.signals["theta_L"])[1:]


def offset_problem(
    noise: np.ndarray, name: str = "theta_L.offset", lower: float = -0.1, upper: float = 0.1
) -> Problem:
    """One log of the load's encoder per row of `noise`; the unknown is an offset or a scale."""
    angle = _angle()
    recorded = [
        Experiment(
            f"{i}", bench_2018(), Feedforward(), ASKED,
            (measurement("theta_L", logs.TIMES[1:], angle + own, NOISE),),
        )
        for i, own in enumerate(noise)
    ]  # fmt: skip
    return Problem(recorded, [free(recorded[0], name, lower, upper)], dt=2e-4, width=len(noise))


def _coloured(rows: int, seed: int = 0) -> np.ndarray:
    """(rows, samples) of an autoregression with a standard deviation of NOISE."""
    rng = np.random.default_rng(seed)
    fresh = NOISE * np.sqrt(1.0 - COLOUR**2) * rng.standard_normal((rows, logs.SAMPLES))
    found = np.zeros_like(fresh)
    found[:, 0] = NOISE * rng.standard_normal(rows)
    for i in range(1, logs.SAMPLES):
        found[:, i] = COLOUR * found[:, i - 1] + fresh[:, i]
    return found


def _fitted(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and standard errors of fits to each log alone."""
    who = np.arange(len(problem.experiments))[:, None]
    starts = np.tile(problem.initial(), (len(who), 1))
    found = fit(problem, starts, who=who)
    seen = problem.evaluate(found.values, who=who)
    errors = [
        uncertainty.covariance(problem, seen, v, Squares(), row=i, who=who[i]).deviation[0]
        for i, v in enumerate(found.values)
    ]
    return found.values[:, 0], np.array(errors)


@pytest.mark.parametrize("name", ["theta_L.offset", "theta_L.scale"])
def test_standard_errors_with_coloured_noise_are_those_of_the_closed_form(name: str) -> None:
    """Least squares of y = J p + e: variance J^T C J/(J^T J)^2, C_ij = NOISE^2 COLOUR^|i-j|."""
    lower, upper = (-0.1, 0.1) if name.endswith("offset") else (0.5, 2.0)
    found, errors = _fitted(offset_problem(_coloured(128), name, lower, upper))
    J = np.ones(logs.SAMPLES) if name.endswith("offset") else _angle()
    C = NOISE**2 * toeplitz(COLOUR ** np.arange(logs.SAMPLES))
    truth = float(np.sqrt(J @ C @ J) / (J @ J))
    white = NOISE / np.sqrt(J @ J)
    assert truth > 2.5 * white  # else the test would not see whether colour counts
    # 128 logs: the scatter itself is known to 6 %; a single log of 300 gives its colour to 25 %.
    assert found.std() == pytest.approx(truth, rel=0.2)
    assert np.median(errors) == pytest.approx(truth, rel=0.2)


def test_standard_errors_with_white_noise_are_those_of_the_closed_form() -> None:
    noise = NOISE * np.random.default_rng(1).standard_normal((32, logs.SAMPLES))
    found, errors = _fitted(offset_problem(noise))
    # A fit ends when a thousandth of a standard error would be gained.
    np.testing.assert_allclose(found, noise.mean(axis=1), atol=1e-3 * NOISE / 300**0.5)
    # A standard error from 300 residuals is known to 1/sqrt(600) = 4 %.
    np.testing.assert_allclose(np.median(errors), NOISE / np.sqrt(logs.SAMPLES), rtol=0.03)


def test_the_bootstrap_over_experiments_gives_the_error_of_a_mean() -> None:
    """A shared offset is the mean of what the logs have; of n logs its error is scatter/sqrt(n)."""
    own = np.array([0.010, -0.004, 0.031, 0.002, 0.018, -0.020, 0.007, 0.012])
    problem = offset_problem(np.tile(own[:, None], logs.SAMPLES))
    who = np.arange(len(own))
    best = fit(problem, problem.initial()[None]).values[0]
    assert best[0] == pytest.approx(own.mean(), abs=1e-7)
    drawn = uncertainty.bootstrap(problem, best, Squares(), who, 400, seed=3)[:, 0]
    # 400 samples: the mean to 5 % of a standard error, the standard error to 1/sqrt(800) = 3.5 %.
    error = own.std() / np.sqrt(len(own))
    assert abs(drawn.mean() - own.mean()) < 0.2 * error
    assert drawn.std() == pytest.approx(error, rel=0.12)
    # Every sample is the mean of eight of the values.
    sums = 8.0 * np.sort(drawn) / 0.001
    np.testing.assert_allclose(sums, np.round(sums), atol=0.01)
