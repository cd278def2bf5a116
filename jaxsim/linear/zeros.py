"""Zeros of a state space, by reduction to an ordinary eigenvalue problem."""

from __future__ import annotations

import numpy as np

from jaxsim.linear.state_space import StateSpace, by_real_part

_RANK = 1e-10  # of the largest singular value, rows normed to one: below it a direction is none


def zeros(system: StateSpace) -> np.ndarray:
    """All s at which [sI - A, -B; C, D] loses rank, 1/s, rightmost first; 2014 paper, (37).

    Modes that are uncontrollable or unobservable are among them. The reduction of Emami-Naeini
    and Van Dooren (1982) removes the zeros at infinity first: taking the pencil's finite
    generalised eigenvalues instead was rejected, as an infinite zero of order r comes out near
    eps^(-1/r) and cannot be told from a fast finite one.
    """
    s = system.balanced()
    rate = max(np.abs(s.A).max(), 1.0)  # time in units of the fastest rate: entries near one
    parts = _row_reduced(s.A / rate, s.B / rate, s.C, s.D)
    A, C, B, D = (part.T for part in parts)
    A, B, C, D = _row_reduced(A, B, C, D)
    if not A.size:
        return np.zeros(0, dtype=complex)
    return by_real_part(rate * np.linalg.eigvals(A - B @ np.linalg.solve(D, C)))


def _row_reduced(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A smaller system with the same finite zeros and a D of full row rank."""
    while C.shape[0]:
        norms = np.linalg.norm(np.hstack([C, D]), axis=1, keepdims=True)
        C, D = (part[norms[:, 0] > 0.0] / norms[norms[:, 0] > 0.0] for part in (C, D))
        left, rank = _compressed(D)
        C, D = left.T @ C, left.T @ D
        if rank == C.shape[0]:
            break
        right, width = _compressed(C[rank:].T)
        right = np.roll(right, -width, axis=1)  # the kernel of the lower rows of C first
        kept = A.shape[0] - width
        A, B, C = right.T @ A @ right, right.T @ B, C @ right
        C, D = np.vstack([C[:rank, :kept], A[kept:, :kept]]), np.vstack([D[:rank], B[kept:]])
        A, B = A[:kept, :kept], B[:kept]
    return A, B, C, D


def _compressed(M: np.ndarray) -> tuple[np.ndarray, int]:
    """An orthogonal U whose first columns span the columns of M, and the rank of M."""
    if not M.size:
        return np.eye(M.shape[0]), 0
    U, singular, _ = np.linalg.svd(M)
    return U, int((singular > _RANK * max(singular.max(), _RANK)).sum())
