"""Any rigid mechanism, given by its mass matrix, Coriolis and gravity torques."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim.drive import Load, Scalar
from jaxsim.errors import InputError
from jaxsim.parameters import NON_NEGATIVE, parameter

Matrix = tuple[tuple[Scalar, ...], ...]


class Mechanism(Load):
    """M(q) q'' + C(q, w) + D_L q' + G(q) = T_s + d_L with q = theta_L, w = q'; 2014 paper (1).

    M(q, p), C(q, w, p), G(q, p): functions of tuples of n scalars, written with jax.numpy; M gives
    its rows (the lower triangle is read, the rest follows by symmetry), C and G give n torques in
    Nm. p: (m,) physical numbers of these functions, differentiable. D_L: (n,) Nm s/rad.

    M is factorised unrolled on scalars: a LAPACK call per step costs more than the whole step. A
    run that meets an angle where M is not positive definite stops there, Status.SINGULAR.

    Raises: InputError when M, C or G have the wrong size.
    """

    turns_singular: ClassVar[bool] = True

    M: Callable[..., Matrix] = eqx.field(static=True)
    C: Callable[..., tuple[Scalar, ...]] = eqx.field(static=True)
    G: Callable[..., tuple[Scalar, ...]] = eqx.field(static=True)
    D_L: Scalar = parameter("Nm s/rad", "viscosity per joint", rule=NON_NEGATIVE, ndim=1)
    p: Scalar = parameter("1", "physical numbers of M, C and G", default=(), ndim=1)

    @property
    def axes(self) -> int:  # type: ignore[override]
        return np.shape(self.D_L)[-1]

    def __check_init__(self) -> None:
        if np.ndim(self.D_L) != 1:
            raise InputError("Mechanism.D_L", "must be one number per joint", self.D_L, "a list")
        n, q = self.axes, (0.0,) * self.axes
        sizes = {
            "M": [len(row) for row in jax.eval_shape(lambda: self.M(q, self.p))],
            "C": len(jax.eval_shape(lambda: self.C(q, q, self.p))),
            "G": len(jax.eval_shape(lambda: self.G(q, self.p))),
        }
        for name, wanted in {"M": [n] * n, "C": n, "G": n}.items():
            if sizes[name] != wanted:
                raise InputError(
                    f"Mechanism.{name}", f"must give {wanted} numbers, as D_L has {n}",
                    sizes[name], "one row or torque per joint",
                )  # fmt: skip

    def definite(self, theta_L: tuple[Scalar, ...]) -> Scalar:
        _, pivots = _factors(self.M(theta_L, self.p))
        return jnp.all(jnp.stack([d > 0.0 for d in pivots]))

    def acceleration(
        self, theta_L: tuple[Scalar, ...], omega_L: tuple[Scalar, ...], torque: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        coriolis, weight = self.C(theta_L, omega_L, self.p), self.G(theta_L, self.p)
        rest = [
            torque[i] - coriolis[i] - weight[i] - self.D_L[i] * w for i, w in enumerate(omega_L)
        ]
        return _solve(*_factors(self.M(theta_L, self.p)), rest)


def _factors(M: Matrix) -> tuple[list[list[Scalar]], list[Scalar]]:
    """M = L diag(d) L^T, L unit lower triangular (Cholesky without roots); pivots NaN if <= 0."""
    lower: list[list[Scalar]] = []
    pivots: list[Scalar] = []
    for i, row in enumerate(M):
        scaled: list[Scalar] = []  # l_ij d_j
        for j in range(i):
            scaled.append(row[j] - sum((scaled[k] * lower[j][k] for k in range(j)), 0.0))
        own = [a / d for a, d in zip(scaled, pivots, strict=True)]
        pivot = jnp.asarray(row[i] - sum((a * b for a, b in zip(scaled, own, strict=True)), 0.0))
        lower.append(own)
        pivots.append(jnp.where(pivot > 0.0, pivot, jnp.nan))
    return lower, pivots


def _solve(lower: list[list[Scalar]], pivots: list[Scalar], rhs: list[Any]) -> tuple[Scalar, ...]:
    n = len(rhs)
    x: list[Scalar] = []
    for i in range(n):
        x.append(rhs[i] - sum((lower[i][j] * x[j] for j in range(i)), 0.0))
    x = [v / d for v, d in zip(x, pivots, strict=True)]
    for i in reversed(range(n)):
        x[i] = x[i] - sum((lower[j][i] * x[j] for j in range(i + 1, n)), 0.0)
    return tuple(x)
