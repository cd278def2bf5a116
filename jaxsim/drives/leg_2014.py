"""The one-DoF leg of the 2014 paper (section 4)."""

from __future__ import annotations

from jaxsim.drive import Drive
from jaxsim.loads.spring_load import SpringLoad
from jaxsim.motors.dc import DC
from jaxsim.transmissions.elastic import Elastic


def leg_2014() -> Drive:
    """The knee with 3.6 kg at 0.42 m, linearised hanging; 2014 paper, section 4.

    The printed Gammas exclude the drive of section 3; these L, J_M, D_M make them with its R, K_t
    and N (errata, part B).
    """
    return Drive(
        DC(L=4.9066e-4, R=0.664, K_t=0.041, K_w=0.041, J_M=2.21437e-5, D_M=3.12575e-4),
        Elastic(K=930.0, N=150.0),
        SpringLoad(J_L=3.6 * 0.42**2, K_L=14.83, D_L=1.5),
    )
