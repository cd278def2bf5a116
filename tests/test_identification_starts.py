"""Start values by regression: against logs whose parameters are known."""

from __future__ import annotations

import identification_logs as logs
import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from jaxsim import tree
from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.laws.feedforward import Feedforward
from jaxsim.loads.inertia import Inertia
from jaxsim.motors.ideal import Ideal
from jaxsim.scenario import Scenario
from jaxsim.signals.samples import Samples
from jaxsim.transmissions.elastic import Elastic
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.regression import regressed
from tuning.identification.residuals import Problem
from tuning.identification.two_mass import two_masses
from tuning.identification.unknowns import free

J_M, J_L, K, D_M, D_L, D_B = 8.78e-4, 1.2e-3, 30.0, 2e-3, 3e-3, 5e-3
N = 3.0


def elastic_log(ratio: float = 1.0, noise: float = 0.0) -> tuple[np.ndarray, ...]:
    """Times, motor torque and the states of two inertias by scipy, in load-side units over N."""
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-K / J_M, -(D_M + D_B) / J_M, K / J_M, D_B / J_M],
            [0.0, 0.0, 0.0, 1.0],
            [K / J_L, D_B / J_L, -K / J_L, -(D_L + D_B) / J_L],
        ]
    )
    t = 1e-3 * np.arange(4000)
    torque = np.sin(2.0 * np.pi * (2.0 + 30.0 * t) * t) * np.sin(np.pi * t / 2.5) ** 2
    torque = np.where(t < 2.5, torque, 0.0)
    system = StateSpace(
        A, np.array([[0.0], [1.0 / J_M], [0.0], [0.0]]), np.eye(4), np.zeros((4, 1))
    )
    _, x, _ = lsim(system, torque, t)
    x = x + noise * x.std(axis=0) * np.random.default_rng(0).standard_normal(x.shape)
    return t, torque / ratio, x


def test_the_frequency_response_gives_two_inertias() -> None:
    t, torque, x = elastic_log()
    found = two_masses(torque, x[:, 1], float(t[1]))
    truth = {"J_M": J_M, "J_L": J_L, "K": K, "D_M": D_M, "D_L": D_L, "D_B": D_B}
    for name, value in truth.items():
        # lsim joins the torque by lines, as the transform does not: 1 % at the resonance.
        assert found[name] == pytest.approx(value, rel=0.02), name
    noisy = two_masses(torque, elastic_log(noise=0.02)[2][:, 1], float(t[1]))
    for name in ("J_M", "J_L", "K"):
        assert noisy[name] == pytest.approx(truth[name], rel=0.2), name


@pytest.mark.parametrize("signals", [("theta_M",), ("theta_M", "theta_L")])
def test_an_elastic_drive_with_a_gear(signals: tuple[str, ...]) -> None:
    """The motor's inertia is told at its own shaft: J_M/N^2 of what the load side feels."""
    t, torque, x = elastic_log(N)
    drive = Drive(Ideal(J_M / N**2, D_M / N**2), Elastic(1.0, N, 0.0), Inertia(1e-2, 0.0))
    angles = {"theta_M": N * x[:, 0], "theta_L": x[:, 2]}
    read = tuple(measurement(n, t[1:], angles[n][1:], 1e-4) for n in signals)
    asked = Scenario(Samples(torque, 1e-3, "linear"), duration=float(t[-1]))
    log = Experiment("log", drive, Feedforward(), asked, read)
    frees = [free(log, "K", 1.0, 1e3), free(log, "J_L", 1e-4, 1e-1), free(log, "D_B", 0.0, 1.0)]
    found = regressed(Problem([log], frees, dt=1e-3), np.array([0]))
    assert found["K"] == pytest.approx(K, rel=0.05)
    assert found["J_L"] == pytest.approx(J_L, rel=0.05)
    assert found["D_B"] == pytest.approx(D_B, rel=0.1)


@pytest.mark.parametrize("signals", [("theta_M", "theta_L", "T_s"), ("theta_M", "theta_L")])
def test_the_bench_with_play(signals: tuple[str, ...]) -> None:
    """Noise, quantisation, impacts: near enough for the fit to start from (it finds 30 %)."""
    recorded, truth = logs.random_bench_logs(4, signals)
    for log, values in zip(recorded, truth, strict=True):
        found = regressed(Problem([log], logs.unknown(log), dt=2e-4), np.array([0]))
        assert found["half_gap"] == pytest.approx(values[0], rel=0.1)
        assert found["J_L"] == pytest.approx(values[3], rel=0.1)
        assert found["K"] == pytest.approx(values[1], rel=0.3)


def test_one_encoder_of_a_stiff_drive_gives_one_inertia() -> None:
    """J_M alpha + D_M omega = T of a motor of 1 kg m^2 whose load is known."""
    t = 1e-2 * np.arange(1, 1001)
    omega = 2.0 * np.sin(1.3 * t) + np.sin(0.4 * t)
    alpha = 2.6 * np.cos(1.3 * t) + 0.4 * np.cos(0.4 * t)
    angle = -2.0 / 1.3 * np.cos(1.3 * t) - 2.5 * np.cos(0.4 * t)
    torque = np.concatenate([[3.0], 1.5 * alpha + 0.2 * omega])
    drive = tree.replace(bench_2018(), {"J_L": 0.5, "J_M": 0.1, "D_M": 0.05, "D_L": 0.0})
    asked = Scenario(Samples(torque, 1e-2, "linear"), duration=10.0)
    read = (measurement("theta_M", t, angle, 1e-4),)
    log = Experiment("log", drive, Feedforward(), asked, read)
    frees = [free(log, "J_M", 0.01, 10.0), free(log, "D_M", 0.0, 1.0)]
    found = regressed(Problem([log], frees, dt=1e-2), np.array([0]))
    assert found["J_M"] == pytest.approx(1.0, rel=1e-3)
    assert found["D_M"] == pytest.approx(0.2, rel=1e-3)
    # Which side has it, one encoder does not say.
    both = [*frees, free(log, "J_L", 0.01, 10.0)]
    assert regressed(Problem([log], both, dt=1e-2), np.array([0])) == {}
