"""A policy is a law like any other, and scores in a run what it scores in its environment."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomlkit

from envs.environment import Environment
from envs.task import TASKS
from jaxsim import components
from jaxsim._simulate import simulate
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import Control
from jaxsim.laws.linear_damping import LinearDamping
from jaxsim.laws.policy import Layer, Network, Policy
from jaxsim.provenance import write_json
from jaxsim.sampled import Sampled, TrueSpeeds
from jaxsim.study import load

# Observations of environments are float32; their rounding comes back through the policy.
SAME = 2e-4


def _policy(name: str, seed: int = 0) -> Policy:
    """A random policy for a task, of true speeds: encoders would magnify rounding to counts."""
    task = TASKS.find(name)()
    random = np.random.default_rng(seed)
    sizes = len(task.channels), 7, len(task.actions)
    layers = [
        Layer(random.normal(0.0, 0.2, (b, a)), random.normal(0.0, 0.1, b))
        for a, b in itertools.pairwise(sizes)
    ]
    network = Network(layers, random.normal(0.0, 0.1, sizes[0]), np.full(sizes[0], 0.2))
    return Policy(
        task.law(), network, task.channels, task.actions, task.period, task.duration
    )  # fmt: skip


def _episode(env: Environment, policy: Policy, key: Any) -> Any:
    first, observation = env.reset(key)

    def one(carry: Any, _: Any) -> Any:
        state, observation = carry
        step = env.step(state, policy.network(jnp.asarray(observation, jnp.float64)))
        return (step.state, step.observation), (step.reward, step.state.action[0])

    (last, _), (rewards, actions) = jax.lax.scan(one, (first, observation), length=env.steps)
    return first, last, rewards, actions


@pytest.mark.parametrize("name", TASKS.names())
def test_a_policy_scores_in_a_run_what_it_scores_in_its_environment(name: str) -> None:
    policy = _policy(name)
    env = Environment(TASKS.find(name)(), sensors=TrueSpeeds(), dtype="float64")
    first, last, rewards, actions = jax.jit(lambda k: _episode(env, policy, k))(jax.random.key(3))
    loop = first.loop
    options: Any = {"deadzone": Exact(1000), "metrics": tuple(env.task.terms)}  # it may rattle
    run = simulate(loop.drive, policy, loop.scenario, store=None, **options)
    rate = env.task.action_rate * np.sum(np.diff(np.asarray(actions), prepend=0.0) ** 2)
    cost = float(env.task.cost(run.metrics))
    assert cost == pytest.approx(-float(rewards.sum()) - rate, rel=SAME)
    assert cost == pytest.approx(float(last.cost), rel=SAME)
    alone = simulate(loop.drive, policy.base, loop.scenario, store=None, **options).metrics
    assert cost != pytest.approx(float(env.task.cost(alone)), rel=10 * SAME)


def test_a_policy_goes_to_a_file_and_back(tmp_path: Path) -> None:
    policy = _policy("backlash_position_schedule")
    write_json(tmp_path / "policy.json", components.dump(policy))
    study = load("bench_switched").table | {"law": {"type": "policy", "weights": "policy.json"}}
    (tmp_path / "study.toml").write_text(tomlkit.dumps(study), "utf-8")
    again = load(str(tmp_path / "study.toml")).law
    assert jax.tree.structure(again) == jax.tree.structure(policy)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(policy), strict=True):
        np.testing.assert_array_equal(a, b)
    whole = (tmp_path / "policy.json").read_text("utf-8")
    (tmp_path / "policy.json").write_text(whole[: len(whole) // 2], "utf-8")
    with pytest.raises(InputError, match=r"policy.json: must be JSON.*is the file complete"):
        load(str(tmp_path / "study.toml"))


def _changed(table: dict[str, Any], path: str, value: Any) -> Any:
    """The law of a table with one entry replaced."""
    *steps, last = [int(p) if p.isdigit() else p for p in path.split(".")]
    owner: Any = table
    for step in steps:
        owner = owner[step]
    owner[last] = value
    return components.build(Control, table, "law")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("network.layers.0.bias", [0.0, 1.0], r"layers\[0\].*one bias per output"),
        ("network.mean", [0.0, 1.0], "must take the 2 numbers"),
        ("network.scale", [0.0] * 13, "must be > 0"),
        ("channels", [{"name": "error", "unit": "rad", "full_scale": 1.0}], "another task"),
        ("channels.0.name", "referense", "reference"),
        ("channels.11.state", 2, "must be below 2"),
        ("actions.0.parameter", "K_C", "K_B"),
        ("period", 0.7, "must be > 0 s and < duration"),
        ("network.activation", "tan", "tanh"),
    ],
)
def test_what_does_not_fit_is_named(path: str, value: Any, message: str) -> None:
    table = components.dump(_policy("backlash_position_schedule"))
    bench = load("bench_switched")
    with pytest.raises(InputError, match=message):
        simulate(bench.drive, _changed(table, path, value), bench.scenario)


def test_a_policy_stands_alone_and_keeps_its_period() -> None:
    policy, bench = _policy("backlash_position"), load("bench_switched")
    damping = LinearDamping(-0.5)
    for wrong in (lambda: damping + policy, lambda: policy + damping):
        with pytest.raises(InputError, match="must stand alone"):
            wrong()
    with pytest.raises(InputError, match=r"Policy.period: must be a multiple of dt"):
        simulate(bench.drive, policy, bench.scenario, dt=3e-4)
    with pytest.raises(InputError, match=r"Policy.period: must be a multiple of dt"):
        Sampled(policy, 3e-4)


def test_gradients_of_a_policy_agree_in_both_modes() -> None:
    bench, policy = load("bench_switched"), _policy("backlash_position_residual")
    where = lambda p: p.network.layers[-1].bias  # noqa: E731

    def cost(bias: Any) -> Any:
        law = eqx.tree_at(where, policy, bias)
        run = simulate(bench.drive, law, bench.scenario, store=None, metrics=("itae_rad_s2",))
        return run.metrics["itae_rad_s2"]

    bias = jnp.asarray(where(policy))
    reverse, forward = jax.grad(cost)(bias), jax.jacfwd(cost)(bias)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    h = 1e-5
    difference = (cost(bias + h) - cost(bias - h)) / (2.0 * h)
    np.testing.assert_allclose(reverse[0], difference, rtol=1e-3)
