"""Real machines: load friction, the servo's firmware, late signals, the recordings of others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import jaxsim
from jaxsim import tree
from jaxsim.drive import Drive
from jaxsim.hybrid import Exact
from jaxsim.laws.feedforward import Feedforward
from jaxsim.laws.servo import Servo
from jaxsim.loads.inertia import Inertia
from jaxsim.loads.pendulum import Pendulum
from jaxsim.motors.geared import Geared
from jaxsim.sampled import Sampled
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.signals.delayed import Delayed
from jaxsim.signals.samples import Samples
from jaxsim.signals.step import Step
from jaxsim.status import Status
from jaxsim.transmissions.elastic import Elastic
from tuning.identification.mapping import experiments
from tuning.identification.residuals import Problem
from tuning.identification.spec import read_free, read_spec

DATA = Path(__file__).parents[2] / "shared" / "data"
EMPS = DATA / "emps_positioning" / "DATA_EMPS_PULSES.mat"
SETTLED = 1e-5  # Nm and rad: what is left of the ringing after the time that a test waits


def hanging(driven: float, torque: float = 0.0) -> jaxsim.Run:
    """A geared pendulum let go at 1 rad: 1 Nm sin(1 rad) on a gear, and a torque at the motor."""
    drive = Drive(
        Geared(J_M=0.02, driven=driven, driving=0.1, D_M=0.5),
        Elastic(K=300.0, D_B=1.0),
        Pendulum(mass=1.0, length=1.0 / 9.81),
    )
    wound = np.sin(1.0) / 300.0
    start = Start(theta_L=1.0, theta_B=wound)
    scenario = Scenario(Constant(torque), start=start, duration=1.0)
    return jaxsim.simulate(drive, Feedforward(), scenario, dt=1e-3, metrics=())


def test_a_gear_holds_what_it_gives_back_less_than_nothing_of() -> None:
    """driven > 1 locks: |T| friction exceeds T. driven = 0.5 lets the load fall."""
    assert abs(hanging(1.01).signals["theta_L"][-1] - 1.0) < SETTLED
    assert hanging(0.5).signals["theta_L"][-1] < 0.8


@pytest.mark.parametrize(("share", "moves"), [(1.09, False), (1.12, True)])
def test_lifting_takes_the_load_and_its_friction(share: float, moves: bool) -> None:
    """At rest under sin(1) Nm, the motor lifts above (1 + driving) sin(1) = 1.1 sin(1)."""
    run = hanging(1.2, share * float(np.sin(1.0)))
    assert (run.signals["theta_L"][-1] > 1.0 + 1e-3) == moves


def test_the_servo_steps_as_its_firmware_does() -> None:
    """4 counts of error at k_p = 16: (4 - 1) 4 + 16 thousandths of 12 V, as its register reads."""
    count = 2.0 * np.pi / 4096.0
    law = Servo(K_T=0.5, D_E=1.0, k_p=16.0, slew=5.0)
    stuck = Drive(Geared(J_M=0.02, Fc=1.0, Fs=1.0), Elastic(K=300.0), Inertia(J_L=0.01))
    scenario = Scenario(Constant(4.0 * count), duration=0.02)
    run = jaxsim.simulate(stuck, law, scenario, dt=1e-3, metrics=())
    np.testing.assert_allclose(run.signals["command"][-1], 0.028 * 12.0 * 0.5, rtol=1e-9)


def test_a_released_servo_neither_drives_nor_brakes() -> None:
    """From the release on a frictionless rotor keeps its speed."""
    law = Servo(K_T=0.5, D_E=1.0, k_p=16.0, slew=5.0, release=0.0305)
    free = Drive(Geared(J_M=0.02), Elastic(K=300.0, D_B=0.5), Inertia(J_L=1e-4))
    run = jaxsim.simulate(free, law, Scenario(Constant(1.0), duration=0.2), dt=1e-3, metrics=())
    momentum = 0.02 * run.signals["omega_M"] + 1e-4 * run.signals["omega_L"]
    np.testing.assert_allclose(momentum[40:], momentum[40], rtol=1e-9)
    assert momentum[40] > 1e-3


def test_a_delay_moves_a_step_and_its_derivative() -> None:
    """A force step F late by tau: the speed at T is F (T - tau)/J, its slope by tau is -F/J."""
    import jax

    def speed(delay: float) -> jax.Array:
        drive = Drive(Geared(J_M=1.0), Elastic(K=1e3, D_B=20.0), Inertia(J_L=1.0))
        scenario = Scenario(Delayed(Step(2.0, 0.1), delay), duration=0.5)
        run = jaxsim.simulate(drive, Feedforward(), scenario, dt=1e-3, metrics=(), throw=False)
        return run.signals["omega_M"][-1] + run.signals["omega_L"][-1]

    np.testing.assert_allclose(speed(0.0503), 2.0 * (0.4 - 0.0503), rtol=1e-9)
    np.testing.assert_allclose(jax.jvp(speed, (0.0503,), (1.0,))[1], -2.0, rtol=1e-6)


def test_a_law_reads_the_held_sample_that_begins_at_its_tick() -> None:
    """Whatever rounding makes of k * 1 ms: sample k at tick k, not the one before."""
    numbers = np.arange(2000.0)
    drive = Drive(Geared(J_M=1.0), Elastic(K=100.0), Inertia(J_L=1.0))
    scenario = Scenario(Samples(numbers, 1e-3, "hold", on_ticks=True), duration=2.0)
    law = Sampled(Feedforward(), 1e-3)
    run = jaxsim.simulate(drive, law, scenario, dt=5e-4, metrics=(), store=2)
    np.testing.assert_array_equal(run.signals["command"][:-1], numbers)


# The EMPS axis by its simulated force against the recorded one, %: published parameters, and those
# of `gearlash identify emps` on the other recording. Published for the first: 8.94.
PUBLISHED = {
    "J_M": 0.98 * 95.1089, "J_L": 0.02 * 95.1089, "D_M": 203.5034,
    "motor.Fc": 20.3935, "motor.Fs": 20.3935, "motor.bias": 3.1648,
}  # fmt: skip
IDENTIFIED = {
    "J_M": 93.2901, "J_L": 1.9022, "D_M": 187.53,
    "motor.Fc": 22.1824, "motor.Fs": 13.4143, "motor.ws": 0.0145498, "motor.bias": 3.1701,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(not EMPS.exists(), reason="the EMPS recording is not in ../shared/data")
@pytest.mark.parametrize(("values", "most"), [(PUBLISHED, 5.5), (IDENTIFIED, 4.8)])
def test_emps_under_pulses_agrees_with_the_recording(values: dict, most: float) -> None:
    """Force within 7.4 % was asked for, position within 0.008 %."""
    study = jaxsim.load("emps")
    recorded, dt = experiments(study, read_spec(study)._replace(folder=EMPS.parent))
    pulses = recorded[1].experiment
    drive = tree.replace(pulses.drive, values)
    run = jaxsim.simulate(drive, pulses.law, pulses.scenario, dt=dt, metrics=(), store=2)
    position, force = pulses.measurements
    left = {m.signal: np.asarray(run.signals[m.signal]) - m.values for m in (position, force)}
    share = {m.signal: np.linalg.norm(left[m.signal]) / np.linalg.norm(m.values)
             for m in (position, force)}  # fmt: skip
    assert 100.0 * share["command"] < most
    assert 100.0 * share["theta_M"] < 0.0017


PENDULUM = DATA / "simple_pendulum" / "pd_identification.csv"


@pytest.mark.skipif(not PENDULUM.exists(), reason="the pendulum is not in ../shared/data")
def test_where_the_published_pendulum_comes_from() -> None:
    """Least squares of filtered signals of the PD log, which leaves 75 % of the torque.

    Friction there is Fc atan(100 omega): 0.289 Nm. Procedure: DFKI, torque_limited_simple_pendulum.
    """
    t, q, omega, torque = np.loadtxt(PENDULUM, delimiter=",", skiprows=1).T

    def low_pass(values: np.ndarray, cutoff: float) -> np.ndarray:
        return signal.sosfiltfilt(signal.butter(3, cutoff, output="sos"), values)

    speed, seen = np.gradient(q, t), low_pass(torque, 0.1)
    rate = low_pass(np.gradient(low_pass(omega, 0.2), t), 0.1)
    terms = np.c_[rate, 9.81 * np.sin(q), speed, np.arctan(100.0 * speed), np.ones_like(q)]
    found = np.linalg.lstsq(terms, seen)[0]
    np.testing.assert_allclose(found, [0.0626, 0.1022, 0.0471, 0.1839, -0.0759], atol=5e-5)
    assert np.std(seen - terms @ found) > 0.7 * np.std(seen)


SERVO = DATA / "sts3215_servo" / "raw_100hz.npz"


@pytest.mark.slow
@pytest.mark.skipif(not SERVO.exists(), reason="the servo recordings are not in ../shared/data")
def test_the_servo_model_holds_for_loads_it_was_not_fitted_to() -> None:
    """480 runs with four other loads, from the goal alone: below 14 mrad (published M6: 44.5)."""
    study = jaxsim.load("sts3215_servo")
    spec = read_spec(study)._replace(folder=SERVO.parent)
    recorded, dt = experiments(study, spec)
    held_out = [r.experiment for r in recorded if r.use == "test"]
    one = read_free(spec, held_out[0])[:1]  # its derivative is not asked for
    assert isinstance(study.run.deadzone, Exact)
    problem = Problem(held_out, one, dt=dt, width=1, exact=study.run.deadzone)
    seen = problem.evaluate(problem.initial())
    assert np.all(seen.status == Status.OK.value)
    used = problem.readings.used.sum()
    assert used == 287_916
    left = problem.readings.noise[0, 0] * np.abs(seen.residuals).sum()
    assert left / used < 14e-3
