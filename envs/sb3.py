"""Many environments in one compiled step, behind the interface of stable-baselines3."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv  # pyright: ignore[reportMissingImports]

from envs import spaces
from envs.environment import build
from envs.runner import Outcome, Runner
from jaxsim.errors import InputError


class BatchedVecEnv(VecEnv):
    """A task as an SB3 `VecEnv`: resets within the same step, statistics of episodes included.

    At the end of an episode its info has `terminal_observation`, `TimeLimit.truncated`, the
    metrics by name, and `episode` with return `r`, length `l` and time `t`, as `VecMonitor`
    gives them; that wrapper is not needed. `seed(s)` gives member i the episodes of the seed
    s + i. options: see `envs.environment.build`.
    """

    def __init__(self, task: str, num_envs: int, **options: Any) -> None:
        self._runner = Runner(build(task, **options), num_envs, restarts=True)
        own = self._runner.env.task
        # SB3's base class asks for `render_mode` through get_attr.
        self.render_mode = None
        super().__init__(num_envs, spaces.observation_space(own), spaces.action_space(own))
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, int)
        self._began = time.perf_counter()
        self._actions = np.zeros(0)

    def reset(self) -> np.ndarray:
        seeds = self._seeds if any(s is not None for s in self._seeds) else None
        if seeds is None and not self._runner.started:
            seeds = self._drawn([None] * self.num_envs)
        observation = self._runner.reset(None if seeds is None else self._drawn(seeds))
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observation

    @staticmethod
    def _drawn(seeds: Sequence[int | None]) -> list[int]:
        """Seeds, from the operating system where none was given."""
        return [np.random.SeedSequence().entropy if s is None else s for s in seeds]  # type: ignore[misc]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        outcome = self._runner.step(self._actions)
        done = outcome.terminated | outcome.truncated
        self._returns += outcome.reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done).tolist():
            infos[i] = self._ended(outcome, i)
        self._returns[done], self._lengths[done] = 0.0, 0
        return outcome.observation, outcome.reward, done, infos

    def _ended(self, outcome: Outcome, i: int) -> dict[str, Any]:
        episode = {
            "r": float(self._returns[i]),
            "l": int(self._lengths[i]),
            "t": round(time.perf_counter() - self._began, 6),
        }
        numbers = dict(zip(self._runner.env.task.terms, outcome.numbers[i].tolist(), strict=True))
        return {
            "TimeLimit.truncated": bool(outcome.truncated[i]),
            "terminal_observation": outcome.final[i],
            "status": int(outcome.status[i]),
            "episode": episode,
            **numbers,
        }

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise InputError(
            attr_name, "cannot be set on members of a batch", value, "build another environment"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        raise InputError(
            method_name, "cannot be called on members of a batch", method_args, "use SingleEnv"
        )

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
