"""How a run ended."""

from __future__ import annotations

import enum


class Status(enum.IntEnum):
    """Status of one run, one per batch member."""

    OK = 0
    EVENTS = 1
    DIVERGED = 2
    INVALID = 3
    SINGULAR = 4

    @property
    def words(self) -> str:
        """What it means and what to do about it."""
        return {
            Status.OK: "complete",
            Status.EVENTS: "more events than there was room for: lower the gains if it chatters, "
            "else raise max_events",
            Status.DIVERGED: "the state became infinite: reduce dt or the gains",
            Status.INVALID: "a parameter breaks its rule",
            Status.SINGULAR: "the load's mass matrix is not positive definite at an angle met: "
            "check M(theta_L) and its parameters",
        }[self]
