"""Torque laws and their derivative sources, against scipy, the paper and each other."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from joint_cases import (
    AMPLITUDE,
    ARM,
    DT,
    LEAD,
    STEP,
    arm_law,
    arm_run,
    arm_scenario,
    leg_with_everything,
    rippled,
    torque,
)
from scipy import signal as filters

from jaxsim._simulate import simulate
from jaxsim.components import build, dump
from jaxsim.derivative import Derivatives
from jaxsim.derivatives.butterworth import Butterworth, ButterworthDifferences
from jaxsim.derivatives.levant import Levant
from jaxsim.derivatives.model_based import ModelBased
from jaxsim.drive import Drive
from jaxsim.drives.leg_2014 import leg_2014
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import Control, Decentral, Measured
from jaxsim.laws.lead import Lead
from jaxsim.laws.linear_damping import LinearDamping
from jaxsim.laws.motor_position import MotorPosition
from jaxsim.laws.pd import PD
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.positive_feedback import PositiveFeedback
from jaxsim.loop import ClosedLoop, When
from jaxsim.sampled import Sampled
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.signals.step import Step
from jaxsim.tree import cast

# --- laws -----------------------------------------------------------------------------------------


def test_gammas() -> None:
    law = PositiveFeedback.design(ARM)
    for name, want in (("j", 1.62380e-5), ("a", 0.0337173), ("v", 6.198488)):
        assert getattr(law, f"Gamma_{name}") == pytest.approx([want] * 2, rel=5e-6)  # six digits
    leg = PositiveFeedback.design(leg_2014())  # the printed ones of section 4
    assert leg.Gamma_v == pytest.approx([6.909329], rel=1e-6)
    assert leg.Gamma_a == pytest.approx([0.054354], rel=1e-5)
    assert leg.Gamma_j == pytest.approx([3.975e-5], rel=1e-4)


def test_laws_that_do_not_fit_together_are_refused() -> None:
    torque_law, position_law = PITorque(2.0, 10.0), PD(1.0, 0.1, 0.01, command_unit="V")
    with pytest.raises(InputError, match=r"law\.reference: must have one unit"):
        torque_law + position_law
    with pytest.raises(InputError, match=r"law\.reference: must have one unit"):
        Decentral((torque_law, position_law))
    with pytest.raises(InputError, match=r"law\.command: must have one unit"):
        Lead(torque_law, 1.0, 2.0) + LinearDamping(-0.1)
    with pytest.raises(InputError, match="must control the same axes"):
        torque_law + PositiveFeedback.design(ARM)
    with pytest.raises(InputError, match="must command V"):
        simulate(leg_2014(), LinearDamping(-0.1), Scenario(duration=0.1), dt=DT)
    levant = torque_law + PositiveFeedback.design(leg_2014(), source=Levant(1e6))
    with pytest.raises(InputError, match="must be sampled"):
        simulate(leg_2014(), levant, Scenario(duration=0.1), dt=DT)
    with pytest.raises(InputError, match="below the Nyquist frequency 50 Hz"):
        Sampled(PositiveFeedback.design(leg_2014(), source=Butterworth(60.0)), 0.01)
    with pytest.warns(UserWarning, match=r"alpha_a = 1\.2 is outside"):
        PositiveFeedback.design(ARM, alpha_a=1.2)


def test_model_based_derivatives_are_those_of_the_true_motion() -> None:
    """(16)-(17) with the right model along a simulated motion: its own differences."""
    run = arm_run(arm_law(), amplitude=0.0)
    y = {name: np.asarray(values)[::4] for name, values in run.signals.items()}
    ys = tuple(Measured(**{n: y[n][:, i] for n in Measured._fields}) for i in range(2))
    motion = ModelBased.design(ARM).motion((), ys)
    for i, own in enumerate(motion):
        late = slice(150, None)  # differences need a smooth motion
        for rate, value in ((own.acceleration, own.velocity), (own.jerk, own.acceleration)):
            slope = np.gradient(np.asarray(value), 4 * DT, edge_order=2)
            scale = np.abs(rate).max()
            assert np.abs(np.asarray(rate) - slope)[late].max() < 2e-3 * scale, i


def estimates(source: Derivatives, period: float, theta, omega) -> np.ndarray:
    """What a source says, sampled as `Sampled` does it, of a load that moves as given."""
    law = Sampled(PositiveFeedback.design(leg_2014(), source=source), period)

    def measured(k):
        zero = jnp.zeros(())
        return (Measured(zero, theta(k * period), omega(k * period), *[zero] * 5),)

    def step(held, k):
        held = law._sample(measured(k), held, (150.0,), k)
        return held, jnp.stack(source.motion(held.law, held.seen)[0])

    start = law.start(measured(0.0), period)
    return np.asarray(jax.lax.scan(step, start, jnp.arange(1.0, 801.0))[1])


def test_levant_is_exact_up_to_the_orders_of_its_period() -> None:
    """theta = sin(10 t), |theta''''| <= 1e4 < bound: errors fall as T^3, T^2 and T."""

    def worst(period: float) -> np.ndarray:
        source = Levant(1.2e4)
        said = estimates(source, period, lambda t: jnp.sin(10 * t), lambda t: 10 * jnp.cos(10 * t))
        t = period * np.arange(1, 801)
        true = [10 * np.cos(10 * t), -100 * np.sin(10 * t), -1000 * np.cos(10 * t)]
        return np.abs(said - np.stack(true, axis=-1))[400:].max(axis=0)

    fine, coarse = worst(5e-4), worst(2e-3)
    orders = np.log(coarse / fine) / np.log(4.0)
    assert orders == pytest.approx([3.0, 2.0, 1.0], abs=0.4)
    assert np.all(fine < np.array([1e-5, 1e-3, 1e-1]) * [10.0, 100.0, 1000.0])


@pytest.mark.parametrize("order", [2, 3, 5])
def test_butterworth_is_scipys(order: int) -> None:
    """Tustin's rule without prewarping = scipy's analogue design through `bilinear`."""
    period, w = 1e-3, 2 * np.pi * 50.0
    said = estimates(
        Butterworth(50.0, order), period, lambda t: 0.0 * t, lambda t: jnp.sin(200 * t)
    )
    b, a = filters.butter(order, w, analog=True)
    times = period * np.arange(801)
    for k in range(3):
        numerator, denominator = filters.bilinear(np.append(b, np.zeros(k)), a, 1 / period)
        want = filters.lfilter(numerator, denominator, np.sin(200 * times))[1:]
        assert np.abs(said[:, k] - want).max() < 1e-9 * max(1.0, np.abs(want).max())


def test_butterworth_differences_are_first_order() -> None:
    source, period = ButterworthDifferences(Butterworth(50.0, 3)), 1e-3
    said = estimates(source, period, lambda t: 0.0 * t, lambda t: jnp.sin(200 * t))
    assert said[1:, 1] == pytest.approx(np.diff(said[:, 0]) / period, abs=1e-9)
    assert said[1:, 2] == pytest.approx(np.diff(said[:, 1]) / period, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("continuous", [True, False])
def test_filtered_derivatives_suit_the_leg_and_not_the_arm(continuous: bool) -> None:
    """Errata: stable on the leg of section 4, unstable on the arm with B_L = 0.01."""
    source = Butterworth(50.0, 3) if continuous else ButterworthDifferences(Butterworth(50.0, 3))

    def closed(drive: Drive, *gains: tuple[float, float]):
        law = Decentral(tuple(PITorque(*g) for g in gains))
        law = law + PositiveFeedback.design(drive, source=source)
        return law if continuous else Sampled(law, 1e-3)

    def worst(drive: Drive, law, scenario: Scenario, final: list[float]) -> np.ndarray:
        """Largest torque error in each second."""
        run = simulate(drive, law, scenario, dt=DT, metrics=(), throw=False)
        error = np.abs(torque(run).reshape(len(run.time), -1) - final)[1:]
        return np.nanmax(error.reshape(-1, 4000 * error.shape[1]), axis=1)

    scenario = Scenario(Step(STEP), duration=4.0)
    leg = worst(leg_2014(), closed(leg_2014(), (2.0, 10.0)), scenario, [STEP])
    assert np.all(leg[1:] < 0.5 * leg[:-1])
    gains = (2.0, 12.5), (2.0, 25.0)
    arm = worst(ARM, closed(ARM, *gains), arm_scenario(duration=8.0), [STEP, 0.0])
    assert arm[-1] > 10.0 * arm[1:4].max()


def poles(drive: Drive, law, angles: tuple[float, float]) -> np.ndarray:
    """Eigenvalues of the closed loop at rest at some load angles, by the engine's own field."""
    weight = [-float(v) for v in _weights(drive.load, angles)]
    bent = [T / 912.0 for T in weight]
    start = tuple(Start(theta_L=q, theta_B=b) for q, b in zip(angles, bent, strict=True))
    scenario = Scenario(tuple(map(Constant, weight)), (Constant(),) * 2, start, 1.0)
    loop = ClosedLoop(*(cast(v, np.float64) for v in (drive, law, scenario)), Exact(), DT)
    x, held = loop.start()
    flat, unravel = ravel_pytree(x)
    zero = jnp.zeros(())

    def field(v):
        rates = loop.field(When(zero, zero), unravel(v), (), held)
        return ravel_pytree(rates)[0]

    return np.linalg.eigvals(np.asarray(jax.jacfwd(field)(flat)))


def _weights(load, angles):
    """-G(q), from the accelerations at rest without torque: M^-1 T - M^-1 G."""
    rest = (0.0, 0.0)
    free = np.asarray(load.acceleration(angles, rest, rest))
    units = [load.acceleration(angles, rest, unit) for unit in ((1.0, 0.0), (0.0, 1.0))]
    return np.linalg.solve((np.asarray(units) - free).T, free)


def test_motor_position_feedback_holds_a_load_that_torque_control_drops() -> None:
    """Section 3.4.1, theta_L = (1.8, 2.1): K_L is negative definite."""
    angles = (1.8, 2.1)
    dropped = poles(ARM, arm_law(), angles)
    assert sorted(dropped.real)[-2:] == pytest.approx([2.3118, 3.4511], abs=1e-3)
    hold = Decentral(tuple(MotorPosition(0.1, 150.0 * q) for q in angles))

    def held(K_i: float) -> np.ndarray:
        return poles(ARM, Decentral((PITorque(0.05, K_i), PITorque(0.05, K_i))) + hold, angles)

    stable = held(0.0)
    stable = stable[np.abs(stable) > 1e-9]  # not the two integrals that are read by nothing
    assert len(stable) == 10
    assert stable.real.max() < -2.0
    assert held(1.0).real.max() > 0.0


def test_joint_laws_and_motors_survive_a_file() -> None:
    lead = Lead(PITorque(2.0, 12.5), *LEAD) + MotorPosition(0.1)
    law = Decentral((lead, PITorque(2.0, 25.0))) + PositiveFeedback.design(ARM, alpha_j=0.5)
    for base, whole in (
        (Control, law),
        (Control, Sampled(law, 1e-3)),
        (Drive, rippled(ARM, AMPLITUDE)),
        (Drive, leg_with_everything()),
    ):
        table = dump(whole)
        assert dump(build(base, table, "file")) == table
    design = {"type": "positive_feedback", "design": {"alpha_j": 0.5, "alpha_a": 1, "alpha_v": 1}}
    assert dump(build(Control, design, "law", ARM)) == dump(law.laws[1])
