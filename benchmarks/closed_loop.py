"""The bench's closed loop as a right-hand side, for the integrators that people use today.

A yardstick, not a part of the product: 2018 paper, Table II and section III, switched law.
State: omega_L, omega_M, theta_L, theta_B, derivative filter, reference filter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

J_M, D_M, K, D_B, J_L, D_L, HALF_GAP = 8.78e-4, 9.30e-2, 3.00e2, 1.00e-1, 8.78e-4, 3.60e-2, 7.80e-3
K_P, K_D, TAU_D, K_B, CUTOFF = 10.28129662037006, 0.05470907749696041, 5.82812354062619e-3, -0.8, 20
STEP, AT, END = 0.30, 0.010, 0.3


def torque(theta_B: float, omega_B: float, half_gap: float) -> float:
    """Joint torque, Nm."""
    if theta_B >= half_gap:
        return D_B * omega_B + K * (theta_B - half_gap)
    if theta_B <= -half_gap:
        return D_B * omega_B + K * (theta_B + half_gap)
    return 0.0


def field(_: float, s: Any, half_gap: float = HALF_GAP) -> list[float]:
    """d(state)/dt after the step of the reference; plain Python, as one writes it for SciPy."""
    omega_L, omega_M, theta_L, theta_B, z, r = s
    omega_B = omega_M - omega_L
    T_s = torque(theta_B, omega_B, half_gap)
    error = r - theta_L
    slope = (error - z) / TAU_D
    damping = K_B * omega_B if omega_B * omega_L >= 0.0 else 0.0
    command = K_P * error + K_D * slope + damping
    return [
        (T_s - D_L * omega_L) / J_L,
        (command - D_M * omega_M - T_s) / J_M,
        omega_L,
        omega_B,
        slope,
        2.0 * math.pi * CUTOFF * (STEP - r),
    ]


def jax_field(_: Any, s: Any, half_gap: Any) -> Any:
    """The same in JAX, for diffrax."""
    import jax.numpy as jnp

    omega_L, omega_M, theta_L, theta_B, z, r = s
    omega_B = omega_M - omega_L
    rate = D_B * omega_B
    right = jnp.where(theta_B >= half_gap, rate + K * (theta_B - half_gap), 0.0)
    T_s = jnp.where(theta_B <= -half_gap, rate + K * (theta_B + half_gap), right)
    error = r - theta_L
    slope = (error - z) / TAU_D
    command = K_P * error + K_D * slope + jnp.where(omega_B * omega_L >= 0.0, K_B * omega_B, 0.0)
    return (
        (T_s - D_L * omega_L) / J_L,
        (command - D_M * omega_M - T_s) / J_M,
        omega_L,
        omega_B,
        slope,
        2.0 * math.pi * CUTOFF * (STEP - r),
    )


def peak(states: np.ndarray) -> float:
    """The largest joint torque of states (6, times), Nm."""
    return max(abs(torque(s[3], s[1] - s[0], HALF_GAP)) for s in states.T)
