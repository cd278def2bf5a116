"""Many environments in one compiled step, behind Gymnasium's vector interface."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from envs import spaces
from envs.environment import build
from envs.runner import Outcome, Runner
from jaxsim.errors import InputError


class BatchedEnv(VectorEnv):
    """A task as a `gymnasium.vector.VectorEnv` that resets within the same step.

    `reset(seed=s)` gives member i the episodes of `SingleEnv` with the seed s + i; a list gives
    each its own. Infos are as those of Gymnasium's own vector environments: `final_obs` and
    `final_info` where an episode ended.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(self, task: str, num_envs: int = 1, **options: Any) -> None:
        self.num_envs = num_envs
        self._runner = Runner(build(task, **options), num_envs, restarts=True)
        own = self._runner.env.task
        self.single_action_space = spaces.action_space(own)
        self.single_observation_space = spaces.observation_space(own)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed if isinstance(seed, int) else None)
        return self._runner.reset(self._seeds(seed)), {}

    def _seeds(self, seed: int | list[int | None] | None) -> list[int] | None:
        if seed is None and self._runner.started:
            return None
        if seed is None:
            seed = int(self.np_random.integers(2**31))
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed)
        if len(seeds) != self.num_envs:
            raise InputError("seed", f"must hold {self.num_envs} seeds", seeds, "one per env")
        return [int(self.np_random.integers(2**31)) if s is None else s for s in seeds]

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        outcome = self._runner.step(actions)
        reward = outcome.reward.astype(np.float64)
        infos = self._infos(outcome)
        return outcome.observation, reward, outcome.terminated, outcome.truncated, infos

    def _infos(self, outcome: Outcome) -> dict[str, Any]:
        over = outcome.terminated | outcome.truncated
        columns = dict(zip(self._runner.env.task.terms, outcome.numbers.T, strict=True))
        columns = {"status": outcome.status, **columns}
        infos = _masked(columns, ~over)
        if over.any():
            final = np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(over):
                final[i] = outcome.final[i]
            ended = {"final_obs": final, "final_info": _masked(columns, over)}
            infos |= ended | {f"_{name}": over.copy() for name in ended}
        return infos


def _masked(columns: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    """Columns with Gymnasium's masks `_name`, zero where they do not hold."""
    shown = {name: np.where(mask, v, np.zeros((), v.dtype)) for name, v in columns.items()}
    return shown | {f"_{name}": mask.copy() for name in columns}
