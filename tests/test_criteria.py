"""Stability criteria against the exact linear analysis, differences and runs made by hand."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.analysis import Analysis, analyse
from jaxsim.criteria.margins import CommandMargins, TorqueMargins
from jaxsim.criteria.poles import ContactPoles, GapPoles
from jaxsim.criterion import Criterion, Subject
from jaxsim.derivatives.butterworth import Butterworth as FilterLaw
from jaxsim.derivatives.levant import Levant
from jaxsim.drives.two_link_arm_2014 import two_link_arm_2014
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import Decentral
from jaxsim.laws.lead import Lead
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.positive_feedback import PositiveFeedback
from jaxsim.linear import torque_loop
from jaxsim.linear.frequency import margins
from jaxsim.linear.stability import abscissa
from jaxsim.linear.torque_loop import TorqueLaw, open_loop, torque_dynamics
from jaxsim.loads.payload import TwoLinkPayload
from jaxsim.loads.two_link import TwoLink
from jaxsim.loop import ClosedLoop
from jaxsim.objective import Goal, Limit, Objective, read_objective
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.sampled import Sampled
from jaxsim.scenario import Scenario
from jaxsim.signals.constant import Constant
from jaxsim.study import Study, from_table, load
from tuning.local import RESERVE, localise
from tuning.problem import Problem
from tuning.spec import read_spec

SAME = 1e-7  # relative: crossings by bisection, against the generalised eigenvalue problem
SLOPE = 1e-6  # relative: against central differences with a step of 1e-5
SETTINGS = (ContactPoles, CommandMargins, GapPoles)


def measured(loop: ClosedLoop, *groups: type[Criterion]) -> dict[str, Any]:
    def never(scenario: Any, names: Any) -> dict[str, Any]:
        raise AssertionError("no run is needed")

    subject = Subject(loop, never)
    return {k: v for group in groups for k, v in group().measure(subject).items()}


def loop_of(study: Study) -> ClosedLoop:
    return ClosedLoop(study.drive, study.law, study.scenario, Exact(), study.run.dt)


def at_factors(study: Study, names: tuple[str, ...], *groups: type[Criterion]) -> Callable:
    """The numbers as a function of factors on parameters of the law."""
    paths = [tree.resolve(study.law, name) for name in names]

    def numbers(factors: Any) -> dict[str, Any]:
        own = {p: factors[i] * tree.get(study.law, p) for i, p in enumerate(paths)}
        return measured(loop_of(study._replace(law=tree.replace(study.law, own))), *groups)

    return jax.jit(numbers)


@pytest.fixture(scope="module")
def bench() -> Study:
    return load("bench_switched")


@pytest.fixture(scope="module")
def bench_numbers(bench: Study) -> Callable:
    return at_factors(bench, ("K_B", "K_D"), *SETTINGS)


@pytest.fixture(scope="module")
def bench_analysis(bench: Study) -> Analysis:
    return analyse(bench)


def test_the_bench_is_as_the_exact_analysis_has_it(
    bench_numbers: Callable, bench_analysis: Analysis
) -> None:
    found = bench_numbers(jnp.ones(2))
    contact = [m for m in bench_analysis.modes if m.name.startswith("contact")]
    edges = [m.margins[0] for m in contact]
    poles = np.concatenate([m.poles for m in contact])
    assert len(contact) == 4
    assert found["rightmost_pole_per_s"] == pytest.approx(np.real(poles).max(), rel=SAME)
    assert found["least_damping"] == pytest.approx(
        (-np.real(poles) / np.abs(poles)).min(), rel=SAME
    )
    gain = min(e.gain for e in edges if e)
    assert found["gain_margin_dB"] == pytest.approx(20.0 * np.log10(gain), rel=SAME)
    assert found["gain_reduction_dB"] == 60.0  # stable for all smaller gains
    phase = min(e.phase for e in edges if e)
    assert found["phase_margin_deg"] == pytest.approx(np.degrees(phase), rel=SAME)
    # In the gap: the motor's own speed; the load alone and the deflection are left out.
    assert found["rightmost_gap_pole_per_s"] == pytest.approx(-9.30e-2 / 8.78e-4, rel=1e-9)


def test_gradients_both_ways_are_the_differences(bench_numbers: Callable) -> None:
    at, step = jnp.array([0.93, 1.1]), 1e-5
    forward = jax.jacfwd(bench_numbers)(at)
    reverse = jax.jacrev(lambda f: bench_numbers(f)["gain_margin_dB"])(at)
    for i, unit in enumerate(np.eye(2)):
        up, down = bench_numbers(at + step * unit), bench_numbers(at - step * unit)
        for name, slope in forward.items():
            difference = (up[name] - down[name]) / (2.0 * step)
            error = np.abs(slope[..., i] - difference).max()
            assert error <= SLOPE * (1.0 + np.abs(difference).max()), name
    np.testing.assert_allclose(reverse, forward["gain_margin_dB"], rtol=1e-9)
    assert np.abs(forward["gain_margin_dB"]).min() > 0.01


def test_margins_pass_through_zero_where_stability_ends(
    bench: Study, bench_analysis: Analysis
) -> None:
    """Signed: an unstable loop says how far it is from a stable one."""
    mode = next(m for m in bench_analysis.modes if m.name == "contact+, omega_B+ omega_L+")
    assert mode.margins[0] is not None
    edge = mode.margins[0].gain
    numbers = at_factors(bench, ("K_P", "K_D", "K_B"), ContactPoles, CommandMargins)
    for factor in (0.99, 1.01):
        found = numbers(jnp.full(3, factor * edge))
        wanted = -20.0 * np.log10(factor)
        assert found["gain_margin_dB"] == pytest.approx(wanted, rel=1e-6)
        assert np.sign(found["phase_margin_deg"]) == np.sign(wanted)
        assert np.sign(found["rightmost_pole_per_s"]) == -np.sign(wanted)


def arm(alpha: float, weight: float = 1.0, pose: tuple[float, float] = paper.POSE) -> ClosedLoop:
    """The arm with PI, lead and filtered derivatives."""
    drive = two_link_arm_2014()
    law = Decentral(tuple(Lead(PITorque(2.0, k), *paper.LEAD) for k in paper.K_I))
    law += PositiveFeedback.design(drive, alpha, alpha, alpha, source=FilterLaw(50.0))
    load = replace(drive.load, gravity_1=weight * 6.6438, gravity_2=weight * 1.034)
    still = (Constant(), Constant())
    start = paper.arm_scenario(pose=pose).start
    return ClosedLoop(replace(drive, load=load), law, Scenario(still, still, start), Exact(), 1e-4)


def same_arm(alpha: float) -> TorqueLaw:
    law = paper.WITH_LEAD.scaled(paper.K_O).weighted(alpha)
    return replace(law, derivatives=torque_loop.Butterworth(50.0 * paper.HZ, 3))


@pytest.fixture(scope="module")
def arm_numbers() -> Callable:
    def numbers(alpha: Any, weight: Any, pose: Any) -> dict[str, Any]:
        return measured(arm(alpha, weight, tuple(pose)), ContactPoles, TorqueMargins)

    return jax.jit(numbers)


def test_the_arm_is_as_the_torque_loop_has_it(arm_numbers: Callable) -> None:
    """Cut inside the positive feedback: k_o of (34), one joint at a time."""
    pose = (0.8, -0.5)
    found = arm_numbers(0.9, 1.0, jnp.array(pose))
    system, law = paper.arm(pose), same_arm(0.9)
    pole = abscissa(torque_dynamics(system, law))
    assert found["rightmost_pole_per_s"] == pytest.approx(pole, rel=1e-6)
    for axis in range(2):
        known = margins(open_loop(system, law, axis))
        gain, phase = found["torque_gain_margin_dB"][axis], found["torque_phase_margin_deg"][axis]
        assert gain == pytest.approx(20.0 * np.log10(known.gain), rel=1e-6)
        assert phase == pytest.approx(np.degrees(known.phase), rel=1e-6)
    # A load without weight: no torque sees its angles, and their poles at zero do not count.
    free = arm_numbers(0.9, 0.0, jnp.array(pose))["rightmost_pole_per_s"]
    known = abscissa(torque_dynamics(paper.arm(pose, K_L=False), law))
    assert free == pytest.approx(known, rel=1e-6)
    assert known < 0.0


def test_the_papers_gains_are_unstable_with_filtered_derivatives(arm_numbers: Callable) -> None:
    """Section 3's gains and lead, on the derivatives of section 4: the baseline of arm_tune."""
    found = arm_numbers(1.0, 1.0, jnp.array(paper.POSE))
    pole = abscissa(torque_dynamics(paper.arm(), same_arm(1.0)))
    assert pole == pytest.approx(0.4989, abs=1e-4)
    assert found["rightmost_pole_per_s"] == pytest.approx(pole, rel=1e-6)
    assert (found["torque_gain_margin_dB"] < 0.0).all()


def test_a_payload_is_a_mass_at_the_end() -> None:
    """Kinetic and potential energy of a point, differentiated; and no payload is no payload."""
    bare = two_link_arm_2014().load
    assert isinstance(bare, TwoLink)
    l_1, l_2, m = 0.5, 0.3, 0.7
    q, w, torque = (0.4, -1.1), (1.3, -0.7), (2.0, 0.5)
    empty = TwoLinkPayload(bare, 0.0, l_1, l_2)
    np.testing.assert_allclose(empty.acceleration(q, w, torque), bare.acceleration(q, w, torque))

    def end(q: Any) -> Any:
        both = q[0] + q[1]
        return jnp.array([l_1 * jnp.sin(q[0]) + l_2 * jnp.sin(both),
                          -l_1 * jnp.cos(q[0]) - l_2 * jnp.cos(both)])  # fmt: skip

    at, speed = jnp.array(q), jnp.array(w)
    found = jnp.stack(TwoLinkPayload(bare, m, l_1, l_2).acceleration(q, w, torque))
    # The end's weight and inertia force act on the bare arm through its Jacobian.
    jacobian = jax.jacfwd(end)(at)
    swing = jax.jvp(lambda q: jax.jacfwd(end)(q) @ speed, (at,), (speed,))[1]
    force = -m * (jacobian @ found + swing + jnp.array([0.0, 9.81]))
    felt = jnp.array(torque) + jacobian.T @ force
    np.testing.assert_allclose(found, bare.acceleration(q, w, tuple(felt)), rtol=1e-10)


CYCLE, LAST = ("small_start_cycle_rad",), "limit_cycle_rad"


@pytest.mark.parametrize(("K_B", "cycles"), [(0.0, True), (-0.8, False)])
def test_small_starts_find_the_limit_cycle(bench: Study, K_B: float, cycles: bool) -> None:
    law = tree.replace(bench.law, {tree.resolve(bench.law, "K_B"): K_B})
    long = replace(bench.scenario, duration=3.0)
    found = simulate(bench.drive, law, long, dt=2e-4, metrics=CYCLE, store=None)
    half_gap = float(bench.drive.transmission[0].half_gap)  # type: ignore[attr-defined]
    start = replace(bench.scenario.start[0], theta_L=0.3 - 5.0 * half_gap)
    still = replace(long, reference=(Constant(0.3),), start=(start,))
    by_hand = simulate(bench.drive, law, still, dt=2e-4, metrics=(LAST,), store=None)
    own, largest = (float(run.metrics[n]) for run, n in ((found, *CYCLE), (by_hand, LAST)))
    assert own >= largest
    assert (own > 0.1 * half_gap) == cycles
    if cycles:  # from all sizes it ends on one cycle, that of the paper's step
        assert own == pytest.approx(8.669e-3, abs=5e-7)


def test_what_has_no_such_number_says_so() -> None:
    sampled, arm_study = load("bench_sampled"), load("arm_torque")
    differing = PositiveFeedback.design(arm_study.drive, source=Levant(1e6))
    levant = arm_study._replace(law=Sampled(arm_study.law + differing, arm_study.run.dt))
    for study, name, field, words in (
        (levant, "gain_margin_dB", "law", "small_start_cycle_rad"),
        (sampled, "torque_gain_margin_db", "metrics", "torque_gain_margin_dB"),
        (load("bench_switched"), "torque_gain_margin_dB", "law", "K_p"),
        (arm_study, "rightmost_gap_pole_per_s", "drive.transmission", "play"),
    ):
        with pytest.raises(InputError) as caught:
            simulate(study.drive, study.law, study.scenario, dt=study.run.dt, metrics=(name,))
        assert caught.value.field == field
        assert words in str(caught.value)


# --- as goals and limits --------------------------------------------------------------------


def test_limits_from_below_are_read_and_meant() -> None:
    minimise = {"itae_rad_s2": 1.0}
    read = read_objective({"minimise": minimise, "limits": {"gain_margin_dB": {"least": 6.0}}})
    (limit,) = read.limits
    assert limit == Limit("gain_margin_dB", 6.0, "worst", least=True)
    assert limit.words == "gain_margin_dB >= 6"
    assert (limit.excess(5.0), limit.excess(7.0)) == (1.0, -1.0)
    for wrong in ({"least": 6.0, "most": 7.0}, {"over": "mean"}):
        with pytest.raises(InputError, match="most or least"):
            read_objective({"minimise": minimise, "limits": {"gain_margin_dB": wrong}})
    with pytest.raises(InputError, match="gain_margin_dB"):
        read_objective({"minimise": minimise, "limits": {"gain_margn_dB": {"least": 6.0}}})


def test_the_worst_of_a_limit_from_below_is_the_smallest() -> None:
    objective = Objective((Goal("a", 1.0, "mean"),), (Limit("b", 4.0, "worst", least=True),))
    values = np.array([[[1.0, 7.0]], [[1.0, 3.0]]])
    slopes = np.array([[[[0.0], [1.0]]], [[[0.0], [2.0]]]])
    local = localise(objective, ("a", "b"), values, slopes)
    np.testing.assert_allclose(local.excess, [0.25 + RESERVE])
    np.testing.assert_allclose(local.limits[0].slopes, [[-0.25], [-0.5]])


BENCH_LEAVES = {
    "cutoff": (10.0, 40.0), "K_P": (5.0, 20.0), "K_D": (0.02, 0.2), "tau_D": (0.002, 0.02),
    "K_B": (-1.5, -0.2), "threshold": (-2.0, 0.0), "width": (0.05, 2.0),
}  # fmt: skip
ARM_LEAVES = {
    "K_p": (1.0, 4.0), "K_i": (5.0, 50.0), "zero": (60.0, 300.0), "pole": (400.0, 900.0),
    "source.cutoff": (30.0, 90.0), "alpha_j": (0.0, 1.0), "alpha_a": (0.0, 1.0),
    "alpha_v": (0.0, 1.0),
}  # fmt: skip


def tuned(name: str, leaves: dict[str, tuple[float, float]], law: Any = None) -> Problem:
    table = copy.deepcopy(load(name).table)
    table.pop("scenarios", None)
    if law is not None:
        table["law"] = law
    goal = "torque_error_rms_Nm" if "arm" in name else "itae_rad_s2"
    table["objective"] = {"minimise": {goal: 1.0}}
    table["scenario"] = {**table["scenario"], "duration": 0.1}
    study = from_table(table, Path(), name)
    known = tree.paths(study.law)
    free = {
        leaf: {"lower": low, "upper": high, "of": [p for p in known if p.endswith(leaf)]}
        for leaf, (low, high) in leaves.items()
    }
    study.table["tune"] = {"free": free, "starts": 1}
    return Problem(study, read_spec(study))


def bench_law() -> dict[str, Any]:
    pd = load("bench_switched").table["law"]["law"][0]
    ramped = {"type": "ramped_damping", "K_B": -0.8}
    return {"type": "prefilter", "cutoff": "20 Hz", "law": [pd, ramped]}


@pytest.mark.parametrize(
    "name", ["bench_switched", pytest.param("arm_tune", marks=pytest.mark.slow)]
)
def test_every_kind_of_leaf_can_be_tuned(name: str) -> None:
    """Threshold and ramp, cut-offs, lead, tau_D, alphas: gradients as the differences."""
    leaves = BENCH_LEAVES if "bench" in name else ARM_LEAVES
    problem = tuned(name, leaves, bench_law() if "bench" in name else None)
    here, drive = np.full((1, len(leaves)), 0.45), np.arange(1)
    step = 1e-4
    moves = here + step * np.concatenate([np.eye(len(leaves)), -np.eye(len(leaves))])
    found, beside = problem.evaluate(here, drive), problem.evaluate(moves, drive)
    assert not found.status.any()
    up, down = np.split(beside.values[:, 0, 0, 0], 2)
    differences, slopes = (up - down) / (2.0 * step), found.slopes[0, 0, 0, 0]
    np.testing.assert_allclose(slopes, differences, rtol=2e-3, atol=1e-5 * np.abs(slopes).max())
    assert (slopes != 0.0).all()


def arm_with(payload: float, q1: float, q2: float) -> Any:
    """Its matrices (2)-(5) written down: inertia of both links, weight differentiated."""
    payload_load = load("arm_tuned").drive.load
    assert isinstance(payload_load, TwoLinkPayload)
    arm = replace(payload_load, payload=payload).loaded
    turn = float(arm.coupling) * np.cos(q2)
    M_12 = float(arm.inertia_2) + turn
    M_L = np.array([[float(arm.inertia_1) + 2.0 * turn, M_12], [M_12, float(arm.inertia_2)]])
    first, second = float(arm.gravity_1) * np.cos(q1), float(arm.gravity_2) * np.cos(q1 + q2)
    K_L = np.array([[first + second, second], [second, second]])
    return replace(paper.arm(), M_L=M_L, K_L=K_L)


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 0.05, 0.1])
def test_the_tuned_arm_is_stable_where_the_load_stiffness_is_definite(payload: float) -> None:
    """Issue 4, line 4: by NumPy's eigenvalues, on matrices that no code of the library made."""
    get = partial(tree.get, load("arm_tuned").law)
    gains = {n: np.array([float(get(f"laws[0].laws[{i}].law.{n}")) for i in (0, 1)])
             for n in ("K_p", "K_i")}  # fmt: skip
    alphas = [float(get(n)) for n in ("alpha_j", "alpha_a", "alpha_v")]
    lead = torque_loop.Lead(*(float(get(f"laws[0].laws[0].{n}")) for n in ("zero", "pole")))
    law = TorqueLaw(gains["K_p"], gains["K_i"], *alphas, lead=lead)
    law = replace(law, derivatives=torque_loop.Butterworth(50.0 * paper.HZ, 3))
    at = (np.arange(24) + 0.5) * np.pi / 12.0 - np.pi
    for q1, q12 in np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2).tolist():
        system = arm_with(payload, q1, q12 - q1)
        definite = bool(np.linalg.eigvalsh(system.K_L).min() > 0.0)
        assert definite == (np.cos(q1) > 0.0 and np.cos(q12) > 0.0)
        assert (abscissa(torque_dynamics(system, law)) < 0.0) == definite
        twice = law.scaled(10.0**0.3)  # 6 dB
        assert not definite or abscissa(torque_dynamics(system, twice)) < 0.0
