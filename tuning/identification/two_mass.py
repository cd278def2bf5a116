"""Two inertias and a spring from torque to speed of the first, by the frequency response.

    omega_M/T = (J_L s^2 + (D_L + D_B) s + K) / (d3 s^3 + d2 s^2 + d1 s + d0)
    d3 = J_M J_L,  d2 = J_M (D_L + D_B) + J_L (D_M + D_B),
    d1 = K (J_M + J_L) + D_M D_L + D_B (D_M + D_L),  d0 = K (D_M + D_L)

The numerator is small at the anti-resonance sqrt(K/J_L), the denominator at the resonance
sqrt(K (1/J_M + 1/J_L)). Source: Levy (1959), Complex-curve fitting, with the weights of Sanathanan
and Koerner (1963).
"""

from __future__ import annotations

import numpy as np

_ROUNDS = 8  # of the weights
_WEAK = 1e-2  # lines with less torque than this share of the largest say nothing


def two_masses(torque: np.ndarray, speed: np.ndarray, period: float) -> dict[str, float]:
    """J_M, J_L, K, D_M, D_L, D_B of records (n,) of torque (Nm) and speed (rad/s); {} if none fit.

    From rest and to rest, or whole periods: what a record leaks is not corrected.
    """
    u, y = np.fft.rfft(torque)[1:], np.fft.rfft(speed)[1:]
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(torque), period)[1:]
    strong = np.abs(u) > _WEAK * np.abs(u).max()
    if strong.sum() < 8:
        return {}
    u, y, omega = u[strong], y[strong], omega[strong]
    unit = float(np.median(omega))
    s = 1j * omega / unit
    # n2 s^2 u + n1 s u + u = (d3 s^3 + d2 s^2 + d1 s + d0) y, divided by K.
    A = np.stack([s**3 * y, s**2 * y, s * y, y, -(s**2) * u, -s * u], axis=1)
    weight = 1.0 / np.abs(u)
    found = np.zeros(6)
    for _ in range(_ROUNDS):
        rows = np.concatenate([(A * weight[:, None]).real, (A * weight[:, None]).imag])
        right = np.concatenate([(u * weight).real, (u * weight).imag])
        size = np.linalg.norm(rows, axis=0)
        found = np.linalg.lstsq(rows / size, right, rcond=None)[0] / size
        d3, d2, d1, d0 = found[:4]
        weight = 1.0 / (np.abs(u) * np.maximum(np.abs(d3 * s**3 + d2 * s**2 + d1 * s + d0), 1e-12))
    return _physical(found / unit ** np.array([3, 2, 1, 0, 2, 1]))


def _physical(found: np.ndarray) -> dict[str, float]:
    """Inertias, stiffness and dampings of the coefficients over K; dampings by their three sums."""
    d3, d2, d1, d0, n2, n1 = found
    if n2 <= 0.0 or d3 <= 0.0:
        return {}
    J_M = d3 / n2
    J_L = d1 - J_M  # but for products of two dampings over K
    if J_L <= 0.0:
        return {}
    K = J_L / n2
    # D_M + D_L = d0; D_L + D_B = K n1; J_M (D_L + D_B) + J_L (D_M + D_B) = K d2.
    sums = d0, K * n1, (K * d2 - J_M * K * n1) / J_L
    D_M = 0.5 * (sums[0] - sums[1] + sums[2])
    parts = {"D_M": D_M, "D_L": sums[0] - D_M, "D_B": sums[2] - D_M}
    return {"J_M": J_M, "J_L": J_L, "K": K, **{n: max(v, 0.0) for n, v in parts.items()}}
