"""Sampled laws against SciPy's bilinear transform, fed with what the sensors saw."""

from __future__ import annotations

from functools import cache
from typing import Any

import bench
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from jaxsim import batch, tree
from jaxsim._simulate import simulate
from jaxsim.errors import InputError
from jaxsim.laws.pd import PD
from jaxsim.laws.ramped_damping import RampedDamping
from jaxsim.run import Run
from jaxsim.sampled import Differences, Encoders, Filtered, Noisy, Sampled, TrueSpeeds
from jaxsim.scenario import Scenario
from jaxsim.signals.constant import Constant

PERIOD, DT = 4e-4, 2e-4
EVERY = round(PERIOD / DT)
COARSE = 2**14  # counts per revolution: one count is a twentieth of the gap
GAINS = (0.0, -0.8)


def _simulate(**options: object) -> Run:
    """Without and with damping; the signals of every tick."""
    laws = [Sampled(bench.law(kind), PERIOD, **options) for kind in ("none", "linear")]
    return simulate(
        bench.drive(), batch.stack(laws), bench.scenario(), dt=DT, metrics=("first_impact_Nm",)
    )


@cache
def direct() -> Run:
    return _simulate()


@cache
def late_and_coarse() -> Run:
    return _simulate(delay=PERIOD, sensors=Encoders(COARSE))


def _samples(run: Run, name: str, member: int) -> np.ndarray:
    return np.asarray(run.signals[name])[member, ::EVERY]


def _filtered(num: list[float], den: list[float], u: np.ndarray) -> np.ndarray:
    b, a, _ = cont2discrete((num, den), PERIOD, "bilinear")
    return lfilter(np.ravel(b), a, u)


def _commands(reference: np.ndarray, theta_L: np.ndarray, omega_B: np.ndarray, K_B: float):
    """Prefilter, PD and damping as three difference equations."""
    p = bench.PAPER
    cutoff = 2.0 * np.pi * p.f_ref
    error = _filtered([cutoff], [1.0, cutoff], reference) - theta_L
    pd = _filtered([p.K_D + p.K_P * p.tau_D, p.K_P], [p.tau_D, 1.0], error)
    return pd + K_B * omega_B


@pytest.mark.parametrize("member", [0, 1])
def test_commands_are_those_of_the_bilinear_transform(member: int) -> None:
    seen = (_samples(direct(), n, member) for n in ("reference", "theta_L", "omega_B"))
    expected = _commands(*seen, GAINS[member])
    # The reference is known at t = 0 too, where it is zero; the largest command is 3 Nm.
    assert _samples(direct(), "command", member) == pytest.approx(expected, abs=1e-11)


def test_the_command_is_held_between_samples() -> None:
    command = np.asarray(direct().signals["command"])[:, :-1]
    held = command.reshape(2, -1, EVERY)
    assert np.array_equal(held[..., 1:], np.broadcast_to(held[..., :1], held[..., 1:].shape))


@pytest.mark.parametrize("member", [0, 1])
def test_encoders_round_angles_and_the_command_comes_a_period_late(member: int) -> None:
    run, count = late_and_coarse(), 2.0 * np.pi / COARSE
    theta_L, theta_M = (
        count * np.round(_samples(run, name, member) / count) for name in ("theta_L", "theta_M")
    )
    theta_B = theta_M - theta_L
    omega_B = np.diff(theta_B, prepend=0.0) / PERIOD
    expected = _commands(_samples(run, "reference", member), theta_L, omega_B, GAINS[member])
    assert np.ptp(np.diff(theta_L)) > 0.0
    late = _samples(run, "command", member)
    assert late[0] == 0.0
    assert late[1:] == pytest.approx(expected[:-1], abs=1e-10)


def test_a_velocity_filter_is_the_low_pass_with_its_input_held() -> None:
    """A law that only damps: its command is K_B times the filtered speed of what it has seen."""
    cutoff = 100.0
    law = Sampled(bench.law("linear"), PERIOD, sensors=Filtered(Encoders(COARSE), cutoff))
    run = simulate(bench.drive(), law, bench.scenario(), dt=DT, metrics=())
    theta_L, theta_M = (np.asarray(run.signals[n])[::EVERY] for n in ("theta_L", "theta_M"))
    count = 2.0 * np.pi / COARSE
    theta_L, theta_M = (count * np.round(v / count) for v in (theta_L, theta_M))
    raw = np.diff(theta_M - theta_L, prepend=0.0) / PERIOD
    w = 2.0 * np.pi * cutoff
    b, a, _ = cont2discrete(([w], [1.0, w]), PERIOD, "zoh")
    # SciPy's zero-order hold answers a sample late: the filter sees v_k when it makes w_k.
    omega_B = lfilter(np.ravel(b)[1:], a, raw)
    reference = np.asarray(run.signals["reference"])[::EVERY]
    expected = _commands(reference, theta_L, omega_B, GAINS[1])
    assert np.asarray(run.signals["command"])[::EVERY] == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("precision", [32, 64])
def test_gradients_through_encoders_are_the_slope_of_the_staircase(precision: Any) -> None:
    """A metric is a staircase of the gain, in steps of a count; over many steps it has a slope."""
    damped = bench.law("none") + RampedDamping(-0.8, width=2.0)
    law = Sampled(damped, PERIOD, PERIOD, Encoders(), precision)

    def impact(K_P: Any) -> Any:
        run = simulate(
            bench.drive(), tree.replace(law, {"K_P": K_P}), bench.scenario(), dt=DT, store=None,
            metrics=("first_impact_Nm",),
        )  # fmt: skip
        return run.metrics["first_impact_Nm"]

    gains = bench.PAPER.K_P * np.linspace(0.95, 1.05, 41)
    slope, _ = np.polyfit(gains, jax.jit(jax.vmap(impact))(jnp.asarray(gains)), 1)
    assert jax.jacfwd(impact)(bench.PAPER.K_P) == pytest.approx(slope, rel=0.05)


def test_float32_in_the_law_leaves_the_drive_in_float64() -> None:
    """The commands are numbers of float32; fed with them, they are those of float64 to its eps."""
    law = Sampled(bench.law("linear"), PERIOD, sensors=Differences(), precision=32)
    run = simulate(bench.drive(), law, bench.scenario(), dt=DT, metrics=())
    command = np.asarray(run.signals["command"])
    assert command.dtype == np.float64
    np.testing.assert_array_equal(command, command.astype(np.float32))
    theta_L = np.asarray(run.signals["theta_L"])
    assert np.any(theta_L != theta_L.astype(np.float32))
    seen = (np.asarray(run.signals[n])[::EVERY] for n in ("reference", "theta_L", "theta_B"))
    reference, theta_L, theta_B = seen
    omega_B = np.diff(theta_B, prepend=0.0) / PERIOD
    expected = _commands(reference, theta_L, omega_B, GAINS[1])
    worst = np.abs(command[::EVERY] - expected).max()
    # Angles of 0.3 rad differ over a period by numbers of eps 0.3 rad, and K_B/period = 2000.
    assert 1e-7 < worst < 4.0 * 2000.0 * 0.3 * 2.0**-24


def test_noise_repeats_for_a_seed_and_has_its_size() -> None:
    """A law that only measures: its command is K_P times the noise of the angle it reads."""
    noisy = Noisy(TrueSpeeds(), angle_noise=2e-3, seed=1)
    law = Sampled(PD(1.0, 0.0, 0.01), PERIOD, sensors=noisy)
    laws = batch.spread(law, seed=[1.0, 1.0, 2.0])
    still = Scenario(Constant(0.0), duration=0.4)
    run = simulate(bench.drive(), laws, still, dt=DT, metrics=())
    command = np.asarray(run.signals["command"])[:, ::EVERY]
    first, again, other = -command - np.asarray(run.signals["theta_L"])[:, ::EVERY]
    assert np.array_equal(first, again)
    for noise in (first, other):
        assert noise.std() == pytest.approx(2e-3, rel=0.1)  # of 1000: 2.2 % is one deviation
        assert abs(noise.mean()) < 3e-4
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.1
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.1


def test_the_step_at_2_5_khz_hits_44_57_percent_less() -> None:
    """Errata, A: Tustin, zero-order hold, true speeds, no delay, step at sample 25."""
    none, linear = np.asarray(direct().metrics["first_impact_Nm"])
    assert 100.0 * (1.0 - linear / none) == pytest.approx(44.57, abs=0.005)


@pytest.mark.parametrize(
    ("options", "dt", "field"),
    [
        ({"period": 4e-4}, 3e-4, "Sampled.period"),
        ({"period": 4e-4, "delay": 1e-4}, 2e-4, "Sampled.delay"),
    ],
)
def test_dt_must_divide_the_period_and_the_delay(options: dict, dt: float, field: str) -> None:
    law = Sampled(bench.law("none"), **options)
    with pytest.raises(InputError, match="must be a multiple of dt") as caught:
        simulate(bench.drive(), law, bench.scenario(), dt=dt)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("build", "field"),
    [
        (lambda: Sampled(bench.law("none"), 0.0), "Sampled.period"),
        (lambda: Sampled(bench.law("none"), PERIOD, -PERIOD), "Sampled.delay"),
        (lambda: Encoders(0), "Encoders.counts"),
        (lambda: Filtered(Encoders(), 0.0), "Filtered.cutoff"),
        (lambda: Sampled(bench.law("none"), PERIOD, precision=16), "Sampled.precision"),
    ],
)
def test_periods_delays_and_counts_are_checked(build: object, field: str) -> None:
    with pytest.raises(InputError) as caught:
        build()
    assert caught.value.field == field


def test_a_delay_in_the_wrong_unit_is_refused() -> None:
    with pytest.raises(InputError, match=r"Sampled.delay: must be at most 32 periods"):
        Sampled(PD(1.0, 0.1, 0.01), 4e-4, delay=1.0)
