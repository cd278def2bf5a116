"""Sine and cosine against NumPy's, which are those of the C library."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsim.sincos import sincos


@pytest.mark.parametrize(("dtype", "reach", "units"), [("float64", 1e5, 2), ("float32", 1e3, 2)])
def test_values(dtype: str, reach: float, units: int) -> None:
    rng = np.random.default_rng(1)
    near = np.arange(-40, 41) * np.pi / 4  # the edges between the quarters, and the zeros
    angles = np.concatenate([rng.uniform(-reach, reach, 20_000), rng.normal(0, 2, 20_000), near])
    angles = angles.astype(dtype)
    found = jax.jit(sincos)(jnp.asarray(angles))
    for value, true in zip(found, (np.sin, np.cos), strict=True):
        exact = true(angles.astype(np.longdouble))
        # Near a zero the rounding of the reduction counts, against 1 and not against the value.
        bound = units * np.spacing(np.maximum(np.abs(exact), 0.25).astype(dtype))
        assert value.dtype == dtype
        assert np.all(np.abs(np.asarray(value) - exact) <= bound)


def test_derivatives_of_both_orders() -> None:
    angle = 2.3
    slope = jax.jacfwd(sincos)(angle)
    bend = jax.jacfwd(jax.jacrev(sincos))(angle)
    assert slope == pytest.approx((np.cos(angle), -np.sin(angle)), rel=1e-15)
    assert bend == pytest.approx((-np.sin(angle), -np.cos(angle)), rel=1e-15)


def test_what_is_not_finite_gives_nan() -> None:
    assert np.all(np.isnan(np.array(sincos(jnp.array([np.nan, np.inf])))))
