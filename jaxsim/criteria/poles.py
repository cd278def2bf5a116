"""Poles of the closed loop in every contact mode."""

from __future__ import annotations

from typing import Any, ClassVar

from jaxsim.criterion import Criterion, Subject
from jaxsim.linear import traced


class ContactPoles(Criterion):
    """Of all modes in which every joint is in contact, in every setting of the law's switches:

    rightmost_pole_per_s: largest real part, 1/s, negative where the loop is stable;
    least_damping: least -Re s/|s|, 1 where all poles are real.
    Linearised at the last reference of a position law, at the start's angles under a torque law,
    without ripple, friction and supply limit. Both have kinks where another pole takes over.
    Of a sampled law those of the map over one period, s = log(z)/period: stable inside |z| < 1.
    """

    values: ClassVar[tuple[str, ...]] = ("rightmost_pole_per_s", "least_damping")

    def measure(self, subject: Subject) -> dict[str, Any]:
        modes = subject.in_contact
        return dict(zip(self.values, (traced.rightmost(modes), traced.damping(modes)), strict=True))


class GapPoles(Criterion):
    """Of all modes in which a joint is in its gap:

    rightmost_gap_pole_per_s: largest real part, 1/s. Positions that nothing depends on and, of a
    drive of one joint, the load alone in the gap are left out: no law reaches them there.
    """

    values: ClassVar[tuple[str, ...]] = ("rightmost_gap_pole_per_s",)

    def measure(self, subject: Subject) -> dict[str, Any]:
        return {"rightmost_gap_pole_per_s": traced.rightmost(traced.in_the_gap(subject.loop))}
