"""Environments: the pure functions, against runs of the engine that know nothing of them."""

from __future__ import annotations

import functools
import re
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from envs.environment import Environment, State
from envs.task import TASKS
from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.catalog import snake_case
from jaxsim.errors import InputError
from jaxsim.hybrid import Plain
from jaxsim.metric import Task
from jaxsim.metrics.impacts import Impacts
from jaxsim.pruned import prune
from jaxsim.sampled import TrueSpeeds
from jaxsim.status import Status
from jaxsim.study import load

NAMES = TASKS.names()
# 300 increments of sums of order 1 in float64; the runs themselves are the same micro-steps.
TELESCOPES = 1e-9
# The paper's K_B = -0.8 as an action of the schedule, K_B = -1.5 + 1.5 a.
PAPER_GAIN = 0.7 / 1.5


@functools.cache
def _compiled(name: str, **options: Any) -> tuple[Environment, Any, Any]:
    nominal = options.pop("nominal", False)
    env = Environment(TASKS.find(name)(nominal=nominal), **{"dtype": "float64", **options})
    return env, jax.jit(env.reset), jax.jit(lambda s, actions: jax.lax.scan(_one(env), s, actions))


def _one(env: Environment) -> Any:
    def one(state: State, action: Any) -> Any:
        step = env.step(state, action)
        return step.state, step._replace(state=None)

    return one


def _episode(name: str, seed: int, action: float, **options: Any) -> tuple[State, Any]:
    """The first state and all steps of an episode under one constant action."""
    env, reset, run = _compiled(name, **options)
    state, _ = reset(jax.random.key(seed))
    actions = jnp.full((env.steps, len(env.task.actions)), action)
    return state, run(state, actions)[1]


@pytest.mark.parametrize(
    ("name", "action"),
    [
        ("backlash_position_residual", 0.0),
        ("backlash_position_schedule", PAPER_GAIN),
        ("torque_tracking_residual", 0.0),
    ],
)
@pytest.mark.parametrize("nominal", [True, False])
def test_return_is_minus_the_metrics_of_a_simulated_run(
    name: str, action: float, nominal: bool
) -> None:
    options = {"nominal": True} if nominal else {}
    state, steps = _episode(name, 3, action, **options)
    drive, scenario = state.loop.drive, state.loop.scenario
    law = load("leg_torque" if "torque" in name else "bench_switched").law
    run = simulate(drive, law, scenario, store=None)
    env = _compiled(name, **options)[0]
    rate = env.task.action_rate * action**2
    assert float(steps.reward.sum()) == pytest.approx(
        -float(env.task.cost(run.metrics)) - rate, abs=TELESCOPES
    )
    for metric, nominal_value in env.task.terms.items():
        got = float(steps.info.numbers[metric][-1])
        assert got == pytest.approx(float(run.metrics[metric]), abs=TELESCOPES)
        if nominal:  # the constants have six digits
            assert got == pytest.approx(nominal_value, rel=2e-6)


def test_a_held_torque_moves_the_drive_as_the_closed_form_says() -> None:
    """In positive contact from start to end the rigid drive is J omega' + D omega = T."""
    _, steps = _episode("backlash_position", 0, 0.5, nominal=True, sensors=TrueSpeeds())
    J, D, T = 2 * 8.78e-4, 9.30e-2 + 3.60e-2, 1.5
    t = np.arange(1, 301) * 1e-3
    speed = T / D * -np.expm1(-t * D / J)
    settled = t > 0.2  # the way through the gap and the ringing after it (5 ms) are over
    omega_L = np.asarray(steps.observation)[:, 3] * 40.0
    np.testing.assert_allclose(omega_L[settled], speed[settled], rtol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_episodes_end_by_time_alone_and_stay_in_the_box(name: str) -> None:
    env = _compiled(name)[0]
    low, high = (np.array([getattr(c, k) for c in env.task.channels]) for k in ("low", "high"))
    for action in (-1.0, 1.0):
        _, steps = _episode(name, 1, action)
        assert not steps.terminated.any()
        assert np.flatnonzero(steps.truncated).tolist() == [env.steps - 1]
        observed = np.asarray(steps.observation)
        assert observed.dtype == np.float32
        assert (observed >= low).all()
        assert (observed <= high).all()
        assert float(-steps.reward.sum()) < 0.5 * env.task.failure
        # Full scales of the position tasks hold whatever an agent does: nothing is clipped away.
        inside = (np.abs(observed) < 1.0) | (np.arange(observed.shape[1]) == 6)
        assert "torque" in name or inside.all(), np.argwhere(~inside)[:5]


def test_supply_cuts_the_sum_of_law_and_action() -> None:
    """At full added voltage the current never passes that of a locked rotor at 48 V."""
    for action in (1.0, -1.0):
        _, steps = _episode("torque_tracking_residual", 2, action)
        current = np.asarray(steps.observation)[:, 5] * 100.0
        assert 1.0 < np.abs(current).max() < 48.0 / 0.664


def test_a_held_voltage_drives_the_current_of_the_closed_form() -> None:
    """The first millisecond of current, rotor and spring, by the matrix exponential.

    The load is held: it moves by 1e-5 of what the rotor does in this time.
    """
    _, steps = _episode("torque_tracking", 0, 0.1, nominal=True, dt=1e-4)
    L, R, K_t, J, D = 4.9066e-4, 0.664, 0.041, 2.21437e-5, 3.12575e-4
    system = np.zeros((4, 4))  # current, omega_M, theta_M, voltage
    system[0] = -R / L, -K_t / L, 0.0, 1.0 / L
    system[1] = K_t / J, -D / J, -930.0 / 150.0**2 / J, 0.0
    system[2, 1] = 1.0
    want = (expm(1e-3 * system) @ [0.0, 0.0, 0.0, 4.8])[0]
    assert float(steps.observation[0, 5]) * 100.0 == pytest.approx(want, rel=1e-5)


def test_every_draw_comes_from_the_seed_and_within_its_range() -> None:
    env = Environment(TASKS.find("backlash_position")())
    keys = jax.vmap(jax.random.key)(jnp.arange(200))
    states, _ = jax.jit(jax.vmap(env.reset))(keys)
    again, _ = jax.jit(jax.vmap(env.reset))(keys)
    drive, scenario = states.loop.drive, states.loop.scenario
    half_gap = np.asarray(drive.transmission[0].half_gap)
    reference, loads = scenario.reference[0].size, scenario.load_torque[0].parts
    drawn = {
        "half_gap": (half_gap / 7.80e-3, 0.6, 1.3),
        "K": (drive.transmission[0].K / 300.0, 0.8, 1.2),
        "J_L": (drive.load.J_L / 8.78e-4, 0.7, 1.3),
        "reference": (abs(reference), 0.15, 0.45),
        "start": (scenario.start[0].theta_B / half_gap, -0.9, 0.9),
        "load_1": (loads[0].size, -0.2, 0.2),
        "at_1": (loads[0].at, 0.05, 0.15),
        "load_2": (loads[1].size, -0.2, 0.2),
        "at_2": (loads[1].at, 0.15, 0.25),
        "angle_noise": (1e5 * states.sensors.angle_noise, 0.0, 1.0),
        "torque_noise": (states.sensors.torque_noise, 0.0, 0.02),
        "late": (states.late, -1.0, 1.0),
    }
    for name, (values, low, high) in drawn.items():
        values = np.asarray(values)
        assert values.min() >= low - 1e-6, name
        assert values.max() <= high + 1e-6, name
        assert np.ptp(values) > 0.9 * (high - low), name
        assert len(np.unique(values)) > 190, name
    for a, b in zip(jax.tree.leaves(states), jax.tree.leaves(again), strict=True):
        assert (a == b).all()
    assert len(np.unique(states.sensors.seed)) == 200
    assert 80 < int((reference < 0.0).sum()) < 120
    following = jax.random.key_data(states.key)
    assert not (following == jax.random.key_data(keys)).all(axis=1).any()


def test_readings_are_rounded_to_counts() -> None:
    _, steps = _episode("backlash_position", 0, 0.3, nominal=True)
    _, true = _episode("backlash_position", 0, 0.3, nominal=True, sensors=TrueSpeeds())
    step = 2 * np.pi / 2**20
    got, exact = (np.asarray(s.observation, float)[:, 1] * 10.0 for s in (steps, true))
    assert 0.0 < np.abs(got - exact).max() <= 0.5 * step + 4e-7  # observations are float32


def test_readings_have_the_noise_that_was_drawn_and_come_late_where_it_was_drawn() -> None:
    env, reset, run = _compiled("backlash_position")
    state, _ = reset(jax.random.key(0))
    count, actions = 2 * np.pi / 2**20, jnp.full((env.steps, 1), 0.3)

    def errors(angle_noise: float, late: float) -> np.ndarray:
        sensors = tree.replace(state.sensors, {"angle_noise": jnp.asarray(angle_noise)})
        own = state._replace(sensors=sensors, late=jnp.asarray(late))
        return np.asarray(run(own, actions)[1].observation, float)[:, 1] * 10.0

    exact = errors(0.0, -1.0)
    noise = errors(1e-3, -1.0) - exact
    assert noise.std() == pytest.approx(1e-3, rel=0.1)  # of 300: 4 % is one standard deviation
    assert abs(noise.mean()) < 2e-4
    assert np.array_equal(errors(1e-3, -1.0) - exact, noise)
    # The reference steps at sample 10 and needs no sensor: only what is behind is compared.
    late = errors(0.0, 1.0)[20:] - exact[19:-1]
    assert np.abs(late).max() < count


def test_the_gap_wears_with_the_episodes_behind_a_drive() -> None:
    env = Environment(TASKS.find("backlash_position")())
    reset = jax.jit(env.reset)
    gaps = [
        float(reset(jax.random.key(0), age)[0].loop.drive.transmission[0].half_gap)
        for age in (0, 1000, 2000, 10_000)
    ]
    assert np.array(gaps) / gaps[0] == pytest.approx([1.0, 1.1, 1.2, 1.2], rel=1e-6)


def test_float32_and_plain_mode_agree_with_exact_float64() -> None:
    name = "backlash_position_residual"
    reference = float(_episode(name, 3, 0.0)[1].reward.sum())
    single = float(_episode(name, 3, 0.0, dtype="float32")[1].reward.sum())
    assert single == pytest.approx(reference, rel=1e-3)
    plain = float(_episode(name, 3, 0.0, deadzone=Plain())[1].reward.sum())
    assert plain != reference
    assert plain == pytest.approx(reference, rel=0.1)  # O(dt), erratic: 2e-4 s is coarse


def test_a_run_that_fails_terminates_with_its_price_and_a_finite_observation() -> None:
    env, reset, run = _compiled("backlash_position")
    state, _ = reset(jax.random.key(0))
    broken = eqx.tree_at(lambda s: s.loop.drive.load.J_L, state, jnp.asarray(jnp.nan))
    steps = run(broken, jnp.zeros((2, 1)))[1]
    assert steps.terminated.all()
    assert not steps.truncated.any()
    assert (np.asarray(steps.reward) == -env.task.failure).all()
    assert (np.asarray(steps.info.status) == Status.DIVERGED.value).all()
    assert np.isfinite(steps.observation).all()


def test_a_pruned_metric_keeps_what_its_numbers_stand_on_and_no_more() -> None:
    """The braking peak needs the side of the first contact; the largest torque needs neither."""
    zero = jnp.zeros(())
    impacts = Impacts(Task(zero, zero + 0.3, zero, zero + 0.3))
    names = [
        jax.tree_util.keystr(p) for p, _ in jax.tree_util.tree_leaves_with_path(impacts.start())
    ]
    peak = {names[i] for i in prune(impacts, ["braking_peak_Nm"]).kept}
    assert {"[0].side", "[1].side", "[1].lasts", "[1].peak"} == peak
    assert {names[i] for i in prune(impacts, ["largest_torque_Nm"]).kept} == {"[2]", "[3]"}


@pytest.mark.parametrize("name", NAMES)
def test_docstrings_tell_actions_and_observations(name: str) -> None:
    task = TASKS.find(name)
    assert snake_case(task.__name__) == name
    rows = re.findall(r"^ *\| (\d+) \|(.*)\|$", task.__doc__ or "", re.MULTILINE)
    cells = [tuple(c.strip() for c in row.split("|")) for _, row in rows]
    said = [(c.name, c.unit, f"{c.full_scale:g}") for c in task.actions] + [
        (c.name, c.unit, f"{c.full_scale:g}", f"{c.low:g}", f"{c.high:g}") for c in task.channels
    ]
    assert cells == said


def test_a_step_that_does_not_divide_the_period_is_refused() -> None:
    for dt in (3e-4, 0.0, -1e-3, 2e-3):
        with pytest.raises(InputError, match="must divide the control period"):
            Environment(TASKS.find("backlash_position")(), dt=dt)
    with pytest.raises(InputError, match="backlash_position"):
        TASKS.find("backlash_positon")
