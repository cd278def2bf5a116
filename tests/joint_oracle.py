"""An independent simulator of the two-DoF arm of the 2014 paper: NumPy, SciPy's DOP853.

Written from the paper's equations and its errata, in motor angles, with the Coriolis and mass
matrix rates written out; it shares no line and no state choice with jaxsim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

L, R, KT, KW, JM, BM, N, KH, BL = (
    3.2e-4,
    0.664,
    0.041,
    0.041,
    1.387e-5,
    1.996e-5,
    150.0,
    912.0,
    0.01,
)
GAMMA_J = L * JM * N / KT
GAMMA_A = (L * BM + R * JM) * N / KT
GAMMA_V = R * BM * N / KT + KW * N
H = 0.0954


def mass(q2: float) -> np.ndarray:
    c = np.cos(q2)
    return np.array([[0.3047 + 2 * H * c, 0.0871 + H * c], [0.0871 + H * c, 0.0871]])


def mass_rate(q2: float, w2: float) -> np.ndarray:
    return -H * np.sin(q2) * w2 * np.array([[2.0, 1.0], [1.0, 0.0]])


def coriolis(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    return H * np.sin(q[1]) * np.array([-(2 * w[0] * w[1] + w[1] ** 2), w[0] ** 2])


def coriolis_rate(q: np.ndarray, w: np.ndarray, a: np.ndarray) -> np.ndarray:
    shape = np.array([-(2 * w[0] * w[1] + w[1] ** 2), w[0] ** 2])
    rate = np.array([-2 * (a[0] * w[1] + w[0] * a[1] + w[1] * a[1]), 2 * w[0] * a[0]])
    return H * (np.cos(q[1]) * w[1] * shape + np.sin(q[1]) * rate)


def gravity(q: np.ndarray) -> np.ndarray:
    hang = 1.034 * np.sin(q[0] + q[1])
    return np.array([6.6438 * np.sin(q[0]) + hang, hang])


def gravity_rate(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    hang = 1.034 * np.cos(q[0] + q[1]) * (w[0] + w[1])
    return np.array([6.6438 * np.cos(q[0]) * w[0] + hang, hang])


@dataclass
class Arm:
    """PI torque control k_o (s + k_i)/s with alpha times full positive feedback, ripple, lead."""

    k_o: float = 2.0
    k_i: tuple[float, float] = (12.5, 25.0)
    alpha: float = 1.0
    ripple: float = 0.0
    phases: tuple[float, float] = (np.pi, np.pi / 2)
    lead: tuple[float, float] | None = None
    start: tuple[float, float] = (0.0, 0.5)
    step: tuple[float, float] = (3.0, 0.0)

    def rates(self, t: float, x: np.ndarray) -> np.ndarray:
        q, w, motor, speed, current, integral, filtered = x.reshape(7, 2)
        torque = KH * (motor / N - q)
        torque_rate = KH * (speed / N - w)
        M = mass(q[1])
        a = np.linalg.solve(M, torque - coriolis(q, w) - BL * w - gravity(q))
        jerk = np.linalg.solve(
            M,
            torque_rate
            - mass_rate(q[1], w[1]) @ a
            - coriolis_rate(q, w, a)
            - BL * a
            - gravity_rate(q, w),
        )
        error = np.asarray(self.step) - torque
        pi = self.k_o * (error + np.asarray(self.k_i) * integral)
        zero, pole = self.lead or (1.0, 1.0)
        control = pole / zero * (pi + (zero - pole) / pole * filtered) if self.lead else pi
        volts = control + self.alpha * (GAMMA_J * jerk + GAMMA_A * a + GAMMA_V * w)
        ripple = self.ripple * np.cos(2.0 * motor + np.asarray(self.phases))
        dspeed = (KT * current + ripple - BM * speed - torque / N) / JM
        dcurrent = (volts - R * current - KW * speed) / L
        return np.concatenate([w, a, speed, dspeed, dcurrent, error, pole * (pi - filtered)])

    def torques(self, times: np.ndarray) -> np.ndarray:
        """T_s (len(times), 2), Nm, from rest with no torque."""
        q = np.asarray(self.start)
        x = np.concatenate([q, [0, 0], N * q, np.zeros(8)])
        end = float(times[-1])
        run = solve_ivp(self.rates, (0.0, end), x, "DOP853", t_eval=times, rtol=1e-11, atol=1e-12)
        assert run.success, run.message
        return KH * (run.y[4:6] / N - run.y[0:2]).T


def linear_torque(k_o: float, k_i: float, size: float, times: np.ndarray) -> np.ndarray:
    """The step response of (20), Q_c T_s = K_p (s + K_i) tau_r, by matrix exponentials."""
    a = np.array([
        k_o * k_i, R / (KT * N) + k_o, GAMMA_V / KH + L / (KT * N), GAMMA_A / KH, GAMMA_J / KH
    ])  # fmt: skip
    scale = 1e3  # seconds to milliseconds: powers of s of like size
    a = a * scale ** np.arange(5) / (a[4] * scale**4)
    A = np.zeros((5, 5))
    A[:3, 1:4] = np.eye(3)
    A[3, :4], A[3, 4] = -a[:4], 1.0
    numerator = k_o * np.array([k_i, scale]) / (GAMMA_J / KH * scale**4)
    period = float(times[1] - times[0])
    step, x = expm(A * period * scale), np.array([0, 0, 0, 0, size])
    values = []
    for _ in times:
        values.append(numerator @ x[:2])
        x = step @ x
    return np.array(values)
