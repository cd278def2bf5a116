"""The two-DoF arm of the 2014 paper (section 3.1)."""

from __future__ import annotations

from jaxsim.drive import Drive
from jaxsim.loads.two_link import TwoLink
from jaxsim.motors.dc import DC
from jaxsim.transmissions.elastic import Elastic


def two_link_arm_2014() -> Drive:
    """Two links with identical DC drives on harmonic gears; 2014 paper, section 3.1, no ripple."""
    motor = DC(L=3.2e-4, R=0.664, K_t=0.041, K_w=0.041, J_M=1.387e-5, D_M=1.996e-5)
    joint = Elastic(K=912.0, N=150.0)
    load = TwoLink(
        inertia_1=0.3047, inertia_2=0.0871, coupling=0.0954,
        gravity_1=6.6438, gravity_2=1.034, D_L1=0.01, D_L2=0.01,
    )  # fmt: skip
    return Drive((motor, motor), (joint, joint), load)
