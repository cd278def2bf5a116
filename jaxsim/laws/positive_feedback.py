"""Positive feedback of the load motion, which takes the load out of the torque loop."""

from __future__ import annotations

import warnings
from typing import Any, ClassVar, NamedTuple

import numpy as np

from jaxsim.derivative import Derivatives
from jaxsim.derivatives.model_based import ModelBased
from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.law import JointLaw, Measured, Scalar
from jaxsim.motors.dc import DC
from jaxsim.parameters import is_concrete, parameter, stacked

_ALPHAS = ("alpha_j", "alpha_a", "alpha_v")


class Gammas(NamedTuple):
    """The drive's intrinsic feedback from the load motion: each (n,), V s^3, V s^2, V s per rad."""

    j: Any
    a: Any
    v: Any


def gammas(drive: Drive) -> Gammas:
    """Gamma_j = L J_M N/K_t, Gamma_a = (L D_M + R J_M) N/K_t, Gamma_v = R D_M N/K_t + K_w N.

    Source: 2014 paper, (10). Raises: InputError for motors that are not DC motors.
    """
    j, a, v = [], [], []
    for motor, transmission in zip(drive.motor, drive.transmission, strict=True):
        if not isinstance(motor, DC):
            kind = type(motor).__name__
            raise InputError("drive.motor", "must be a DC motor to have Gammas", kind, "use DC")
        m, scale = motor, transmission.ratio / motor.K_t
        j.append(m.L * m.J_M * scale)
        a.append((m.L * m.D_M + m.R * m.J_M) * scale)
        v.append((m.R * m.D_M + m.K_w * m.K_t) * scale)
    return Gammas(stacked(j), stacked(a), stacked(v))


class PositiveFeedback(JointLaw):
    """v = alpha_j Gamma_j theta_L''' + alpha_a Gamma_a theta_L'' + alpha_v Gamma_v theta_L';

    2014 paper (12) with all alphas 1, (23) in general. Add it to a torque law per joint:
    `Decentral((PITorque(2, 12.5), PITorque(2, 25))) + PositiveFeedback.design(drive)`.
    source: where the derivatives come from. Alphas outside [0, 1] are taken, with a warning that
    names them: the stability results of the paper do not cover them.
    """

    command_unit: ClassVar[str] = "V"  # type: ignore[assignment]

    source: Derivatives
    Gamma_j: Scalar = parameter("V s^3/rad", "per joint, (10)", ndim=1)
    Gamma_a: Scalar = parameter("V s^2/rad", "per joint, (10)", ndim=1)
    Gamma_v: Scalar = parameter("V s/rad", "per joint, (10)", ndim=1)
    alpha_j: Scalar = parameter("1", "share of the jerk feedback", default=1.0)
    alpha_a: Scalar = parameter("1", "share of the acceleration feedback", default=1.0)
    alpha_v: Scalar = parameter("1", "share of the velocity feedback", default=1.0)

    @classmethod
    def design(
        cls,
        drive: Drive,
        alpha_j: Scalar = 1.0,
        alpha_a: Scalar = 1.0,
        alpha_v: Scalar = 1.0,
        *,
        source: Derivatives | None = None,
    ) -> PositiveFeedback:
        """Gammas from the data of a drive; derivatives from its own model where none are given."""
        source = ModelBased.design(drive) if source is None else source
        return cls(source, *gammas(drive), alpha_j, alpha_a, alpha_v)

    design_units: ClassVar[dict[str, str]] = dict.fromkeys(_ALPHAS, "1")

    def __check_init__(self) -> None:
        sizes = [np.shape(g)[-1:] for g in (self.Gamma_j, self.Gamma_a, self.Gamma_v)]
        counts = {*sizes, *([] if self.source.axes is None else [(self.source.axes,)])}
        if len(counts) != 1 or () in counts:
            raise InputError(
                "PositiveFeedback.Gamma", "must hold one number per joint of the source",
                sorted(counts), "give lists of one length",
            )  # fmt: skip
        for name in _ALPHAS:
            alpha = getattr(self, name)
            if is_concrete(alpha) and np.any((np.asarray(alpha) < 0) | (np.asarray(alpha) > 1)):
                words = f"PositiveFeedback.{name} = {np.asarray(alpha).tolist()} is outside [0, 1]"
                warnings.warn(words, UserWarning, stacklevel=2)

    @property
    def axes(self) -> int:
        return np.shape(self.Gamma_j)[-1]

    @property
    def discrete(self) -> bool:
        return self.source.discrete

    def check_period(self, period: float) -> None:
        self.source.check_period(period)

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        return self.source.rest(ys)

    def field(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> Any:
        return self.source.field(state, ys)

    def on_sample(self, state: Any, ys: tuple[Measured, ...], period: float) -> Any:
        return self.source.on_sample(state, ys, period)

    def command(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> tuple[Scalar, ...]:
        j, a, v = (
            getattr(self, f"alpha_{k}") * getattr(self, f"Gamma_{k}") for k in ("j", "a", "v")
        )
        return tuple(
            j[i] * m.jerk + a[i] * m.acceleration + v[i] * m.velocity
            for i, m in enumerate(self.source.motion(state, ys))
        )
