"""Matrix polynomials P(s) = P_0 + P_1 s + ... + P_n s^n and their block companion form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxsim.errors import InputError
from jaxsim.linear.state_space import by_real_part


@dataclass(frozen=True, eq=False)
class MatrixPolynomial:
    """coefficients[k] (p, p) multiplies s^k; sums and products as with numbers."""

    coefficients: np.ndarray

    @classmethod
    def diagonal(cls, *rows: float | Sequence[float] | np.ndarray, axes: int) -> MatrixPolynomial:
        """Diagonal coefficients, lowest power first, each a number or one number per axis."""
        return cls(np.array([np.diag(np.broadcast_to(r, (axes,)).astype(float)) for r in rows]))

    @property
    def degree(self) -> int:
        return len(self.coefficients) - 1

    def __add__(self, other: MatrixPolynomial) -> MatrixPolynomial:
        total = np.zeros((max(self.degree, other.degree) + 1, *self.coefficients.shape[1:]))
        total[: self.degree + 1] += self.coefficients
        total[: other.degree + 1] += other.coefficients
        return MatrixPolynomial(total)

    def __sub__(self, other: MatrixPolynomial) -> MatrixPolynomial:
        return self + MatrixPolynomial(-other.coefficients)

    def __matmul__(self, other: MatrixPolynomial) -> MatrixPolynomial:
        total = np.zeros((self.degree + other.degree + 1, *self.coefficients.shape[1:]))
        for i, left in enumerate(self.coefficients):
            total[i : i + other.degree + 1] += left @ other.coefficients
        return MatrixPolynomial(total)

    def __call__(self, s: complex) -> np.ndarray:
        """P(s), by Horner's rule."""
        value = np.zeros(self.coefficients.shape[1:], dtype=complex)
        for coefficient in self.coefficients[::-1]:
            value = value * s + coefficient
        return value

    def companion(self, rate: float = 1.0) -> np.ndarray:
        """Block companion matrix (n p, n p) of P(rate * z), Appendix 8; its eigenvalues are z.

        Raises: InputError when the highest coefficient is singular.
        """
        n, p = self.degree, self.coefficients.shape[1]
        scaled = self.coefficients * rate ** np.arange(n + 1.0)[:, None, None]
        if np.linalg.matrix_rank(scaled[-1]) < p:
            raise InputError("P_n", "must be invertible", "a singular matrix", "check the inertias")
        A = np.eye(n * p, k=p)
        A[-p:] = -np.linalg.solve(scaled[-1], np.hstack(list(scaled[:-1])))
        return A

    def without_zero_roots(self) -> MatrixPolynomial:
        """P(s)/s^k for the largest k at which all of P has that factor."""
        lowest = next(k for k, c in enumerate(self.coefficients) if np.any(c))
        return MatrixPolynomial(self.coefficients[lowest:])

    def roots(self) -> np.ndarray:
        """The n p roots of det P(s) = 0, 1/s, rightmost first.

        Time is scaled so that lowest and highest coefficient have one size, and factors s that
        all of P has are taken out exactly.
        """
        rest = self.without_zero_roots()
        n, p = rest.degree, rest.coefficients.shape[1]
        sizes = np.linalg.norm(rest.coefficients, axis=(1, 2))
        rate = (sizes[0] / sizes[-1]) ** (1.0 / n) if n else 1.0
        found = rate * np.linalg.eigvals(rest.companion(rate)) if n else np.zeros(0)
        return by_real_part(np.concatenate([found, np.zeros((self.degree - n) * p)]))
