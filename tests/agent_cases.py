"""A task that is learnt in seconds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from envs.tasks.backlash_position import BacklashPosition


class Push(BacklashPosition):
    """The first 30 ms of the position step: all that matters is to push, and which way."""

    duration: ClassVar[float] = 0.03
    # 20 ms at the mean step of 0.3 rad: 1 is what doing nothing costs on average.
    terms: ClassVar[Mapping[str, float]] = {"iae_rad_s": 6e-3}
    action_rate: ClassVar[float] = 0.0


PUSH = "agent_cases:Push"
