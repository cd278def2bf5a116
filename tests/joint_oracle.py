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


@dataclass
class Leg:
    """The one-DoF leg under PI torque control with Stribeck friction and a voltage limit.

    Event by event: `slip` is +1, -1 or 0 (stuck), `cut` is +1, -1 or 0 (within the supply).
    """

    limit: float = 4.0
    step: float = 3.0
    Fc: float = 0.010
    Fs: float = 0.015
    ws: float = 2.0

    def parts(self, x: np.ndarray) -> tuple[float, float, float, float]:
        """Joint torque, torque on the rotor but friction, wanted voltage, slip friction."""
        q, _, motor, speed, current, integral = x
        torque = 930.0 * (motor / N - q)
        rotor = KT * current - 3.12575e-4 * speed - torque / N
        wanted = 2.0 * (self.step - torque + 10.0 * integral)
        return (
            torque,
            rotor,
            wanted,
            self.Fc + (self.Fs - self.Fc) * np.exp(-((speed / self.ws) ** 2)),
        )

    def rates(self, t: float, x: np.ndarray, slip: int, cut: int) -> list[float]:
        q, w, _, speed, current, _ = x
        torque, rotor, wanted, friction = self.parts(x)
        volts = cut * self.limit if cut else wanted
        return [
            w,
            (torque - 1.5 * w - 14.83 * q) / (3.6 * 0.42**2),
            speed if slip else 0.0,
            (rotor - slip * friction) / 2.21437e-5 if slip else 0.0,
            (volts - R * current - KW * speed) / 4.9066e-4,
            self.step - torque,
        ]

    def settle(self, x: np.ndarray, slip: int) -> int:
        """Whether a rotor at rest sticks, or slips on."""
        rotor = self.parts(x)[1]
        return 0 if abs(rotor) <= self.Fs else int(np.sign(rotor))

    def run(self, end: float) -> tuple[list[tuple[float, str]], np.ndarray]:
        """Times and kinds of the events ("stop", "go", "cut", "uncut") and the final state."""
        x, t, events = np.zeros(6), 0.0, []
        slip = self.settle(x, 0)
        cut = int(abs(self.parts(x)[2]) > self.limit) * int(np.sign(self.parts(x)[2]))
        while t < end:

            def stops(t: float, x: np.ndarray, slip: int, cut: int) -> float:
                return x[3] * slip if slip else self.Fs - abs(self.parts(x)[1])

            def cuts(t: float, x: np.ndarray, slip: int, cut: int) -> float:
                wanted = self.parts(x)[2]
                return cut * wanted - self.limit if cut else self.limit - abs(wanted)

            for event in (stops, cuts):
                event.terminal, event.direction = True, -1
            piece = solve_ivp(
                self.rates, (t, end), x, "DOP853", args=(slip, cut), events=(stops, cuts),
                rtol=1e-11, atol=1e-13, max_step=1e-3,
            )  # fmt: skip
            assert piece.success, piece.message
            t, x = float(piece.t[-1]), piece.y[:, -1]
            if piece.t_events[0].size:
                events.append((t, "stop" if slip else "go"))
                x[3] = 0.0
                slip = self.settle(x, slip) if slip else int(np.sign(self.parts(x)[1]))
            elif piece.t_events[1].size:
                events.append((t, "uncut" if cut else "cut"))
                cut = 0 if cut else int(np.sign(self.parts(x)[2]))
        return events, x
