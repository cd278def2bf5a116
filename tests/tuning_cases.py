"""A short study of the bench that tests of tuning share."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

from jaxsim.study import Study, from_table, load
from tuning.session import Session
from tuning.spec import read_spec

SHORT = 0.1  # s: first impact, braking and the overshoot are over


def study(limits: dict[str, float] | None = None, **tune: Any) -> Study:
    """A short run of the bench with linear damping; K_B and K_P are free.

    All tests that run it use these metrics and this number of drives, so it compiles once.
    """
    table = copy.deepcopy(load("bench_linear_kb").table)
    table["scenario"]["duration"] = SHORT
    table["objective"] = {
        "minimise": {"itae_rad_s2": 1.0},
        "limits": limits or {"largest_torque_Nm": 1.5, "iae_rad_s": 0.02},
    }
    table["tune"] = {
        "starts": 2,
        "free": {"K_B": {"lower": -1.5, "upper": 0.0}, "K_P": {"lower": 3.0, "upper": 30.0}},
        "drives": {"count": 3, "screen": 3, "spread": {"half_gap": "20 %", "J_L": "20 %"}},
        **tune,
    }
    return from_table(table, Path(), "short")


def searched(what: Study, folder: Path, tell: Any = lambda progress: None) -> Session:
    session = Session(what, read_spec(what), folder / "checkpoint.json")
    session.search(tell)
    return session
