"""Stability intervals of one gain, exactly, and root loci."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg, optimize

from jaxsim.errors import InputError
from jaxsim.linear.joints import JointSystem
from jaxsim.linear.torque_loop import TorqueLaw, characteristic, torque_dynamics

Interval = tuple[float, float]
Roots = Callable[[float], np.ndarray]  # a parameter's value -> the poles, 1/s


def abscissa(A: np.ndarray) -> float:
    """The largest real part of the eigenvalues, 1/s: stable where negative."""
    return float(np.real(np.linalg.eigvals(A)).max())


def crossing_gains(A_0: np.ndarray, A_1: np.ndarray) -> np.ndarray:
    """All k > 0 at which A_0 + k A_1 has eigenvalues on the imaginary axis, ascending.

    A pair s, -s makes the bialternate sum (the map A X + X A^T on antisymmetric X) singular, an
    eigenvalue at zero makes A singular: both are generalised eigenvalue problems in k, so no
    crossing can be missed between grid points. Pairs of real s, -s are found too: the caller
    looks at which side is stable.
    """
    _, (scale, _) = linalg.matrix_balance(np.abs(A_0) + np.abs(A_1), permute=False, separate=True)
    rate = np.abs(np.linalg.eigvals(A_0)).max()
    pair = [A * scale / scale[:, None] / rate for A in (A_0, A_1)]
    found = np.concatenate([
        _real(-np.asarray(linalg.eigvals(a_0, a_1)))
 for a_0, a_1 in (pair, [_bialternate(A) for A in pair])
    ])  # fmt: skip
    size = np.linalg.norm(pair[0]) / max(np.linalg.norm(pair[1]), np.finfo(float).tiny)
    return np.sort(found[(found > size * _ROUNDING) & (found < size / _ROUNDING)])


def _bialternate(A: np.ndarray) -> np.ndarray:
    """A X + X A^T on antisymmetric X: its eigenvalues are the sums of two eigenvalues of A."""
    n = len(A)
    row, column = np.triu_indices(n, 1)
    basis = np.zeros((n, n, len(row)))
    basis[row, column, range(len(row))], basis[column, row, range(len(row))] = 1.0, -1.0
    image = np.einsum("ij,jkm->ikm", A, basis)
    image -= np.swapaxes(image, 0, 1)
    return image[row, column]


def _real(values: np.ndarray) -> np.ndarray:
    finite = values[np.isfinite(values)]
    return np.real(finite)[np.abs(np.imag(finite)) <= _REAL * np.abs(finite)]


_REAL = 1e-6  # imaginary part of a computed real eigenvalue, relative; the caller checks each
_ROUNDING = 1e-10  # of |A_0|/|A_1|: gains below it are k = 0, above its inverse k = inf


def stable_intervals(A_0: np.ndarray, A_1: np.ndarray) -> list[Interval]:
    """All open intervals of k > 0 on which A_0 + k A_1 is stable, ascending; inf has no edge."""
    edges = [0.0, *crossing_gains(A_0, A_1).tolist(), math.inf]
    pieces = [
        (low, high)
        for low, high in itertools.pairwise(edges)
        if high > low and abscissa(A_0 + _between(low, high) * A_1) < 0.0
    ]
    return _joined(pieces)


def _between(low: float, high: float) -> float:
    if math.isinf(high):
        return 2.0 * low or 1.0
    return 0.5 * (low + high)


def _joined(pieces: list[Interval]) -> list[Interval]:
    """Neighbouring pieces become one: the crossing between them changed nothing."""
    joined: list[Interval] = []
    for low, high in pieces:
        if joined and joined[-1][1] == low:
            low = joined.pop()[0]
        joined.append((low, high))
    return joined


def stable_gains(system: JointSystem, law: TorqueLaw) -> list[Interval]:
    """All intervals of k_o for which the law with K_p times k_o is stable; section 3.4.2, (34).

    Judged on what the torque sees: load positions in the kernel of K_L are left out.
    """
    A_0 = torque_dynamics(system, law.scaled(0.0))
    return stable_intervals(A_0, torque_dynamics(system, law) - A_0)


def stable_gains_bisected(
    system: JointSystem, law: TorqueLaw, gains: Sequence[float] | np.ndarray
) -> list[Interval]:
    """The same by another way: roots of Lemma 6, and Brent's method between the given gains.

    Changes that begin and end between two gains are missed; use it to check, or for a law that
    `stable_gains` cannot take.
    """
    return bisected_intervals(
        lambda k: characteristic(system, law.scaled(k)).without_zero_roots().roots(), gains
    )


def bisected_intervals(roots: Roots, values: Sequence[float] | np.ndarray) -> list[Interval]:
    """The intervals of one parameter on which all roots lie in the left half plane.

    values: ascending, > 0; the ends of an interval that reaches the first or last are those.
    """
    grid = np.asarray(values, dtype=float)
    if grid.ndim != 1 or len(grid) < 2 or grid[0] <= 0.0 or np.any(np.diff(grid) <= 0.0):
        raise InputError("values", "must ascend from a number > 0", values, "give a grid")

    def height(log_value: float) -> float:
        return float(np.real(roots(math.exp(log_value))).max())

    heights = [height(v) for v in np.log(grid)]
    edges = [float(grid[0])] if heights[0] < 0.0 else []
    for i in range(len(grid) - 1):
        if (heights[i] < 0.0) != (heights[i + 1] < 0.0):
            ends = np.log(grid[i : i + 2])
            edges.append(math.exp(sign_change(height, *ends)))
    if heights[-1] < 0.0:
        edges.append(float(grid[-1]))
    return list(zip(edges[::2], edges[1::2], strict=True))


def sign_change(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function changes sign between two ends at which its signs differ; Brent's method."""
    return float(optimize.brentq(function, low, high, xtol=1e-14))  # type: ignore[arg-type]


def root_locus(roots: Roots, values: Sequence[float] | np.ndarray) -> np.ndarray:
    """The poles for each value of a parameter, one continuous branch per column, 1/s.

    Each set is matched to the one before by least total distance; shape (values, poles).
    """
    branches = [roots(float(values[0]))]
    for value in values[1:]:
        found = roots(float(value))
        distance = np.abs(branches[-1][:, None] - found[None, :])
        branches.append(found[optimize.linear_sum_assignment(distance)[1]])
    return np.array(branches)
