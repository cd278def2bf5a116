"""One environment behind Gymnasium's interface."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np

from envs import spaces
from envs.environment import build
from envs.picture import frame
from envs.runner import Runner
from jaxsim.errors import InputError
from jaxsim.transmissions.backlash import Backlash


class SingleEnv(gymnasium.Env):
    """A task as a `gymnasium.Env`; `reset(seed=...)` starts a chain of episodes of that seed.

    options: see `envs.environment.build`. The info of a step has the run's `status` and the
    metrics so far by name.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(self, task: str, render_mode: str | None = None, **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise InputError("render_mode", "must be rgb_array", render_mode, "or leave it out")
        self.render_mode = render_mode
        self._runner = Runner(build(task, **options), 1, restarts=False)
        self.action_space = spaces.action_space(self._runner.env.task)
        self.observation_space = spaces.observation_space(self._runner.env.task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is None and not self._runner.started:
            seed = int(self.np_random.integers(2**31))
        observation = self._runner.reset(None if seed is None else [seed])
        return observation[0], {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        outcome = self._runner.step(np.asarray(action)[None])
        names = self._runner.env.task.terms
        numbers = dict(zip(names, outcome.numbers[0].tolist(), strict=True))
        info = {"status": int(outcome.status[0]), **numbers}
        over = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        return outcome.observation[0], float(outcome.reward[0]), *over, info

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A picture of motor, gap and load, (240, 480, 3) uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        state = self._runner.state()
        axis, joint = state.carry.x.drive[0], state.loop.drive.transmission[0]
        theta_L, theta_B = float(axis.theta_L[0]), float(axis.theta_B[0])
        half_gap = float(joint.half_gap[0]) if isinstance(joint, Backlash) else 0.0
        angular = (state.loop.law.reference_unit or "rad") == "rad"
        reference = float(state.seen.reference[0]) if angular else None
        return frame(theta_L, theta_B, half_gap, reference)
