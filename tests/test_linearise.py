"""Linear systems from drives and closed loops, against closed forms and finite differences."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from jaxsim.derivatives.butterworth import Butterworth as FilterLaw
from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.drives.leg_2014 import leg_2014
from jaxsim.drives.two_link_arm_2014 import two_link_arm_2014
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import Decentral
from jaxsim.laws.feedforward import Feedforward
from jaxsim.laws.lead import Lead as LeadLaw
from jaxsim.laws.motor_position import MotorPosition
from jaxsim.laws.pd import PD
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.positive_feedback import PositiveFeedback, gammas
from jaxsim.laws.prefilter import Prefilter
from jaxsim.laws.switched_damping import SwitchedDamping
from jaxsim.linear.frequency import bandwidth, margins, response
from jaxsim.linear.joints import plant, transmission_zeros
from jaxsim.linear.linearise import joint_system, linearise
from jaxsim.linear.stability import stable_intervals
from jaxsim.linear.state_space import StateSpace, per_axis, poles
from jaxsim.linear.torque_loop import Butterworth, Lead, TorqueLaw, closed_loop
from jaxsim.linear.zeros import zeros
from jaxsim.loop import ClosedLoop
from jaxsim.motors.dc import Ripple
from jaxsim.motors.friction import Stribeck
from jaxsim.sampled import Sampled
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.transmissions.backlash import Backlash

ROUNDING = 1e-11  # relative: entries are sums and quotients of a few numbers
POSITION = PD(10.28129662037006, 0.05470907749696041, 5.82812354062619e-3)  # 2018 paper, errata
J_M = J_L = 8.78e-4
D_M, D_L, K, D_B = 9.30e-2, 3.60e-2, 3.00e2, 1.00e-1


def loop(drive: Drive, law: Any) -> ClosedLoop:
    return ClosedLoop(drive, law, Scenario(), Exact(), dt=1e-4)


def arm_loop(law: Any) -> ClosedLoop:
    idle, start = (Constant(), Constant()), (Start(), Start())
    scenario = Scenario(reference=idle, load_torque=idle, start=start)
    return ClosedLoop(two_link_arm_2014(), law, scenario, Exact(), dt=1e-4)


def _sorted(values: np.ndarray) -> np.ndarray:
    return np.sort_complex(np.round(values, 9))


# --- the backlash drive in its contact modes ------------------------------------------------------

S = Polynomial([0.0, 1.0])
MOTOR, LOAD, GEAR = D_M * S + J_M * S**2, D_L * S + J_L * S**2, K + D_B * S


@pytest.mark.parametrize("contact", [1, -1, 0])
def test_poles_and_zeros_of_the_bench_are_those_of_its_polynomials(contact: int) -> None:
    gear = GEAR if contact else 0.0 * S
    system = linearise(bench_2018(), contact=contact).system
    characteristic = (MOTOR * LOAD + gear * (MOTOR + LOAD)).trim()
    np.testing.assert_allclose(
        _sorted(poles(system)), _sorted(characteristic.roots()), rtol=1e-9, atol=1e-9
    )
    if contact:  # from command to joint torque: the free load, and the gear's own zero
        found = zeros(system.channel(["T_s"], ["command"]))
        expected = (LOAD * GEAR).roots()
        np.testing.assert_allclose(_sorted(found), _sorted(expected), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("contact", [1, 0])
def test_poles_of_the_closed_loop_in_contact_and_in_the_gap(contact: int) -> None:
    gear, tau = (GEAR if contact else 0.0 * S), 5.82812354062619e-3
    law = 10.28129662037006 * (1.0 + tau * S) + 0.05470907749696041 * S
    rigid = MOTOR * LOAD + gear * (MOTOR + LOAD)
    expected = (rigid * (1.0 + tau * S) + gear * law).trim().roots()
    found = linearise(loop(bench_2018(), Prefilter(POSITION, 20.0)), 0.3, contact=contact)
    assert len(found.x) == 6  # four of the plant, one of each filter: errata, part A
    assert found.reference == pytest.approx(0.3, abs=1e-12)
    np.testing.assert_allclose(
        _sorted(poles(found.system)), _sorted(np.append(expected, -40.0 * math.pi)),
        rtol=1e-8, atol=1e-8,
    )  # fmt: skip


def test_margins_work_in_a_contact_mode() -> None:
    # K_P theta_L back to the command: unstable where MOTOR LOAD + GEAR (MOTOR + LOAD + K_P) is.
    drive = linearise(bench_2018(), contact=1).system.channel(["theta_L"], ["command"])
    gain = margins(StateSpace(drive.A, drive.B, drive.C, drive.D, *_names(drive))).gain
    for factor, stable in ((1.0 - 1e-7, True), (1.0 + 1e-7, False)):
        rest = MOTOR * LOAD + GEAR * (MOTOR + LOAD + factor * gain)
        assert bool(np.real(rest.roots()).max() < 0.0) is stable


def _names(system: StateSpace) -> tuple[tuple[str, ...], ...]:
    return system.states, system.inputs, system.outputs


def test_modes_of_a_switching_law_are_chosen_by_name() -> None:
    closed = loop(bench_2018(), POSITION + SwitchedDamping(K_B=-0.8))
    on = linearise(closed, contact=1, modes={"omega_B": 1.0, "omega_L": 1.0})
    off = linearise(closed, contact=1, modes={"omega_B": 1.0, "omega_L": -1.0})
    bare = linearise(loop(bench_2018(), POSITION), contact=1)
    assert on.modes == {"contact+": 1.0, "contact-": -1.0, "omega_B": 1.0, "omega_L": 1.0}
    np.testing.assert_array_equal(off.system.A, bare.system.A)
    row = on.system.states.index("omega_M")
    column = on.system.states.index("omega_M")  # K_B omega_B, and omega_B has omega_M in it
    assert (on.system.A - off.system.A)[row, column] == pytest.approx(-0.8 / J_M, rel=ROUNDING)


def test_the_rest_carries_the_load() -> None:
    found = linearise(bench_2018(), contact=1, d_L=-2.0)
    at = dict(zip(found.system.states, found.x, strict=True))
    assert at["theta_B"] == pytest.approx(7.8e-3 + 2.0 / K, rel=1e-12)
    assert found.reference == pytest.approx(2.0, rel=1e-12)


# --- the paper's joints out of the composed drives ------------------------------------------------


@pytest.mark.parametrize("q", [(0.0, 0.5), (math.pi / 2, math.pi / 2), (1.8, 2.1), (-0.7, 1.3)])
def test_the_arm_has_the_matrices_of_30_to_32(q: tuple[float, float]) -> None:
    joints = joint_system(two_link_arm_2014(), np.array(q))
    c2, hang = math.cos(q[1]), 1.034 * math.cos(q[0] + q[1])
    M_L = [[0.3047 + 0.1908 * c2, 0.0871 + 0.0954 * c2], [0.0871 + 0.0954 * c2, 0.0871]]
    K_L = [[6.6438 * math.cos(q[0]) + hang, hang], [hang, hang]]
    for found, expected in ((joints.M_L, M_L), (joints.K_L, K_L), (joints.B_L, 0.01 * np.eye(2))):
        np.testing.assert_allclose(found, expected, rtol=ROUNDING, atol=1e-12)
    drive = {"L": 3.2e-4, "R": 0.664, "K_t": 0.041, "K_w": 0.041, "J_m": 1.387e-5, "B_m": 1.996e-5,
             "N": 150.0, "K_H": 912.0}  # fmt: skip
    for name, value in drive.items():
        np.testing.assert_allclose(getattr(joints, name), value, rtol=ROUNDING)


def test_the_general_linearisation_is_that_of_the_joint_system() -> None:
    q = np.array([0.4, -0.9])
    general = linearise(two_link_arm_2014(), q, contact=1).system
    paper = plant(joint_system(two_link_arm_2014(), q))
    np.testing.assert_allclose(_sorted(poles(general)), _sorted(poles(paper)), atol=1e-7)
    for source in ("command", "tau_d", "d_L"):
        inputs = per_axis(source, 2)
        for signal in ("T_s", "theta_L", "omega_B", "theta_M"):
            outputs = per_axis(signal, 2)
            a, b = (response(s.channel(outputs, inputs), 20.0) for s in (general, paper))
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max())
    found = zeros(general.channel(per_axis("T_s", 2), per_axis("command", 2)))
    expected = transmission_zeros(joint_system(two_link_arm_2014(), q))
    np.testing.assert_allclose(_sorted(found), _sorted(expected), atol=1e-8)


def test_a_joint_with_play_is_the_same_in_contact() -> None:
    q, drive = np.array([0.0, 0.5]), two_link_arm_2014()
    played = replace(drive, transmission=(Backlash(K=912.0, half_gap=1e-3, N=150.0),) * 2)
    for contact in (1, (1, -1)):
        a, b = joint_system(drive, q), joint_system(played, q, contact=contact)
        np.testing.assert_allclose(plant(b).A, plant(a).A, rtol=1e-9, atol=1e-6)


def test_ripple_and_friction_are_disturbances_of_the_joint_system_but_not_of_the_drive() -> None:
    drive = leg_2014()
    ripple = Ripple(amplitude=0.013, order=2.0, phase=-math.pi / 2)
    friction = Stribeck(0.01, 0.015, 2.0)
    rough = eqx.tree_at(
        lambda d: (d.motor[0].ripple, d.motor[0].friction), drive, (ripple, friction),
        is_leaf=lambda v: v is None,
    )  # fmt: skip
    np.testing.assert_array_equal(plant(joint_system(rough)).A, plant(joint_system(drive)).A)
    with_ripple = eqx.tree_at(
        lambda d: d.motor[0].ripple, drive, ripple, is_leaf=lambda v: v is None
    )
    a, b = (linearise(d, contact=1).system for d in (with_ripple, drive))
    slope = (a.A - b.A)[a.states.index("omega_M"), a.states.index("theta_L")]
    assert slope == pytest.approx(0.026 * 150.0 / 2.21437e-5, rel=1e-9)  # N d ripple/d theta_M
    stuck = linearise(rough, contact=1)
    assert stuck.modes["slip+"] < 0.0
    assert not stuck.system.A[stuck.system.states.index("omega_M")].any()


def test_slopes_are_those_of_finite_differences_of_the_field() -> None:
    from jaxsim.linear.flat import FlatLoop

    found = linearise(two_link_arm_2014(), np.array([0.3, 0.8]), contact=1)
    flat = FlatLoop.of(two_link_arm_2014())
    u = np.concatenate([found.reference, np.zeros(4)])
    field = jax.jit(lambda x: flat.field(x, u, ()))
    assert np.abs(np.asarray(field(found.x))).max() < 1e-6  # rest: 1e-12 of K_H theta_B/J_m
    for k, name in enumerate(found.system.states):
        h = 1e-6 * max(1.0, abs(found.x[k])) * (1e-3 if "theta_B" in name else 1.0)
        step = h * np.eye(len(found.x))[k]
        slope = (np.asarray(field(found.x + step)) - np.asarray(field(found.x - step))) / (2.0 * h)
        column = found.system.A[:, k]
        assert np.abs(slope - column).max() <= 1e-6 * max(np.abs(column).max(), 1.0)


def test_the_result_is_float64_whatever_the_caller_runs_in() -> None:
    with jax.enable_x64(False):
        joints = joint_system(leg_2014())
    assert joints.L[0] == pytest.approx(4.9066e-4, rel=ROUNDING)


def test_the_leg_runs_through_the_same_functions() -> None:
    channel = linearise(leg_2014(), contact=1).system.channel(["T_s"], ["command"])
    assert bandwidth(channel) == pytest.approx(
        bandwidth(plant(joint_system(leg_2014())).channel(["T_s"], ["command"])), rel=1e-9
    )


# --- torque laws: the simulated loop is the one that is analysed -------------------------------

PI_TORQUE = Decentral((PITorque(2.0, 12.5), PITorque(2.0, 25.0)))
GAINS = TorqueLaw(2.0, np.array([12.5, 25.0]))


@pytest.mark.parametrize(
    ("law", "linear"),
    [
        (PI_TORQUE + PositiveFeedback.design(two_link_arm_2014()), GAINS),
        (PI_TORQUE, GAINS.weighted(0.0)),
        (
            PI_TORQUE + PositiveFeedback.design(two_link_arm_2014(), 0.0, 0.0, 1.0),
            replace(GAINS, alpha_j=0.0, alpha_a=0.0),
        ),
        (
            Decentral(tuple(LeadLaw(law, 128.0, 628.0) for law in PI_TORQUE.laws))
            + PositiveFeedback.design(two_link_arm_2014()),
            replace(GAINS, lead=Lead(128.0, 628.0)),
        ),
        (
            PI_TORQUE + PositiveFeedback.design(two_link_arm_2014(), source=FilterLaw(50.0, 3)),
            replace(GAINS, derivatives=Butterworth(100.0 * math.pi, 3)),
        ),
    ],
    ids=["full", "none", "velocity_only", "lead", "filtered"],
)
def test_the_torque_loop_of_the_engine_is_that_of_the_linear_analysis(
    law: Any, linear: TorqueLaw
) -> None:
    q, drive = np.array([0.0, 0.5]), two_link_arm_2014()
    found = linearise(arm_loop(law), q)
    paper = closed_loop(joint_system(drive, q), linear)
    np.testing.assert_allclose(
        found.reference, [1.034 * math.sin(0.5)] * 2, rtol=1e-9
    )  # the torques that hold the arm, (31)
    a, b = poles(found.system), poles(paper)
    assert len(a) == len(b)
    nearest = np.abs(a[:, None] - b[None, :]).min(axis=1)
    assert np.all(nearest <= 1e-7 * (1.0 + np.abs(a)))
    for source in ("reference", "tau_d"):
        names = per_axis("T_s", 2), per_axis(source, 2)
        for omega in (1.0, 40.0, 250.0):
            x, y = (response(s.channel(*names), omega) for s in (found.system, paper))
            np.testing.assert_allclose(x, y, atol=1e-8 * max(1.0, np.abs(y).max()))


def test_motor_position_feedback_holds_a_falling_load_and_leaves_its_zeros() -> None:
    # Section 3.4.1 at (1.8, 2.1): two unstable eigenvalues, two zeros in the right half plane.
    q, drive = np.array([1.8, 2.1]), two_link_arm_2014()
    joint = plant(joint_system(drive, q))
    spring = joint.channel(per_axis("theta_M", 2), per_axis("command", 2))
    ((least, most),) = stable_intervals(spring.A, -spring.B @ spring.C)
    np.testing.assert_allclose([least, most], [0.0018549318, 85.805683], rtol=1e-6)
    for K_theta, stable in ((0.999 * least, False), (1.001 * least, True)):
        angles = 150.0 * q  # about where it is to hold; a constant voltage makes up the rest
        voltage = Feedforward(command_unit="V")
        law = Decentral(tuple(voltage + MotorPosition(K_theta, a) for a in angles))
        held = linearise(arm_loop(law), q).system
        assert bool(poles(held)[0].real < 0.0) is stable
        found = zeros(held.channel(per_axis("T_s", 2), per_axis("reference", 2)))
        expected = transmission_zeros(joint_system(drive, q))
        np.testing.assert_allclose(_sorted(found), _sorted(expected), atol=1e-7)


def test_the_gammas_of_the_law_and_of_the_analysis_agree() -> None:
    for own, law in zip(joint_system(leg_2014()).gammas(), gammas(leg_2014()), strict=True):
        np.testing.assert_allclose(own, law, rtol=ROUNDING)


# --- input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: linearise(leg_2014(), contact=0), "contact"),
        (lambda: linearise(two_link_arm_2014(), contact=(1, 1, 1)), "contact"),
        (lambda: linearise(bench_2018(), modes={"contcat+": 1.0}), "modes"),
        (lambda: linearise(bench_2018(), contact=0, d_L=1.0), "theta_L"),
        (lambda: linearise(loop(bench_2018(), Sampled(POSITION, 4e-4))), "law"),
        (lambda: joint_system(bench_2018()), "drive.motor"),
        (lambda: joint_system(eqx.tree_at(lambda d: d.transmission[0].D_B, leg_2014(),
                                          np.float64(0.1))), "drive"),
        (lambda: linearise(two_link_arm_2014(), np.zeros(3)), "theta_L"),
    ],
)  # fmt: skip
def test_bad_input_names_its_field(make: Any, field: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.field == field
