"""Routh-Hurwitz bounds on the PI torque gains under full positive feedback."""

from __future__ import annotations

import numpy as np

from jaxsim.linear.joints import JointSystem


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
