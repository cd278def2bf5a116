"""The two-DoF arm of the 2014 paper with torque ripple and a payload."""

from __future__ import annotations

import math
from dataclasses import replace

from jaxsim.drive import Drive
from jaxsim.drives.two_link_arm_2014 import two_link_arm_2014
from jaxsim.loads.payload import TwoLinkPayload
from jaxsim.motors.dc import Ripple

_LENGTH = 0.905  # m


def two_link_arm_payload() -> Drive:
    """`two_link_arm_2014` with its ripple of section 3.3, 0.013 Nm, and a payload of 0 kg.

    The paper gives no link lengths: that of link 1 is coupling*9.81/gravity_2, link 2 is taken as
    long. The phases of the ripple are the errata's.
    """
    arm = two_link_arm_2014()
    motor = tuple(
        replace(m, ripple=Ripple(0.013, 2.0, phase))  # type: ignore[type-var]
        for m, phase in zip(arm.motor, (math.pi, 0.5 * math.pi), strict=True)
    )
    load = TwoLinkPayload(arm.load, 0.0, _LENGTH, _LENGTH)  # type: ignore[arg-type]
    return Drive(motor, arm.transmission, load)
