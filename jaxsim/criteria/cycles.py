"""Whether a loop keeps oscillating by itself after a small push."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxsim.criterion import Criterion, Subject
from jaxsim.linear import operating
from jaxsim.loop import ClosedLoop
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant

_SIZES = (0.5, 1.0, 2.0, 5.0)  # of the half gap: inside it, at its edge, beyond it
_WITHOUT_PLAY = 1e-3  # rad


class SmallStarts(Criterion):
    """Runs of the scenario's duration from small amplitudes, nothing else moving:

    small_start_cycle_rad: largest peak-to-peak of theta_L in their last 40 %; 0 when all come to
    rest. One per axis. A position law starts with theta_L off its last reference, a torque law
    with the deflection off zero, its reference the torque that holds the load; off by 0.5, 1, 2
    and 5 half gaps (mrad where there is no play). Sampled laws run as they are. The duration must
    let what dies out die out.
    """

    values: ClassVar[tuple[str, ...]] = ("small_start_cycle_rad",)

    def measure(self, subject: Subject) -> dict[str, Any]:
        name = "limit_cycle_rad"

        def one(size: Any) -> Any:
            return subject.again(_pushed(subject.loop, size), (name,))[name]

        return {"small_start_cycle_rad": jax.vmap(one)(jnp.array(_SIZES)).max(axis=0)}


def _pushed(loop: ClosedLoop, size: Any) -> Scenario:
    angles, axes = operating.angles(loop), range(loop.drive.axes)
    off = [size * _unit(t) for t in loop.drive.transmission]
    if loop.law.reference_unit == "Nm":
        references = tuple(operating.weight(loop.drive, angles))
        starts = tuple(Start(theta_L=angles[i], theta_B=off[i]) for i in axes)
    else:
        references = angles
        starts = tuple(Start(theta_L=angles[i] - off[i]) for i in axes)
    still = tuple(Constant(0.0 * r) for r in references)
    references = tuple(Constant(1.0 * r) for r in references)
    return replace(loop.scenario, reference=references, load_torque=still, start=starts)


def _unit(transmission: Any) -> Any:
    half_gap = jnp.asarray(getattr(transmission, "half_gap", 0.0))
    return jnp.where(half_gap > 0.0, half_gap, _WITHOUT_PLAY)
