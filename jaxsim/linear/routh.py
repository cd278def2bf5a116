"""Routh-Hurwitz bounds on the PI torque gains under full positive feedback."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxsim.drive import Drive
from jaxsim.law import Decentral, JointSum, Sum
from jaxsim.laws.pi_torque import PITorque
from jaxsim.linear.joints import JointSystem
from jaxsim.motors.dc import DC

ONE = np.ones(1)


def K_p_max(system: JointSystem) -> np.ndarray:
    """The largest K_p for which some K_i > 0 is stable, a_1 a_2/a_3 - a_0, (p,) V/Nm; (21)."""
    a_0, a_1, a_2, a_3 = system.torque_coefficients()
    return a_1 * a_2 / a_3 - a_0


def K_i_max(system: JointSystem, K_p: float | np.ndarray) -> np.ndarray:
    """The bound on K_i at a K_p, (..., p) 1/s; (22).

    (a_1 a_2/a_3 - (a_0 + K_p)) (a_0 + K_p) a_3/(K_p a_2^2): the paper prints K_p^2 there, which
    is off by the factor K_p (the roots of Q_c decide). K_p (...,) or (..., p) V/Nm; at or below
    zero where no K_i is stable.
    """
    a_0, a_1, a_2, a_3 = system.torque_coefficients()
    given = np.asarray(K_p, dtype=float)
    given = given[..., None] if given.ndim and given.shape[-1] != system.axes else given
    total = a_0 + given
    return (a_1 * a_2 / a_3 - total) * total * a_3 / (given * a_2**2)


def stability_region(system: JointSystem, points: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """The edge of the stability region of Fig. 2: K_p and K_i_max(K_p), both (points, p)."""
    K_p = K_p_max(system) * np.linspace(0.0, 1.0, points + 2)[1:-1, None]
    return K_p, K_i_max(system, K_p)


def remarks(drive: Drive, law: Any) -> list[str]:
    """What is to be said of the PI gains of a law on this drive: axes outside (21)-(22), in words.

    The bounds hold for full positive feedback and no other filter in the loop. Only axes with a
    `DC` motor and a `PITorque` are looked at; laws with a lead compensator have other bounds.
    """
    found = []
    for axis, own in enumerate(_per_axis(law)):
        motor, joint = drive.motor[axis], drive.transmission[axis]
        if isinstance(own, PITorque) and isinstance(motor, DC):
            found += _outside(_one_joint(motor, joint), float(own.K_p), float(own.K_i), axis)
    return found


def _outside(system: JointSystem, K_p: float, K_i: float, axis: int) -> list[str]:
    """(21) and (22) for one joint."""
    where, region = f"axis {axis}", "outside the Routh-Hurwitz region under full positive feedback"
    most = float(K_p_max(system)[0])
    if not 0.0 < K_p < most:
        return [f"{where}: K_p = {K_p:g} V/Nm is {region}: 0 < K_p < {most:.6g}; (21)"]
    most = float(K_i_max(system, K_p)[0])
    if not 0.0 < K_i < most:
        return [f"{where}: K_i = {K_i:g} 1/s is {region}: 0 < K_i < {most:.6g} there; (22)"]
    return []


def _one_joint(motor: DC, joint: Any) -> JointSystem:
    """The drive of one joint. The coefficients of (11) do not depend on the load: a unit one."""
    drive = [motor.L, motor.R, motor.K_t, motor.K_w, motor.J_M, motor.D_M, joint.ratio, joint.K]
    return JointSystem(*(np.asarray(v) for v in drive), M_L=ONE, B_L=ONE, K_L=ONE)


def _per_axis(law: Any) -> list[Any]:
    """The PI law of each axis, None where there is none by itself."""
    parts = law.laws if isinstance(law, JointSum) else (law,)
    for part in parts:
        if isinstance(part, Decentral):
            return [_pi(own) for own in part.laws]
    return []


def _pi(law: Any) -> Any:
    terms = law.laws if isinstance(law, Sum) else (law,)
    return next((term for term in terms if isinstance(term, PITorque)), None)
