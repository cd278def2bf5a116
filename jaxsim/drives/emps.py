"""The EMPS prismatic axis of the identification benchmark."""

from __future__ import annotations

from jaxsim.drive import Drive
from jaxsim.loads.inertia import Inertia
from jaxsim.motors.geared import Geared
from jaxsim.transmissions.elastic import Elastic


def emps() -> Drive:
    """Motor, ball screw and carriage, 95.11 kg: read m, N, kg for rad, Nm, kg m^2.

    M x'' = F - Fv x' - Fc sign(x') - offset, which is rigid; here 2 % of M hang on a spring whose
    resonance (1.1 kHz) is beyond what the 1 kHz log shows, with the encoder at the motor.

    Source: Janot, Gautier, Brunot (2019), "Data set and reference models of EMPS", Nonlinear
    System Identification Benchmarks.
    """
    mass, beyond = 95.11, 0.02
    return Drive(
        Geared(J_M=(1.0 - beyond) * mass, D_M=203.5, Fc=20.39, Fs=20.39, bias=3.16),
        Elastic(K=1e8, D_B=1e4),
        Inertia(J_L=beyond * mass),
    )
