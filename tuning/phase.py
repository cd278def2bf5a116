"""The phases of a search: which solver, on which model, on a few drives or on all."""

from __future__ import annotations

from typing import NamedTuple

from jaxsim.hybrid import Deadzone, Smoothed
from jaxsim.study import Study
from tuning.spec import Spec

SCREEN, FULL = "screen", "full"


class Phase(NamedTuple):
    """stage: "screen", all starts on a few drives, or "full"; solver: its name; title: in words."""

    stage: str
    solver: str
    deadzone: Deadzone
    title: str


def phases(study: Study, spec: Spec) -> tuple[Phase, ...]:
    """Smoothed models first, then every solver in turn, then the last one on all drives.

    The last phase is always on the study's own model.
    """
    last, own = spec.solvers[-1], study.run.deadzone
    screening = spec.screen < spec.count
    where = f", {spec.screen} drives" if screening else ""
    steps = [(last, Smoothed(width=w), f"{last}, smoothed {w:g} rad") for w in spec.smoothing]
    steps += [(name, own, name) for name in spec.solvers]
    first = SCREEN if screening else FULL
    found = [
        Phase(first, name, deadzone, f"{title}: {spec.starts} starts{where}")
        for name, deadzone, title in steps
    ]
    if screening:
        few = f"{spec.working} of " if spec.working < spec.count else ""
        found.append(Phase(FULL, last, own, f"{last}: best starts, {few}{spec.count} drives"))
    return tuple(found)
