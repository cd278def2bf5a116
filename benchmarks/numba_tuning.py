"""The goals of the `bench_switched` study as people write them by hand: RK4 in compiled loops.

A yardstick for tuning, not a part of the product: no event location and no gradients, laws and
drives over all cores.
"""

from __future__ import annotations

import numba
import numpy as np
from numba_loop import advance

STEP, AT, DURATION = 0.30, 0.010, 0.3
CUTOFF = 20.0


@numba.njit(fastmath=True)
def measure(gains, plant, dt, out):
    """ITAE in rad s^2, largest |T_s| in Nm and overshoot in % of one run."""
    s, trial, k = np.zeros(6), np.empty(6), np.empty((4, 6))
    K, D_B, half_gap = plant[2], plant[3], plant[6]
    itae, torque, top, before = 0.0, 0.0, 0.0, 0.0
    for n in range(round((DURATION - AT) / dt)):
        advance(s, trial, k, STEP, plant, gains, dt)
        after = (n + 1) * dt * abs(STEP - s[2])
        itae += 0.5 * dt * (before + after)
        before = after
        beyond = abs(s[3]) - half_gap
        if beyond >= 0.0:
            rate = D_B * (s[1] - s[0]) * (1.0 if s[3] > 0.0 else -1.0)
            torque = max(torque, abs(K * beyond + rate))
        top = max(top, s[2])
    out[0], out[1], out[2] = itae, torque, 100.0 * max(top - STEP, 0.0) / STEP


@numba.njit(parallel=True, fastmath=True)
def measure_all(laws, plants, dt):
    """(laws, drives, 3) for laws (n, 4): K_B, K_P, K_D, tau_D, and plants (d, 7)."""
    out = np.empty((laws.shape[0], plants.shape[0], 3))
    for i in numba.prange(laws.shape[0] * plants.shape[0]):
        a, b = i // plants.shape[0], i % plants.shape[0]
        gains = (laws[a, 1], laws[a, 2], laws[a, 3], laws[a, 0], CUTOFF)
        p = plants[b]
        plant = (p[0], p[1], p[2], p[3], p[4], p[5], p[6])
        measure(gains, plant, dt, out[a, b])
    return out
