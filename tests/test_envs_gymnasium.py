"""Environments behind Gymnasium: its checker, seeds, resets within a batch, bad input."""

from __future__ import annotations

import functools
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from envs.registration import IDS
from envs.single import SingleEnv
from jaxsim.errors import InputError

POSITION = "gearlash/BacklashPosition-v0"
STEPS = 300


def _vector(size: int, **options: Any) -> Any:
    return gymnasium.make_vec(POSITION, size, vectorization_mode="vector_entry_point", **options)


@functools.cache
def _actions(steps: int, size: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (steps, size, 1)).astype(np.float32)


def test_ids_are_those_of_the_tasks() -> None:
    assert set(IDS.values()) == {
        POSITION,
        "gearlash/BacklashPositionResidual-v0",
        "gearlash/BacklashPositionSchedule-v0",
        "gearlash/TorqueTracking-v0",
        "gearlash/TorqueTrackingResidual-v0",
    }
    assert gymnasium.make(f"envs.registration:{POSITION}").spec.id == POSITION


@pytest.mark.parametrize("name", IDS)
def test_gymnasiums_checker_has_nothing_to_say(name: str) -> None:
    env = gymnasium.make(IDS[name], render_mode="rgb_array", disable_env_checker=True)
    check_env(env.unwrapped)  # warnings are errors here
    env.close()


def test_a_member_of_a_batch_is_bit_for_bit_the_single_environment() -> None:
    """Over two resets, each member at its own time: the seeds i, i + 1, ... and their chains."""
    batch, singles = _vector(3), [gymnasium.make(POSITION) for _ in range(3)]
    observations, _ = batch.reset(seed=7)
    for i, env in enumerate(singles):
        assert np.array_equal(env.reset(seed=7 + i)[0], observations[i])
    for actions in _actions(2 * STEPS + 20, 3):
        observations, rewards, _, truncated, infos = batch.step(actions)
        for i, env in enumerate(singles):
            own, reward, _, over, info = env.step(actions[i])
            assert (reward, over) == (rewards[i], truncated[i])
            shown = infos["final_info"] if over else infos
            assert {k: shown[k][i] for k in info} == info
            if over:
                assert np.array_equal(infos["final_obs"][i], own)
                own, _ = env.reset()
            assert np.array_equal(own, observations[i])


def test_the_others_keep_moving_while_one_resets() -> None:
    """Member 0 is made to fail in its step 10; member 1 goes on as if it were alone."""
    both, alone = _vector(2), _vector(2)
    for env in (both, alone):
        env.reset(seed=[1, 2])
    ended = None
    for step, actions in enumerate(_actions(40, 2)):
        if step == 10:  # nothing in the state of member 0 is finite any more
            _, rows = both.unwrapped._runner._state
            rows["float32"] = rows["float32"].at[:, 0].set(np.nan)
        got, want = both.step(actions), alone.step(actions)
        assert np.array_equal(got[0][1], want[0][1])
        assert got[1][1] == want[1][1]
        if got[2][0]:
            ended = step
            assert np.isfinite(got[0]).all()
            assert got[4]["_final_obs"].tolist() == [True, False]
            assert got[0][0, 7] == 1.0, "a whole episode remains"
    assert ended == 10


def test_arrays_handed_out_are_fresh_writable_float32() -> None:
    env = _vector(2)
    first, _ = env.reset(seed=0)
    second = env.step(_actions(1, 2)[0])[0]
    kept = second.copy()
    for array in (first, second):
        assert array.dtype == np.float32
        assert array.flags.writeable
        array[:] = 7.0
    env.reset(seed=0)
    assert np.array_equal(env.step(_actions(1, 2)[0])[0], kept)


def test_statistics_wrapper_of_gymnasium_counts_whole_episodes() -> None:
    env = RecordEpisodeStatistics(_vector(2))
    env.reset(seed=0)
    rewards = 0.0
    for actions in _actions(STEPS, 2):
        _, reward, _, truncated, infos = env.step(actions)
        rewards = rewards + reward
    assert truncated.all()
    np.testing.assert_allclose(infos["episode"]["r"], rewards)
    assert infos["episode"]["l"].tolist() == [STEPS, STEPS]


def test_pictures_show_the_tooth_where_it_is() -> None:
    env = gymnasium.make(POSITION, render_mode="rgb_array", nominal=True)
    env.reset(seed=0)
    assert _tooth(env) == pytest.approx(360.0, abs=1.0)  # mid-gap
    for _ in range(5):
        env.step(np.array([0.1], np.float32))
    theta_B = float(env.unwrapped._runner.state().carry.x.drive[0].theta_B[0])
    assert theta_B > 1e-3
    assert _tooth(env) == pytest.approx(360.0 + 40.0 * theta_B / 7.8e-3, abs=1.0)


def _tooth(env: Any) -> float:
    """The middle column of the red tooth, looked at above the flanks."""
    red = env.render()[55:65, 240:, 0] == 200
    return 240.0 + float(np.flatnonzero(red.all(axis=0)).mean())


@pytest.mark.parametrize(
    ("action", "said"),
    [
        ([np.nan], r"must be finite and in \[-1, 1\]; got \[nan\]"),
        ([1.5], r"must be finite and in \[-1, 1\]; got \[1.5\]"),
        ([0.0, 0.0], r"must have shape \(1, 1\); got \(1, 2\)"),
    ],
)
def test_bad_actions_are_refused_and_spoil_nothing(action: list[float], said: str) -> None:
    env = gymnasium.make(POSITION, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    good = env.step(np.zeros(1, np.float32))
    env.reset(seed=0)
    with pytest.raises(InputError, match=said):
        env.step(np.array(action, np.float32))
    again = env.step(np.zeros(1, np.float32))
    assert np.array_equal(good[0], again[0])
    assert good[1] == again[1]


def test_a_bad_action_in_a_batch_is_told_by_index() -> None:
    env = _vector(3)
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"got \[2.0\] \(env 1\)"):
        env.step(np.array([[0.0], [2.0], [0.0]], np.float32))


def test_other_mistakes_are_told() -> None:
    with pytest.raises(gymnasium.error.NameNotFound, match="BacklashPosition"):
        gymnasium.make("gearlash/BacklashPositon-v0")
    with pytest.raises(InputError, match="did you mean nominal"):
        gymnasium.make(POSITION, nominl=True)
    with pytest.raises(InputError, match="num_envs: must be >= 1"):
        _vector(0)
    env = gymnasium.make(POSITION, disable_env_checker=True).unwrapped
    with pytest.raises(InputError, match="must come after a reset"):
        env.step(np.zeros(1, np.float32))
    with pytest.raises(InputError, match="render_mode: must be rgb_array; got ansi"):
        SingleEnv("backlash_position", render_mode="ansi")
    with pytest.raises(InputError, match="seed: must hold 2 seeds"):
        _vector(2).reset(seed=[1, 2, 3])
