"""Section III.B of the 2018 paper: the PD gains from their poles."""

from __future__ import annotations

import math

import numpy as np

from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.findings import Findings, Group, Row, against_paper, against_reference
from jaxsim.reproduction import _bench_2018 as bench

ERRATA = "pole placement WITH the derivative filter on the rigid drive"
# The paper prints poles, not gains.
GAINS = {
    "K_P": ("proportional gain", "Nm/rad", 10.28129662037006),
    "K_D": ("derivative gain", "Nm s/rad", 0.05470907749696041),
    "tau_D": ("time constant of the derivative filter", "s", 5.82812354062619e-3),
}
POLES = {
    "omega_1_Hz": ("real pole of the rigid drive", "Hz", 18.0, 0.5),
    "omega_2_Hz": ("natural frequency of its pole pair", "Hz", 15.0, 0.5),
    "zeta": ("damping ratio of its pole pair", "1", 0.70, 0.005),
}


class Design(Group):
    """The gains, and the poles that they give back."""

    paper = bench.PAPER
    title = "PD gains by pole placement (section III.B)"

    def find(self) -> Findings:
        pd = bench.gains()
        gains = [
            against_reference(
                f"design.{name}", words, unit, float(getattr(pd, name)), reference, ERRATA
            )
            for name, (words, unit, reference) in GAINS.items()
        ]
        return Findings([*gains, *_poles()], {})


def _poles() -> list[Row]:
    """What the printed poles come back as from the characteristic polynomial of the rigid drive."""
    pd, drive = bench.gains(), bench_2018()
    K_P, K_D, tau = (float(v) for v in (pd.K_P, pd.K_D, pd.tau_D))
    motor, load = drive.motor[0], drive.load
    J = float(motor.J_M + load.J_L)  # type: ignore[attr-defined]
    D = float(motor.D_M + load.D_L)  # type: ignore[attr-defined]
    roots = np.roots([tau * J, J + tau * D, D + K_P * tau + K_D, K_P])
    pair = roots[np.argmax(roots.imag)]
    real = roots[np.argmin(abs(roots.imag))].real
    found = {
        "omega_1_Hz": -real / (2.0 * math.pi),
        "omega_2_Hz": abs(pair) / (2.0 * math.pi),
        "zeta": -pair.real / abs(pair),
    }
    note = "half of the last digit; poles of J theta'' + D theta' = T_PD with the gains above"
    return [
        against_paper(f"design.{name}", words, unit, found[name], paper, within, note)
        for name, (words, unit, paper, within) in POLES.items()
    ]
