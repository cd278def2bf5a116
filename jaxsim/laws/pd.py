"""PD with filtered derivative, and its design by pole placement."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, parameter


class PD(Law):
    """T_PD = (K_P + K_D s/(1 + tau_D s)) (theta_Lref - theta_L); 2018 paper (21).

    State z of the derivative filter: z' = (e - z)/tau_D, T_PD = K_P e + K_D (e - z)/tau_D.
    """

    K_P: Scalar = parameter("Nm/rad", "proportional gain", rule=NON_NEGATIVE)
    K_D: Scalar = parameter("Nm s/rad", "derivative gain", rule=NON_NEGATIVE)
    tau_D: Scalar = parameter("s", "time constant of the derivative filter", rule=POSITIVE)

    design_units: ClassVar[dict[str, str]] = {"omega_1": "rad/s", "omega_2": "rad/s", "zeta": "1"}

    @classmethod
    def design(cls, drive: Drive, omega_1: float, omega_2: float, zeta: float) -> PD:
        """For files: `design = { omega_1 = ..., ... }`; see `place_poles`."""
        return place_poles(drive, omega_1, omega_2, zeta)

    @property
    def reference_unit(self) -> str:
        return "rad"

    def rest(self, y: Measured) -> Any:
        return (y.reference - y.theta_L,)

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        return ((1.0 / self.tau_D) * (y.reference - y.theta_L - state[0]),)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        error = y.reference - y.theta_L
        return self.K_P * error + (self.K_D / self.tau_D) * (error - state[0])


def place_poles(drive: Drive, omega_1: float, omega_2: float, zeta: float) -> PD:
    """The PD law that gives the RIGID drive the poles (s + w1)(s^2 + 2 zeta w2 s + w2^2).

    Rigid drive J theta'' + D theta' = T with J = J_M + J_L, D = D_M + D_L (N = 1). With the
    derivative filter the characteristic polynomial is
    tau J s^3 + (J + tau D) s^2 + (D + K_P tau + K_D) s + K_P, compared coefficient by
    coefficient. Source: 2018 paper, section III.B.

    Raises: InputError for poles that need a negative gain or filter.
    """
    motor, load = drive.motor[0], drive.load
    inertia, viscosity = float(motor.J_M + load.J_L), float(motor.D_M + load.D_L)  # type: ignore[attr-defined]
    target = np.polymul([1.0, omega_1], [1.0, 2.0 * zeta * omega_2, omega_2**2])
    tau_D = inertia / (inertia * target[1] - viscosity)
    K_P = target[3] * tau_D * inertia
    K_D = target[2] * tau_D * inertia - viscosity - K_P * tau_D
    if min(tau_D, K_P, K_D) <= 0.0:
        raise InputError(
            "poles",
            "must be reachable with positive K_P, K_D, tau_D",
            f"K_P={K_P:.4g}, K_D={K_D:.4g}, tau_D={tau_D:.4g}",
            "place the poles further left",
        )
    return PD(K_P, K_D, tau_D)
