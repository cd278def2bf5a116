"""Environments behind stable-baselines3: its checker, resets, statistics, training that repeats."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="stable-baselines3 comes with the extra `rl`")

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecNormalize

from envs.registration import IDS
from envs.sb3 import BatchedVecEnv
from jaxsim.errors import InputError

POSITION = "gearlash/BacklashPosition-v0"
STEPS = 300


@pytest.mark.parametrize("name", IDS)
def test_the_checker_has_nothing_to_say(name: str) -> None:
    check_env(gymnasium.make(IDS[name]).unwrapped)  # warnings are errors here


def test_ends_of_episodes_are_those_of_the_single_environment() -> None:
    batch, single = BatchedVecEnv("backlash_position", 2), gymnasium.make(POSITION)
    batch.seed(3)
    assert np.array_equal(batch.reset()[1], single.reset(seed=4)[0])
    actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, 2, 1)).astype(np.float32)
    total = 0.0
    for step, action in enumerate(actions):
        observation, reward, done, infos = batch.step(action)
        final, own, _, over, info = single.step(action[1])
        total += own
        assert (reward[1], done[1]) == (np.float32(own), over)
        assert observation.dtype == reward.dtype == np.float32
        assert observation.flags.writeable
        assert reward.flags.writeable
        if step < STEPS - 1:
            assert infos == [{"TimeLimit.truncated": False}] * 2
    assert done.all()
    assert np.array_equal(infos[1]["terminal_observation"], final)
    assert np.array_equal(observation[1], single.reset()[0])
    assert infos[1]["TimeLimit.truncated"] is True
    assert infos[1]["episode"]["r"] == pytest.approx(total)
    assert infos[1]["episode"]["l"] == STEPS
    assert {k: infos[1][k] for k in info} == info


def _trained(seed: int) -> list[np.ndarray]:
    env = VecNormalize(BatchedVecEnv("backlash_position_residual", 8))
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, n_epochs=2, seed=seed, device="cpu")
    model.learn(1024)
    return [v.detach().numpy().copy() for v in model.policy.parameters()]


def test_ppo_trains_unchanged_and_repeats_exactly_for_a_seed() -> None:
    torch.set_num_threads(1)
    first, again, other = _trained(1), _trained(1), _trained(2)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_what_members_of_a_batch_cannot_do_is_told() -> None:
    env = BatchedVecEnv("backlash_position", 2)
    env.reset()
    with pytest.raises(InputError, match="build another environment"):
        env.set_attr("dt", 1e-3)
    with pytest.raises(InputError, match="use SingleEnv"):
        env.env_method("render")
    with pytest.raises(InputError, match=r"got \[nan\] \(env 1\)"):
        env.step(np.array([[0.0], [np.nan]], np.float32))
