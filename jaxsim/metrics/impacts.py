"""Contacts: when, how fast, how hard."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp

from jaxsim import hermite
from jaxsim.engine import Piece
from jaxsim.metric import Metric, Scalar


class Contact(NamedTuple):
    """One contact interval: its side (0 before it begins), whether it lasts, its numbers."""

    side: Scalar
    lasts: Scalar
    begun: Scalar
    speed: Scalar
    peak: Scalar
    ended: Scalar

    def follow(self, piece: Piece, begins: Scalar, highest: Scalar, lowest: Scalar) -> Contact:
        """Take in one piece; `begins` says that a contact of this kind begins with it."""
        now = piece.before.contact
        begins = begins & (self.side == 0.0)
        side = jnp.where(begins, now, self.side)
        lasts = (begins | (self.lasts > 0.0)) & (now == side)
        peak = jnp.where(side > 0.0, highest, -lowest)
        ends = (self.lasts > 0.0) & ~lasts
        return Contact(
            side,
            lasts.astype(self.lasts.dtype),
            jnp.where(begins, piece.t, self.begun),
            jnp.where(begins, piece.before.omega_B, self.speed),
            jnp.where(lasts, jnp.maximum(self.peak, peak), self.peak),
            jnp.where(ends, piece.t, self.ended),
        )


class Impacts(Metric):
    """The first contact, the braking contact (the first on the other side), and the largest T_s.

    first_contact_s, entry_speed_rad_s: time and omega_B at the first contact (inf, 0 if none);
    first_impact_Nm: largest T_s of that contact interval, signed by its side (0 if none);
    first_separation_s: its end (inf if it lasts);
    braking_contact_s, braking_speed_rad_s, braking_peak_Nm: the same on the other side;
    largest_torque_Nm: largest |T_s| of the whole run; peak and lowest T_s signed.

    Peaks are those of the cubic Hermite of each step, and include T_s just after contact.
    """

    values: ClassVar[tuple[str, ...]] = (
        "first_contact_s",
        "entry_speed_rad_s",
        "first_impact_Nm",
        "first_separation_s",
        "braking_contact_s",
        "braking_speed_rad_s",
        "braking_peak_Nm",
        "largest_torque_Nm",
        "T_s_max_Nm",
        "T_s_min_Nm",
    )
    never: ClassVar[Mapping[str, tuple[float, str]]] = {
        "first_contact_s": (math.inf, "no contact"),
        "first_separation_s": (math.inf, "no separation"),
        "braking_contact_s": (math.inf, "none on the other side"),
    }

    def start(self) -> Any:
        zero = jnp.zeros_like(self.task.target)
        none = Contact(zero, zero, zero + jnp.inf, zero, zero, zero + jnp.inf)
        return none, none, zero, zero

    def update(self, fold: Any, piece: Piece) -> Any:
        first, braking, top, bottom = fold
        torque = piece.segment("T_s")
        lowest, highest = hermite.widened(jnp.inf, -jnp.inf, torque)
        bottom, top = hermite.widened(bottom, top, torque)
        contact = piece.before.contact
        braked = (first.side != 0.0) & (contact == -first.side)
        return (
            first.follow(piece, contact != 0.0, highest, lowest),
            braking.follow(piece, braked, highest, lowest),
            top,
            bottom,
        )

    def finish(self, fold: Any) -> dict[str, Scalar]:
        first, braking, top, bottom = fold
        return {
            "first_contact_s": first.begun,
            "entry_speed_rad_s": first.speed,
            "first_impact_Nm": first.side * first.peak,
            "first_separation_s": first.ended,
            "braking_contact_s": braking.begun,
            "braking_speed_rad_s": braking.speed,
            "braking_peak_Nm": braking.side * braking.peak,
            "largest_torque_Nm": jnp.maximum(top, -bottom),
            "T_s_max_Nm": top,
            "T_s_min_Nm": bottom,
        }
