"""Gymnasium's spaces of a task."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box

from envs.task import Channel, Task


def action_space(task: Task) -> Box:
    """[-1, 1] per action, float32."""
    return _box(task.actions)


def observation_space(task: Task) -> Box:
    """The box of the channels, float32."""
    return _box(task.channels)


def _box(channels: tuple[Channel, ...]) -> Box:
    low, high = ([getattr(c, name) for c in channels] for name in ("low", "high"))
    return Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)
