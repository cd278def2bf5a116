"""Training: it learns, it repeats, it resumes with nothing lost, and its files are safe."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import onnxruntime
import pytest
import stable_baselines3
from agent_cases import PUSH
from stable_baselines3.common.vec_env import VecNormalize
from typer.testing import CliRunner

from envs.environment import build
from envs.sb3 import BatchedVecEnv
from envs.task import TASKS
from jaxsim.errors import InputError
from jaxsim.laws.policy import Layer, Network
from jaxsim.study import load, with_values
from rl import arrays, comparison, nominal, onnx_file, store
from rl.apg import APG
from rl.comparison import Entry
from rl.episodes import score, training_keys, unseen_keys, validation_keys
from rl.networks import first_network, idle_network
from rl.regret import alone, nominal_of, regret
from rl.sb3 import SB3, network_of
from rl.session import Session
from rl.spec import read_spec
from rl.study import read_comparison, shipped

TORCH = 1e-5  # an action of a few float32 layers
SMALL: dict[str, dict[str, Any]] = {
    "apg": {"iterations": 4, "validate_every": 2, "batch": 4, "hidden": [8], "validation": 4}
    | {"regret": 1.0, "margin": 0.1, "nominal": 0.5},
    "ppo": {"steps": 960, "segment": 480, "envs": 8, "algorithm.n_steps": 30, "hidden": [8]}
    | {"algorithm.batch_size": 120, "algorithm.n_epochs": 2, "validation": 4},
    "sac": {"steps": 960, "segment": 480, "envs": 8, "hidden": [8], "validation": 4}
    | {"algorithm.learning_starts": 120, "algorithm.buffer_size": 800},
    "td3": {"steps": 960, "segment": 480, "envs": 8, "hidden": [8], "validation": 4}
    | {"algorithm.learning_starts": 120, "algorithm.buffer_size": 800},
}


def _spec(algo: str, seed: int = 0, **changes: Any) -> Any:
    return read_spec(PUSH, algo, seed, SMALL[algo] | changes)


def _quiet(_: Any) -> None:
    """Nobody watches."""


def _trained(algo: str, folder: Path, seed: int = 0, **changes: Any) -> Session:
    folder.mkdir(parents=True, exist_ok=True)
    session = Session(_spec(algo, seed, **changes), folder, resume=False)
    session.run(_quiet)
    return session


def _same(a: Network, b: Network) -> bool:
    """Bit for bit."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(bool((np.asarray(x) == np.asarray(y)).all()) for x, y in pairs)


def _constant(action: float) -> Network:
    size = len(TASKS.find(PUSH).channels)
    layer = Layer(np.zeros((1, size)), np.full(1, action))
    return Network((layer,), np.zeros(size), np.ones(size), squash="clip")


def _the_right_way() -> Network:
    """Full torque in the direction of the reference, its first channel."""
    network = _constant(0.0)
    weight = np.zeros_like(network.layers[0].weight)
    weight[0, 0] = 1e6
    return Network((Layer(weight, np.zeros(1)),), network.mean, network.scale, squash="clip")


@pytest.mark.slow  # the gradient's program alone compiles for half a minute
@pytest.mark.parametrize(
    ("algo", "changes"),
    [
        ("apg", {"iterations": 80, "validate_every": 40, "rate": 1e-2, "batch": 16, "regret": 0.0}
         | {"nominal": 0.0}),
        ("ppo", {"steps": 96_000, "segment": 48_000, "envs": 32, "hidden": [32]}
         | {"algorithm.n_steps": 60, "algorithm.batch_size": 480, "algorithm.n_epochs": 10}
         | {"algorithm.learning_rate": 3e-3, "algorithm.gamma": 0.95, "algorithm.gae_lambda": 0.9}
         | {"policy.log_std_init": 0.0}),
    ],
)  # fmt: skip
def test_a_tiny_task_is_learnt(algo: str, changes: dict[str, Any], tmp_path: Path) -> None:
    """Nine tenths of what full torque the right way gains over the best constant command."""
    keys = unseen_keys(64)
    env = build(PUSH)
    constants = [np.mean(score(env, _constant(a), keys).cost) for a in np.linspace(-1, 1, 9)]
    right = np.mean(score(env, _the_right_way(), keys).cost)
    assert right < 0.8 * min(constants)
    session = _trained(algo, tmp_path, **changes)
    assert np.mean(session.test().cost) < 0.1 * min(constants) + 0.9 * right


@pytest.mark.parametrize(
    "algo", ["ppo", *(pytest.param(algo, marks=pytest.mark.slow) for algo in ("apg", "sac"))]
)
def test_a_seed_repeats_and_a_kill_loses_nothing(algo: str, tmp_path: Path) -> None:
    whole = _trained(algo, tmp_path / "whole")
    again = Session(_spec(algo), _made(tmp_path / "again"), resume=False)
    with pytest.raises(KeyboardInterrupt):
        again.run(_killed)
    resumed = Session(store.read_spec_of(again.folder), again.folder, resume=True)
    assert 0 < resumed.trainer.done < resumed.spec.total
    resumed.run(_quiet)
    assert _same(whole.trainer.network(), resumed.trainer.network())
    assert [r[:-1] for r in whole.rows] == [r[:-1] for r in resumed.rows]  # all but CPU time
    assert _same(store.read_policy(whole.folder).network, store.read_policy(resumed.folder).network)
    other = _trained(algo, tmp_path / "other", seed=1)
    assert not _same(whole.trainer.network(), other.trainer.network())


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _killed(_: Any) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("algo", ["ppo", "sac", "td3"])
def test_networks_give_the_actions_of_torch(algo: str) -> None:
    venv = VecNormalize(BatchedVecEnv(PUSH, 2))
    random = np.random.default_rng(0)
    size = len(TASKS.find(PUSH).channels)
    venv.obs_rms.mean = random.normal(0.0, 0.2, size)
    venv.obs_rms.var = random.uniform(0.01, 0.2, size)
    kind = getattr(stable_baselines3, algo.upper())
    model = kind("MlpPolicy", venv, seed=3, device="cpu")
    network = network_of(model, venv)
    seen = random.uniform(-1.0, 1.0, (100, size)).astype(np.float32)
    want, _ = model.predict(venv.normalize_obs(seen), deterministic=True)
    got = np.stack([np.asarray(network(o)) for o in seen])
    assert np.ptp(got) > 0.01
    np.testing.assert_allclose(got, want, atol=TORCH)


@pytest.mark.parametrize("squash", ["tanh", "clip"])
def test_onnx_gives_the_actions_of_the_policy_and_says_what_they_mean(
    squash: Any, tmp_path: Path
) -> None:
    env = build(PUSH)
    random = np.random.default_rng(1)
    size = len(env.task.channels)
    layers = [Layer(random.normal(0, 0.5, (6, size)), random.normal(0, 0.5, 6))]
    layers.append(Layer(random.normal(0, 0.5, (1, 6)), random.normal(0, 0.5, 1)))
    network = Network(layers, random.normal(0, 0.1, size), np.full(size, 0.3), squash=squash)
    policy = store.law_of(env, network)
    assert onnx_file.export(policy, tmp_path / "policy.onnx") <= TORCH
    seen = random.uniform(-1, 1, (1, size)).astype(np.float32)
    session = onnxruntime.InferenceSession(str(tmp_path / "policy.onnx"))
    (action,) = session.run(None, {"observation": seen})
    z = np.tanh(layers[0].weight @ ((seen[0] - network.mean) / 0.3) + layers[0].bias)
    want = layers[1].weight @ z + layers[1].bias
    want = np.tanh(want) if squash == "tanh" else np.clip(want, -1.0, 1.0)
    np.testing.assert_allclose(np.asarray(action)[0], want, atol=TORCH)
    said = json.loads((tmp_path / "policy.json").read_text("utf-8"))
    assert [c["name"] for c in said["observation"]] == [c.name for c in env.task.channels]
    assert said["action"][0]["unit"] == "Nm"
    assert said["period_s"] == 1e-3


def test_a_policy_on_another_drive_than_those_of_its_training_says_so(tmp_path: Path) -> None:
    """Half gaps of the task's episodes are 0.6 to 1.3 of the bench's, and a fifth more worn."""
    env = build(PUSH)
    size = len(env.task.channels)
    network = Network([Layer(np.zeros((1, size)), np.zeros(1))], np.zeros(size), np.ones(size))
    store.write_policy(tmp_path, store.law_of(env, network), "nothing")
    law = str(tmp_path / "law.toml")
    study = load("bench_switched", law=law)  # warnings are errors here
    own = {t.parameter: (t.low, t.high) for t in study.law.trained}
    assert own["transmission.half_gap"] == pytest.approx((0.6 * 7.8e-3, 1.56 * 7.8e-3), rel=0.01)
    assert own["motor.J_M"] == pytest.approx((8.78e-4, 8.78e-4), rel=1e-6)
    with_values(study, {"half_gap": 0.012})
    with pytest.warns(UserWarning, match=r"other drives: half_gap = 0.02, there 0.00469 to 0.0122"):
        with_values(study, {"half_gap": 0.02})
    with pytest.warns(UserWarning, match=r"J_M = 0.001, there 0.000878 \(SI\)"):
        with_values(study, {"J_M": 1e-3})


def test_the_three_kinds_of_episodes_are_different() -> None:
    kinds = [training_keys(0, i, 50) for i in range(3)] + [training_keys(1, 0, 50)]
    kinds += [validation_keys(50), unseen_keys(50)]
    words = np.concatenate([np.asarray(jax.random.key_data(k)) for k in kinds])
    assert len(np.unique(words, axis=0)) == len(words)


def test_a_first_network_leaves_the_law_alone() -> None:
    """The schedule starts at the paper's K_B, from whatever it sees."""
    env = build("backlash_position_schedule")
    network = first_network(env, (8,), jax.random.key(0))
    for seed in range(3):
        seen = np.random.default_rng(seed).normal(0.0, 1.0, 13)
        seen = np.asarray(network.mean) + np.asarray(network.scale) * seen
        K_B = -1.5 + 1.5 * float(network(seen)[0])
        assert pytest.approx(-0.8, abs=0.1) == K_B


def test_damaged_files_are_named_and_nothing_is_unpickled(tmp_path: Path) -> None:
    session = _trained("sac", tmp_path / "run")
    folder = tmp_path / "run"
    (checkpoint,) = folder.glob("checkpoint-*")
    for name in ("parameters.pt", "statistics.npz", "replay.npz"):
        whole = (checkpoint / name).read_bytes()
        (checkpoint / name).write_bytes(whole[: len(whole) // 2])
        with pytest.raises(InputError, match=rf"{name}: must be a complete file"):
            Session(session.spec, folder, resume=True)
        (checkpoint / name).write_bytes(whole)
    Session(session.spec, folder, resume=True)  # nothing was lost by it
    np.savez(tmp_path / "evil.npz", leaf_0=np.array([print], dtype=object))
    with pytest.raises(InputError, match="must be a complete file of arrays"):
        arrays.read(tmp_path / "evil.npz")
    with pytest.raises(InputError, match="must hold the arrays of this training"):
        APG(_spec("apg")).load(_saved(APG(_spec("apg", hidden=[9])), tmp_path / "apg"))


def _saved(trainer: APG, folder: Path) -> Path:
    folder.mkdir()
    trainer.save(folder)
    return folder


def test_zips_are_read_on_request_only_and_with_a_warning(tmp_path: Path) -> None:
    from jaxsim.command import app

    model = stable_baselines3.PPO("MlpPolicy", BatchedVecEnv(PUSH, 2), device="cpu")
    model.save(tmp_path / "model.zip")
    call = ["import-policy", str(tmp_path / "model.zip"), "--task", PUSH, "--algo", "ppo"]
    call += ["--out", str(tmp_path / "out")]
    refused = CliRunner().invoke(app, call)
    assert refused.exit_code == 2
    assert not (tmp_path / "out").exists()
    from rl.sb3 import network_of_zip

    with pytest.warns(UserWarning, match="is unpickled: it can run code"):
        network = network_of_zip(tmp_path / "model.zip", "ppo")
    assert network.sizes == (11, 64, 64, 1)
    policy = store.law_of(build(PUSH), network)
    with pytest.raises(InputError, match="was it trained for another task"):
        store.law_of(build("backlash_position_residual"), policy.network)


@pytest.mark.parametrize(
    ("task", "algo", "changes", "message"),
    [
        (PUSH, "pgo", {}, "ppo"),
        ("backlash_positon", "apg", {}, "backlash_position"),
        (PUSH, "apg", {"iteration": 3}, "iterations"),
        (PUSH, "apg", {"decay": 1.5}, "less than or equal to 1"),
        (PUSH, "ppo", {"steps": 0}, "greater than or equal to 1"),
    ],
)
def test_a_wrong_training_is_named(task: str, algo: str, changes: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_spec(task, algo, 0, changes)


def test_an_argument_that_the_algorithm_does_not_have_is_named(tmp_path: Path) -> None:
    spec = _spec("ppo", **{"algorithm.gama": 0.9})
    with pytest.raises(InputError, match=r"must be arguments of stable_baselines3.PPO.*gama"):
        SB3(spec, tmp_path)


def test_shipped_comparisons_are_read_and_wrong_ones_named(tmp_path: Path) -> None:
    for name in shipped():
        study = read_comparison(name)
        assert all(spec.algo in ("apg", "ppo", "sac", "td3") for _, spec in study.trainings())
    text = 'about = ""\ntask = "torque_tracking"\nepisodes = 9\ntuning = 9\n[agents.a]\n'
    text += 'task = "backlash_position"\nalgo = "apg"\nseeds = [0]\n'
    (tmp_path / "mixed.toml").write_text(text, "utf-8")
    with pytest.raises(InputError, match="must have the episodes and the cost of torque_tracking"):
        read_comparison(str(tmp_path / "mixed.toml"))
    with pytest.raises(InputError, match="position_quick"):
        read_comparison("position_quik")


def test_regret_counts_what_is_worse_than_the_law_alone() -> None:
    task = TASKS.find("backlash_position_residual")()
    names = list(task.terms)
    own = dict.fromkeys(names, 2.0)
    better = regret(task, dict.fromkeys(names, 1.79), own, 0.1)
    assert float(better) == 0.0
    worse = dict.fromkeys(names, 1.0) | {names[2]: 2.0}
    want = 0.2 / task.terms[names[2]] / len(names)
    assert float(regret(task, worse, own, 0.1)) == pytest.approx(want)


def test_the_law_alone_is_what_an_idle_network_gives() -> None:
    env = build(PUSH)
    keys = unseen_keys(2)
    scores = score(env, idle_network(env), keys)
    found = jax.jit(jax.vmap(lambda key: alone(env, env.reset(key)[0])))(keys)
    np.testing.assert_allclose(found["iae_rad_s"], scores.numbers["iae_rad_s"], rtol=1e-6)
    named = score(nominal_of(env), idle_network(env), keys)
    assert named.cost[0] == named.cost[1] != scores.cost[0]


@pytest.mark.parametrize(
    ("change", "fine"),
    [
        ({}, True),
        ({"braking_peak_Nm": -1.0}, True),
        ({"braking_peak_Nm": -1.3}, False),
        ({"settle_2pct_s": np.inf}, False),
    ],
)
def test_no_worse_means_in_every_metric(change: dict[str, float], fine: bool) -> None:
    rival: Any = SimpleNamespace(metrics=dict.fromkeys(nominal.JUDGED["rad"], 2.0))
    rival.metrics["braking_peak_Nm"] = -1.2
    found: Any = SimpleNamespace(metrics=rival.metrics | change)
    assert nominal.no_worse(found, rival, "rad") is fine


def test_a_training_that_ended_before_its_first_checkpoint_says_so(tmp_path: Path) -> None:
    store.write_spec(tmp_path, _spec("apg"))
    with pytest.raises(InputError, match="it ended before the first one"):
        store.read_checkpoint(tmp_path, APG(_spec("apg")))


def _entry(name: str, cost: np.ndarray, learned: bool) -> Entry:
    seeds = len(cost)
    numbers = {"cost": cost, "iae_rad_s": cost / 10.0}
    return Entry(name, learned, numbers, cost > 90.0, np.full(seeds, 5.0), np.full(seeds, 2.0))


def test_the_table_has_medians_wins_and_intervals_of_seeds_and_episodes() -> None:
    random = np.random.default_rng(0)
    yardstick = random.uniform(0.9, 1.1, (1, 400))
    good = yardstick * np.array([[0.7], [0.8], [0.9]])
    like = np.repeat(yardstick, 3, 0) * np.array([[0.8], [1.0], [1.2]])
    entries = [_entry("tuned", yardstick, False), _entry("good", good, True)]
    entries.append(_entry("like", like, True))
    lines = comparison.table(entries)
    assert lines[0].name == "good"
    by = {line.name: line for line in lines}
    assert by["good"].ratio == pytest.approx(0.8)
    assert (by["good"].ratio_low, by["good"].ratio_high) == pytest.approx((0.7, 0.9))
    assert by["good"].wins == {"cost": 1.0, "iae_rad_s": 1.0}
    assert by["like"].wins["cost"] == pytest.approx(1 / 3)
    # The median of 400 uniform numbers of width 0.2 has a standard deviation of 0.1/sqrt(400).
    width = by["tuned"].high - by["tuned"].low
    assert width == pytest.approx(4 * 0.1 / 20, rel=0.3)
    first, *rest = comparison.sentences(lines)
    assert first.startswith("Learning pays: good costs 0.8 ")
    assert any(text.startswith("like does not pay") for text in rest)
