"""The two-inertia motor bench of the 2018 paper (Table II)."""

from __future__ import annotations

from jaxsim.drive import Drive
from jaxsim.loads.inertia import Inertia
from jaxsim.motors.ideal import Ideal
from jaxsim.transmissions.backlash import Backlash


def bench_2018() -> Drive:
    """Two equal inertias, a gear coupling with 7.80 mrad half gap; 2018 paper, Table II."""
    return Drive(
        Ideal(J_M=8.78e-4, D_M=9.30e-2),
        Backlash(K=3.00e2, D_B=1.00e-1, half_gap=7.80e-3),
        Inertia(J_L=8.78e-4, D_L=3.60e-2),
    )
