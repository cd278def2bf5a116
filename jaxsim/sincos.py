"""Sine and cosine together, for the vector unit."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

Scalar = Any

# Minimax polynomials on [-pi/4, pi/4] and pi/2 in parts that a whole number times is exact:
# fdlibm's (Sun Microsystems 1993, k_sin.c, k_cos.c, e_rem_pio2.c) and, for float32, Cephes' parts.
_SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
_COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
_QUARTER = {
    "float64": (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    "float32": (1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
}
_TERMS = {"float64": 6, "float32": 4}


@jax.custom_jvp
def sincos(angle: Scalar) -> tuple[Scalar, Scalar]:
    """(sin(angle), cos(angle)) of angles in rad, to two units in the last place up to 1e5 rad.

    XLA calls the C library for each float64 sine, one after the other; this goes through the vector
    unit, and a derivative costs two multiplications.
    """
    angle = jnp.asarray(angle)
    name = angle.dtype.name
    quarters = jnp.round(angle * (2.0 / jnp.pi))
    rest = angle
    for part in _QUARTER[name]:
        rest = rest - quarters * part
    sine, cosine = _near_zero(rest, _TERMS[name])
    turn = quarters - 4.0 * jnp.floor(0.25 * quarters)  # 0, 1, 2 or 3 quarters
    odd = jnp.abs(jnp.abs(turn - 2.0) - 1.0) < 0.5
    first, second = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    return jnp.where(turn > 1.5, -first, first), jnp.where(
        jnp.abs(turn - 1.5) < 1.0, -second, second
    )


@sincos.defjvp
def _(primals: Any, tangents: Any) -> Any:
    sine, cosine = sincos(*primals)
    return (sine, cosine), (cosine * tangents[0], -sine * tangents[0])


def _near_zero(x: Scalar, terms: int) -> tuple[Scalar, Scalar]:
    """Sine and cosine of at most an eighth of a turn."""
    z = x * x
    sine, cosine = _polynomial(_SINE[:terms], z), _polynomial(_COSINE[:terms], z)
    half = 0.5 * z
    near = 1.0 - half
    # What 1 - z/2 has lost to rounding is put back.
    return x + x * (z * sine), near + (((1.0 - near) - half) + z * z * cosine)


def _polynomial(coefficients: tuple[float, ...], z: Scalar) -> Scalar:
    total = jnp.full_like(z, coefficients[-1])
    for c in reversed(coefficients[:-1]):
        total = c + z * total
    return total


__all__ = ["sincos"]
