"""One step of the integrators against the matrix exponential; what counts as affine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from jaxsim import integrate

# x' = A x + b t + c, a damped oscillator pushed harder and harder.
A = np.array([[0.0, 1.0], [-4.0, -0.3]])
B, C = np.array([0.0, 0.7]), np.array([0.1, -0.2])
START, BEGIN = (0.4, -1.1), 0.3


def field(t: Any, x: Any) -> Any:
    p, v = x
    return v + 0.1, -4.0 * p - 0.3 * v + 0.7 * t - 0.2


def exact(h: float) -> np.ndarray:
    """Time is a state of rate 1: one exponential of a 4 x 4 matrix."""
    whole = np.zeros((4, 4))
    whole[:2, :2], whole[:2, 2], whole[:2, 3], whole[2, 3] = A, B, C, 1.0
    return (expm(whole * h) @ [*START, BEGIN, 1.0])[:2]


@pytest.mark.parametrize(
    ("step", "order"),
    [
        (lambda h: integrate.taylor(6, field, jnp.asarray(BEGIN), START, h), 6),
        (lambda h: integrate.taylor(3, field, jnp.asarray(BEGIN), START, h), 3),
        (lambda h: integrate.step(integrate.DORMAND_PRINCE, field, BEGIN, START, h), 5),
        (lambda h: integrate.step(integrate.CLASSICAL, field, BEGIN, START, h), 4),
    ],
    ids=["Taylor 6", "Taylor 3", "Dormand-Prince", "classical"],
)
def test_a_step_has_its_order(step: Callable[[float], Any], order: int) -> None:
    """Halving h divides the error of one step by 2^(order + 1)."""
    errors = [np.max(np.abs(np.array(step(h)[0]) - exact(h))) for h in (0.4, 0.2)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.25)


def test_a_step_hands_on_the_rates_at_its_beginning() -> None:
    rates = integrate.taylor(6, field, jnp.asarray(BEGIN), START, 0.1)[1]
    assert np.array(rates) == pytest.approx(A @ START + B * BEGIN + C)


@pytest.mark.parametrize(
    ("name", "other", "answer"),
    [
        ("a ramp", lambda t, p, v: (v, 2.0 * t - p), True),
        ("a sine in time", lambda t, p, v: (v, jnp.sin(t) - p), False),
        ("a square", lambda t, p, v: (v, -p * v), False),
        ("a function of its own", lambda t, p, v: jax.jit(lambda: (v, -3.0 * p))(), True),
        ("a mode", lambda t, p, v: (v, jnp.where(jnp.asarray(True), -p, 0.0)), True),
        ("a sign that is read", lambda t, p, v: (v, jnp.where(v > 0.0, -p, 0.0)), True),
    ],
)
def test_what_is_affine(name: str, other: Any, answer: bool) -> None:
    x = (jnp.asarray(1.0), jnp.asarray(2.0))
    assert integrate.affine(lambda t, x: other(t, *x), jnp.asarray(0.0), x) is answer, name
