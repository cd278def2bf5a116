"""Flexible joints on a load linearised at rest: matrices, intrinsic feedback, plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxsim.errors import InputError
from jaxsim.linear.polynomial import MatrixPolynomial
from jaxsim.linear.state_space import StateSpace, per_axis

_DRIVE = ("L", "R", "K_t", "K_w", "J_m", "B_m", "N", "K_H")
_LOAD = ("M_L", "B_L", "K_L")


class Gammas(NamedTuple):
    """The drive's intrinsic feedback from load motion, (10): each (p,), in V s^3, V s^2, V s."""

    j: np.ndarray
    a: np.ndarray
    v: np.ndarray


@dataclass(frozen=True, eq=False)
class JointSystem:
    """M_L theta_L'' + B_L theta_L' + K_L theta_L = T_s + d_L and its p drives; (2)-(5).

    Per joint, a number or (p,): L H, R ohm, K_t Nm/A, K_w V s/rad, J_m kg m^2, B_m Nm s/rad,
    N (motor angle over load angle), K_H Nm/rad (load side). For the load, (p, p), or (p,) for a
    diagonal: M_L kg m^2, B_L Nm s/rad, K_L Nm/rad. The torque disturbance tau_d acts at the motor
    shaft, without the N^-1 that (2) prints.

    Raises: InputError for a value that is not positive where physics wants it, or a wrong shape.
    """

    L: np.ndarray
    R: np.ndarray
    K_t: np.ndarray
    K_w: np.ndarray
    J_m: np.ndarray
    B_m: np.ndarray
    N: np.ndarray
    K_H: np.ndarray
    M_L: np.ndarray
    B_L: np.ndarray
    K_L: np.ndarray

    def __post_init__(self) -> None:
        M_L = np.asarray(self.M_L, dtype=np.float64)
        p = 1 if M_L.ndim == 0 else M_L.shape[0]
        for name in _DRIVE:
            object.__setattr__(self, name, per_joint(name, getattr(self, name), p))
        for name in _LOAD:
            object.__setattr__(self, name, _matrix(name, getattr(self, name), p))
        for name in ("L", "R", "K_t", "J_m", "N", "K_H"):
            if np.any(getattr(self, name) <= 0.0):
                raise InputError(name, "must be > 0", getattr(self, name).tolist(), "give SI units")
        if np.linalg.eigvalsh(0.5 * (self.M_L + self.M_L.T)).min() <= 0.0:
            raise InputError(
                "M_L", "must be positive definite", self.M_L.tolist(), "check the load's inertias"
            )

    @property
    def axes(self) -> int:
        return len(self.M_L)

    def gammas(self) -> Gammas:
        """Gamma_j, Gamma_a, Gamma_v: what full positive feedback cancels; (10)."""
        per_current = self.N / self.K_t
        return Gammas(
            self.L * self.J_m * per_current,
            (self.L * self.B_m + self.R * self.J_m) * per_current,
            self.R * self.B_m * per_current + self.K_w * self.N,
        )

    def torque_coefficients(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A_0, A_1, A_2, A_3 of Q(s), each (p,); (11)."""
        own, to_torque = self.gammas(), 1.0 / (self.K_t * self.N)
        return (
            self.R * to_torque,
            own.v / self.K_H + self.L * to_torque,
            own.a / self.K_H,
            own.j / self.K_H,
        )

    def Q(self) -> MatrixPolynomial:
        """Q(s) = A_3 s^3 + A_2 s^2 + A_1 s + A_0, from joint torque to voltage; (7)."""
        return MatrixPolynomial.diagonal(*self.torque_coefficients(), axes=self.axes)

    def Y(self) -> MatrixPolynomial:
        """Y(s) for F(s) = 0: Gamma_j s^3 + Gamma_a s^2 + Gamma_v s; (8)."""
        own = self.gammas()
        return MatrixPolynomial.diagonal(0.0, own.v, own.a, own.j, axes=self.axes)

    def load(self) -> MatrixPolynomial:
        """Lambda_L(s) = M_L s^2 + B_L s + K_L."""
        return MatrixPolynomial(np.array([self.K_L, self.B_L, self.M_L]))


def per_joint(name: str, value: object, p: int) -> np.ndarray:
    """One number per joint, (p,), from one or p numbers.

    Raises: InputError for another size or a number that is not finite.
    """
    given = np.asarray(value, dtype=np.float64)
    if given.ndim > 1 or (given.ndim == 1 and given.shape != (p,)) or not np.isfinite(given).all():
        raise InputError(name, f"must be one finite number per joint ({p})", value, "give a list")
    return np.broadcast_to(given, (p,)).copy()


def _matrix(name: str, value: object, p: int) -> np.ndarray:
    given = np.asarray(value, dtype=np.float64)
    given = np.diag(np.broadcast_to(given, (p,))) if given.ndim < 2 else given
    if given.shape != (p, p) or not np.isfinite(given).all():
        raise InputError(name, f"must be a finite ({p}, {p}) matrix", value, "give all entries")
    return given


def transmission_zeros(system: JointSystem) -> np.ndarray:
    """Zeros from motor voltage to joint torque: det(M_L s^2 + B_L s + K_L) = 0; Lemma 1.

    Returns (2 p,) complex, 1/s, rightmost first. The drives do not matter.
    """
    return system.load().roots()


def plant(system: JointSystem) -> StateSpace:
    """The open joint system (2)-(5) with named signals.

    States, p of each: theta_L, omega_L, theta_B (deflection theta_M/N - theta_L), omega_M,
    current. Inputs: command (V), tau_d (Nm, at the motor shaft), d_L (Nm). Outputs: T_s, theta_L,
    omega_L, theta_B, omega_B, theta_M, omega_M, current.
    """
    p, zero, one = system.axes, np.zeros((system.axes,) * 2), np.eye(system.axes)
    K_H, N = np.diag(system.K_H), np.diag(system.N)
    to_load, to_motor = np.linalg.inv(system.M_L), np.diag(1.0 / system.J_m)
    to_current = np.diag(1.0 / system.L)
    A = np.block([
        [zero, one, zero, zero, zero],
        [-to_load @ system.K_L, -to_load @ system.B_L, to_load @ K_H, zero, zero],
        [zero, -one, zero, np.linalg.inv(N), zero],
        [zero, zero, -to_motor @ K_H / N.diagonal(), -to_motor * system.B_m, to_motor * system.K_t],
        [zero, zero, zero, -to_current * system.K_w, -to_current * system.R],
    ])  # fmt: skip
    B = np.block([
        [zero, zero, zero], [zero, zero, to_load], [zero, zero, zero],
        [zero, to_motor, zero], [to_current, zero, zero],
    ])  # fmt: skip
    C = np.block([
        [zero, zero, K_H, zero, zero], [one, zero, zero, zero, zero],
        [zero, one, zero, zero, zero], [zero, zero, one, zero, zero],
        [zero, -one, zero, np.linalg.inv(N), zero], [N, zero, N, zero, zero],
        [zero, zero, zero, one, zero], [zero, zero, zero, zero, one],
    ])  # fmt: skip
    outputs = ("T_s", "theta_L", "omega_L", "theta_B", "omega_B", "theta_M", "omega_M", "current")
    states = ("theta_L", "omega_L", "theta_B", "omega_M", "current")
    return StateSpace(
        A, B, C, np.zeros((8 * p, 3 * p)),
        _names(states, p), _names(("command", "tau_d", "d_L"), p), _names(outputs, p),
    )  # fmt: skip


def _names(signals: tuple[str, ...], p: int) -> tuple[str, ...]:
    return tuple(name for signal in signals for name in per_axis(signal, p))
