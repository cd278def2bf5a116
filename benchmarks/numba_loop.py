"""The bench's closed loop as people write it by hand: classical RK4 in a compiled loop.

A yardstick for throughput, not a part of the product: no event location, no metrics, no
gradients. State: omega_L, omega_M, theta_L, theta_B, derivative filter, reference filter.
"""

from __future__ import annotations

import math

import numba
import numpy as np

PLANT = (8.78e-4, 9.30e-2, 3.00e2, 1.00e-1, 8.78e-4, 3.60e-2, 7.80e-3)
GAINS = (10.28129662037006, 0.05470907749696041, 5.82812354062619e-3, -0.80, 20.0)


@numba.njit(fastmath=True)
def field(s, reference, plant, gains, out):
    J_M, D_M, K, D_B, J_L, D_L, half_gap = plant
    K_P, K_D, tau_D, K_B, cutoff = gains
    omega_L, omega_M, theta_L, theta_B, z, r = s
    omega_B = omega_M - omega_L
    torque = 0.0
    if theta_B >= half_gap:
        torque = D_B * omega_B + K * (theta_B - half_gap)
    elif theta_B <= -half_gap:
        torque = D_B * omega_B + K * (theta_B + half_gap)
    error = r - theta_L
    command = K_P * error + K_D * (error - z) / tau_D
    if omega_B * omega_L >= 0.0:
        command += K_B * omega_B
    out[0] = (torque - D_L * omega_L) / J_L
    out[1] = (command - D_M * omega_M - torque) / J_M
    out[2] = omega_L
    out[3] = omega_B
    out[4] = (error - z) / tau_D
    out[5] = 2.0 * math.pi * cutoff * (reference - r)


@numba.njit(fastmath=True)
def advance(s, trial, k, reference, plant, gains, dt):
    """One classical RK4 step of the state s, in place."""
    field(s, reference, plant, gains, k[0])
    for stage in range(1, 4):
        share = dt if stage == 3 else 0.5 * dt
        for j in range(6):
            trial[j] = s[j] + share * k[stage - 1, j]
        field(trial, reference, plant, gains, k[stage])
    for j in range(6):
        s[j] += dt / 6.0 * (k[0, j] + 2.0 * (k[1, j] + k[2, j]) + k[3, j])


@numba.njit(fastmath=True)
def run(half_gaps, steps, dt):
    """The largest load angle of each member, rad."""
    largest = np.zeros(half_gaps.shape[0])
    k = np.empty((4, 6))
    for i in range(half_gaps.shape[0]):
        plant = (8.78e-4, 9.30e-2, 3.00e2, 1.00e-1, 8.78e-4, 3.60e-2, half_gaps[i])
        s, trial = np.zeros(6), np.empty(6)
        for n in range(steps):
            reference = 0.30 if n * dt >= 0.010 - 1e-12 else 0.0
            advance(s, trial, k, reference, plant, GAINS, dt)
            largest[i] = max(largest[i], s[2])
    return largest


@numba.njit(fastmath=True)
def peak(half_gaps, dt):
    """The largest joint torque of each member after the step of the reference, Nm."""
    largest = np.zeros(half_gaps.shape[0])
    k = np.empty((4, 6))
    for i in range(half_gaps.shape[0]):
        plant = (8.78e-4, 9.30e-2, 3.00e2, 1.00e-1, 8.78e-4, 3.60e-2, half_gaps[i])
        s, trial = np.zeros(6), np.empty(6)
        for _ in range(round(0.29 / dt)):
            advance(s, trial, k, 0.30, plant, GAINS, dt)
            beyond = abs(s[3]) - half_gaps[i]
            if beyond >= 0.0:
                rate = 1.00e-1 * (s[1] - s[0]) * (1.0 if s[3] > 0.0 else -1.0)
                largest[i] = max(largest[i], abs(3.00e2 * beyond + rate))
    return largest
