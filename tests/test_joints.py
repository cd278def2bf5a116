"""Flexible joints: the 2014 paper's arm and leg against scipy, closed forms and each other."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joint_cases import (
    AGREES,
    AMPLITUDE,
    ARM,
    DT,
    FINE,
    IMPACT,
    LEAD,
    NO_LEAD,
    SINGLE,
    STEP,
    TURNS,
    arm_law,
    arm_run,
    arm_scenario,
    leg_with_everything,
    rippled,
    torque,
)
from joint_oracle import Arm, Leg, linear_torque

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.batch import spread
from jaxsim.drive import Drive
from jaxsim.drives.leg_2014 import leg_2014
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import Decentral
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.positive_feedback import PositiveFeedback
from jaxsim.loads.general import Mechanism
from jaxsim.loads.pendulum import Pendulum
from jaxsim.loads.two_link import TwoLink
from jaxsim.run import Run
from jaxsim.scenario import Scenario
from jaxsim.signals.step import Step
from jaxsim.status import Status
from jaxsim.transmissions.backlash import Backlash

# --- the arm --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("alpha", "amplitude", "lead"),
    [(1.0, 0.0, None), (0.0, 0.0, None), (0.5, AMPLITUDE, None), (1.0, AMPLITUDE, LEAD)],
)
def test_arm_agrees_with_dop853(
    alpha: float, amplitude: float, lead: tuple[float, float] | None
) -> None:
    run = arm_run(arm_law(alpha, lead or NO_LEAD), amplitude=amplitude)
    want = Arm(alpha=alpha, ripple=amplitude, lead=lead).torques(np.asarray(run.time))
    assert np.abs(torque(run) - want).max() < AGREES
    assert run.events() == []


def test_full_feedback_takes_the_load_out_of_the_torque_loop() -> None:
    """Remark 1: the nonlinear arm's torque is the linear prediction (20), from hanging rest."""
    run = arm_run(arm_law(), q2=0.0)
    want = linear_torque(2.0, 12.5, STEP, np.asarray(run.time))
    assert np.abs(torque(run)[:, 0] - want).max() < AGREES
    assert np.abs(torque(run)[:, 1]).max() < AGREES
    assert np.ptp(np.asarray(run.signals["theta_L"])[:, 0]) > 0.5  # and the arm does swing


def test_full_feedback_decouples_to_rounding_at_a_fine_step() -> None:
    run = arm_run(arm_law(), q2=0.0, dt=2e-5, duration=0.2)
    want = linear_torque(2.0, 12.5, STEP, np.asarray(run.time))
    assert np.abs(torque(run) - np.stack([want, 0.0 * want], axis=-1)).max() < FINE


def test_arm_in_float32() -> None:
    run = arm_run(arm_law(lead=LEAD), amplitude=AMPLITUDE, dtype="float32")
    assert run.signals["T_s"].dtype == np.float32
    want = Arm(ripple=AMPLITUDE, lead=LEAD).torques(np.asarray(run.time, float))
    assert np.abs(torque(run) - want).max() < SINGLE


@pytest.mark.slow
@pytest.mark.parametrize(("lead", "want"), [(NO_LEAD, (0.0946, 0.0727)), (LEAD, (0.0643, 0.0387))])
def test_ripple_rms(lead: tuple[float, float], want: tuple[float, float]) -> None:
    """Errata, part B: 0-15 s, 1 kHz samples; the paper has 0.0961, 0.0725, 0.0640, 0.0391."""
    run = arm_run(arm_law(lead=lead), amplitude=AMPLITUDE, duration=15.0, store=4)
    rms = np.sqrt(np.mean((torque(run) - [STEP, 0.0]) ** 2, axis=0))
    assert rms == pytest.approx(want, abs=5e-5)


def test_torque_metrics() -> None:
    """Against the stored samples; angles compared with a torque give nan."""
    names = ("torque_error_rms_Nm", "torque_overshoot_pct", "torque_settle_2pct_s", "overshoot_pct")
    scenario = Scenario(Step(STEP), duration=0.5)
    law = Decentral((PITorque(2.0, 10.0),)) + PositiveFeedback.design(leg_2014())
    run = simulate(leg_2014(), law, scenario, dt=DT, metrics=names)
    error = STEP - torque(run)
    outside = np.flatnonzero(np.abs(error) > 0.02 * STEP)
    assert run.metrics["torque_overshoot_pct"] == pytest.approx(-100 * error.min() / STEP, rel=1e-3)
    settled = float(run.metrics["torque_settle_2pct_s"])
    assert run.time[outside[-1]] < settled <= run.time[outside[-1] + 1]
    trapezia = 0.5 * DT * (error[1:] ** 2 + error[:-1] ** 2).sum()
    rms = float(run.metrics["torque_error_rms_Nm"])
    assert rms == pytest.approx(np.sqrt(trapezia / 0.5), rel=1e-4)
    assert np.isnan(run.metrics["overshoot_pct"])


# --- joints with and without play -----------------------------------------------------------------


def test_a_gap_of_zero_is_an_elastic_joint() -> None:
    leg, law = leg_2014(), PITorque(2.0, 10.0)
    play = Drive(leg.motor, Backlash(K=930.0, half_gap=0.0, N=150.0), leg.load)
    scenario = Scenario(Step(STEP, 0.01), (Step(20.0, 0.1),), duration=0.3)
    smooth, played = (simulate(d, law, scenario, dt=DT, metrics=()) for d in (leg, play))
    assert smooth.events() == []
    assert played.events() != []  # the torque changes sign
    assert np.abs(torque(smooth) - torque(played)).max() < FINE
    assert np.all(np.asarray(smooth.signals["contact"]) == 1.0)


def gap_arm() -> Drive:
    play = Backlash(K=912.0, half_gap=1e-3, N=150.0)
    return Drive(ARM.motor, (play, play), ARM.load)


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [1.0, 0.0])
def test_arm_with_play_completes(alpha: float) -> None:
    """1 mrad per joint under torque control, with ripple: no paper has it; it simply runs."""
    drive = rippled(gap_arm(), AMPLITUDE)
    coarse, fine = (
        simulate(drive, arm_law(alpha), arm_scenario(), dt=dt, metrics=(), deadzone=Exact(2000))
        for dt in (DT, DT / 2)
    )
    assert coarse.status == Status.OK
    # With full feedback the motor of joint 2 follows its load, which then never leaves the gap.
    touched = {e.surface for e in coarse.events() if "contact" in e.surface}
    assert touched == {"contact+[0]"} if alpha == 1.0 else len(touched) > 2
    first, again = (run.events()[0] for run in (coarse, fine))
    assert first.surface == again.surface == "contact+[0]"
    assert first.time == pytest.approx(again.time, rel=1e-6)
    early = slice(0, 400)  # 0.1 s
    assert np.abs(torque(coarse)[early] - torque(fine)[::2][early]).max() < 1e-3


def certificate(cost, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward, reverse and finite-difference gradients, each times the parameter."""
    cost, forward, reverse = jax.jit(cost), jax.jit(jax.jacfwd(cost)), jax.jit(jax.grad(cost))
    differences = []
    for i, value in enumerate(at):
        h = 1e-5 * value * np.eye(len(at))[i]
        differences.append((cost(at + h) - cost(at - h)) / 2e-5)
    return forward(at) * at, reverse(at) * at, np.asarray(differences)


def arm_cost(drive: Drive, names: list[str]):
    joints = Decentral((PITorque(2.0, 12.5), PITorque(2.0, 25.0)))
    law = joints + PositiveFeedback.design(ARM)

    def cost(values):
        named = dict(zip(names, values, strict=True))
        gap = {k: named.pop(k) for k in list(named) if "half_gap" in k}
        run = simulate(
            tree.replace(drive, gap), tree.replace(law, named), arm_scenario(0.5, 0.1, 1.0),
            dt=DT, metrics=(), throw=False,
        )  # fmt: skip
        return jnp.mean((run.signals["T_s"] - jnp.asarray([[STEP, 1.0]])) ** 2)

    return cost


GAINS = ["laws[0].laws[0].K_p", "laws[0].laws[1].K_i", "alpha_j", "alpha_a", "alpha_v"]
VALUES = [2.0, 25.0, 1.0, 1.0, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "names", "values", "tolerance"),
    [
        (ARM, GAINS, VALUES, TURNS),
        (gap_arm(), [*GAINS, "transmission[1].half_gap"], [*VALUES, 1e-3], IMPACT),
    ],
    ids=["elastic", "gap"],
)
@pytest.mark.filterwarnings("ignore:PositiveFeedback.alpha")
def test_gradients_of_the_arm(drive: Drive, names, values, tolerance: float) -> None:
    forward, reverse, differences = certificate(arm_cost(drive, names), np.array(values))
    size = np.abs(forward).max()
    assert np.abs(forward - reverse).max() < 1e-12 * size
    assert np.abs(forward - differences).max() < tolerance * size
    assert np.abs(forward).min() > 0.0


def test_stick_slip_and_saturation_agree_event_by_event() -> None:
    """Friction with a true stick and a cut voltage, located: scipy stops at every event, too."""
    scenario = Scenario(Step(STEP), duration=1.0)
    run = simulate(leg_with_everything(), PITorque(2.0, 10.0), scenario, dt=DT, metrics=())
    events, state = Leg().run(1.0)
    kinds = {"slip": ("stop", "go"), "limi": ("cut", "uncut")}
    seen = [e for e in run.events() if not _second_half(e, run)]
    for mine, (time, kind) in zip(seen, events, strict=True):
        assert kind in kinds[mine.surface[:4]]
        assert mine.time == pytest.approx(time, abs=1e-8)
    assert float(run.signals["theta_L"][-1]) == pytest.approx(state[0], abs=1e-9)
    assert torque(run)[-1] == pytest.approx(930.0 * (state[2] / 150.0 - state[0]), abs=AGREES)
    stuck = (np.asarray(run.time) > 0.8341) & (np.asarray(run.time) < 0.8514)
    assert np.abs(np.asarray(run.signals["omega_M"])[stuck]).max() < 1e-9


def _second_half(event, run: Run) -> bool:
    """A reversal is two events at one instant, a stop and a go; scipy's one."""
    before = [e for e in run.events() if e.time == event.time]
    return len(before) == 2 and before[1] == event


@pytest.mark.slow
def test_gradients_through_stick_slip_and_saturation() -> None:
    drive, law = leg_with_everything(), PITorque(2.0, 10.0)

    def cost(values):
        named = dict(zip(("Fc", "Fs", "limit"), values[:3], strict=True))
        run = simulate(
            tree.replace(drive, named), tree.replace(law, {"K_p": values[3]}),
            Scenario(Step(STEP), duration=0.1), dt=DT, metrics=(), throw=False,
        )  # fmt: skip
        return jnp.mean((run.signals["T_s"] - STEP) ** 2)

    forward, reverse, differences = certificate(cost, np.array([0.010, 0.015, 4.0, 2.0]))
    size = np.abs(forward).max()
    assert np.abs(forward - reverse).max() < 1e-12 * size
    assert np.abs(forward - differences).max() < TURNS * size


# --- loads ----------------------------------------------------------------------------------------


def mass(q, p):
    c = p[2] * jnp.cos(q[1])
    return ((p[0] + 2.0 * c, p[1] + c), (p[1] + c, p[1]))


def coriolis(q, w, p):
    s = p[2] * jnp.sin(q[1])
    return -s * (2.0 * w[0] * w[1] + w[1] * w[1]), s * w[0] * w[0]


def gravity(q, p):
    hang = p[4] * jnp.sin(q[0] + q[1])
    return p[3] * jnp.sin(q[0]) + hang, hang


NUMBERS = (0.3047, 0.0871, 0.0954, 6.6438, 1.034)


def test_a_general_mechanism_is_the_two_link_arm() -> None:
    general = Mechanism(mass, coriolis, gravity, D_L=(0.01, 0.01), p=NUMBERS)
    where = (0.4, 2.0), (-1.5, 3.0), (2.0, -0.3)
    assert general.axes == 2
    want = np.asarray(ARM.load.acceleration(*where))
    assert np.asarray(general.acceleration(*where)) == pytest.approx(want, rel=1e-12)


def test_a_mechanism_of_four_joints_is_solved_like_numpy() -> None:
    half = np.random.default_rng(1).normal(size=(4, 4))
    M = half @ half.T + np.eye(4)
    zero = (0.0,) * 4
    load = Mechanism(lambda q, p: M.tolist(), lambda q, w, p: zero, lambda q, p: zero, D_L=zero)
    rhs = (1.0, -2.0, 0.5, 3.0)
    solved = np.asarray(load.acceleration(zero, zero, rhs))
    assert solved == pytest.approx(np.linalg.solve(M, rhs), rel=1e-12)


def test_the_pendulum_swings_at_its_frequency() -> None:
    """A rod alone: J = m l^2/3, weight at l/2, omega^2 = 1.5 g/l; and a point mass: g/l."""
    for mass_, rod, factor in ((1e-12, 2.0, 1.5), (2.0, 0.0, 1.0)):
        load = Pendulum(mass=mass_, length=0.5, rod=rod)
        (slope,) = load.acceleration((1e-6,), (0.0,), (0.0,))
        assert -float(slope) / 1e-6 == pytest.approx(factor * 9.81 / 0.5, rel=1e-9)


def test_a_mass_matrix_that_turns_indefinite_stops_the_run_and_is_named() -> None:
    load = Mechanism(
        lambda q, p: ((p[0] + p[1] * jnp.cos(q[0]),),),
        lambda q, w, p: (0.0 * w[0],),
        lambda q, p: (0.0 * q[0],),
        D_L=(0.01,),
        p=(0.1, 0.2),
    )
    leg = leg_2014()
    law = spread(PITorque(2.0, 10.0), K_p=[2.0, 0.0])  # the second one never moves
    run = simulate(
        Drive(leg.motor, leg.transmission, load), law, Scenario(Step(3.0), duration=1.0), dt=DT,
        metrics=(), throw=False,
    )  # fmt: skip
    assert np.asarray(run.status).tolist() == [Status.SINGULAR, Status.OK]
    assert "mass matrix is not positive definite" in run.failures()[0]


def test_links_that_cannot_exist_are_refused() -> None:
    with pytest.raises(InputError, match=r"TwoLink\.coupling: must keep M"):
        TwoLink(0.3047, 0.0871, 0.2, 6.6438, 1.034)
    with pytest.raises(InputError, match=r"Mechanism\.G: must give 2"):
        Mechanism(mass, coriolis, lambda q, p: (0.0,), D_L=(0.0, 0.0), p=NUMBERS)
