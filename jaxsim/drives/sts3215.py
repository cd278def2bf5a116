"""A Feetech STS3215 hobby servo (12 V) with 0.535 kg on an arm of 0.10 m."""

from __future__ import annotations

from jaxsim.drive import Drive
from jaxsim.loads.pendulum import Pendulum
from jaxsim.motors.geared import Geared
from jaxsim.transmissions.backlash import Backlash


def sts3215() -> Drive:
    """Everything at the output shaft; half gap 7.95 mrad (95 %: 4.9 to 9.2, lowest at 5.8).

    Source: fitted by benchmarks/identify_servo.py to 120 recorded runs; with the law there,
    12.75 mrad mean absolute error over 480 runs with other loads. The interval is that of the
    profile, by a bootstrap over the runs.
    """
    return Drive(
        Geared(
            J_M=0.01894, D_M=0.03566, Fc=0.0, Fs=0.1248, ws=1.681, driving=0.1784, driven=0.3469
        ),
        Backlash(K=41.84, half_gap=7.955e-3, D_B=0.5009),
        Pendulum(mass=0.535, length=0.10, rod=0.036, theta_0=0.01734),
    )
