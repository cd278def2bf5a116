"""Load derivatives from a model of the load."""

from __future__ import annotations

from typing import Any

import jax

from jaxsim.derivative import Derivatives, Motion
from jaxsim.drive import Drive, Load
from jaxsim.law import Measured, Scalar
from jaxsim.parameters import POSITIVE, parameter, stacked


class ModelBased(Derivatives):
    """theta_L'' = M^-1 (T_s - C - D_L theta_L' - G) and its derivative; 2014 paper (16)-(19).

    load: the law's OWN copy, which may be wrong; load disturbances are not known to it. K: (n,)
    its joint stiffnesses, Nm/rad: T_s' = K omega_B, which neglects transmission damping and, in
    a joint with play, takes the gap for a spring. The velocity is the measured one. (17) is
    taken as the directional derivative of (16), which needs no formula for the rates of M and C.
    """

    load: Load
    K: Scalar = parameter("Nm/rad", "stiffness per joint", rule=POSITIVE, ndim=1)

    @classmethod
    def design(cls, drive: Drive) -> ModelBased:
        """The model that is right for a drive: a copy of its load and its stiffnesses."""
        return cls(drive.load, stacked([t.K for t in drive.transmission]))  # type: ignore[attr-defined]

    @property
    def axes(self) -> int:
        return self.load.axes

    def motion(self, state: Any, ys: tuple[Measured, ...]) -> tuple[Motion, ...]:
        theta, omega, torque = (
            tuple(getattr(y, name) for y in ys) for name in ("theta_L", "omega_L", "T_s")
        )
        acceleration = self.load.acceleration(theta, omega, torque)
        torque_rate = tuple(self.K[i] * y.omega_B for i, y in enumerate(ys))
        _, jerk = jax.jvp(
            self.load.acceleration, (theta, omega, torque), (omega, acceleration, torque_rate)
        )
        return tuple(map(Motion, omega, acceleration, jerk))
