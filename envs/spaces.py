"""Gymnasium's spaces of a task."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box

from envs.task import Task


def action_space(task: Task) -> Box:
    """[-1, 1] per action, float32."""
    return Box(-1.0, 1.0, (len(task.actions),), np.float32)


def observation_space(task: Task) -> Box:
    """The box of the channels, float32."""
    low, high = ([getattr(c, name) for c in task.channels] for name in ("low", "high"))
    return Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)
