"""Gain and phase margins of the closed loop, axis by axis."""

from __future__ import annotations

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxsim.criterion import Criterion, Subject
from jaxsim.errors import InputError
from jaxsim.linear import traced
from jaxsim.linear.traced import Cut, Loop, Modes


class CommandMargins(Criterion):
    """The loop cut at the command of one axis, all others closed, worst of all contact modes:

    gain_margin_dB, gain_reduction_dB: by how much its gain may rise, or fall, until poles lie on
    the imaginary axis, at most 60; phase_margin_deg: at most 180. One per axis. Where the closed
    loop is unstable they are negative: the distance to the nearest gain or phase at which it
    changes. Linearised where the poles of `ContactPoles` are; of a sampled law at the samples.
    """

    values: ClassVar[tuple[str, ...]] = ("gain_margin_dB", "gain_reduction_dB", "phase_margin_deg")

    def measure(self, subject: Subject) -> dict[str, Any]:
        modes = subject.in_contact
        return dict(zip(self.values, _worst(modes, modes.commands), strict=True))


class TorqueMargins(Criterion):
    """The same with the loop cut at the PI torque law of one axis, inside positive feedback:

    torque_gain_margin_dB, torque_gain_reduction_dB, torque_phase_margin_deg. Full positive
    feedback cancels the load, so that its own gain has no margin: k_o of the 2014 paper, (34),
    is the gain of the PI laws alone.
    """

    values: ClassVar[tuple[str, ...]] = (
        "torque_gain_margin_dB", "torque_gain_reduction_dB", "torque_phase_margin_deg",
    )  # fmt: skip

    def measure(self, subject: Subject) -> dict[str, Any]:
        modes = subject.in_contact
        if modes.torques is None:
            raise InputError(
                "law", "must have one gain K_p per axis to have torque margins",
                type(subject.loop.law).__name__, "use gain_margin_dB, the margin at the command",
            )  # fmt: skip
        return dict(zip(self.values, _worst(modes, modes.torques), strict=True))


def _worst(modes: Modes, cuts: Cut) -> tuple[Any, ...]:
    """Margins (axes,) of gain, up and down, and phase: the least of all modes."""

    def one(A: Any, cut: Cut, period: Any) -> Any:
        own = Modes(A[None], cut, None, None if period is None else period[None])
        stable = traced.rightmost(own) < 0.0

        def told(loop: Loop) -> Any:
            both = traced.gain_margins(loop, stable)
            return jnp.append(both, traced.phase_margin(loop, stable))

        return jax.vmap(told)(traced.cut_loops(A, cut, period))

    return tuple(jax.vmap(one)(modes.A, cuts, modes.period).min(axis=0).T)
