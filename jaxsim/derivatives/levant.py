"""Load derivatives from a robust exact (sliding-mode) differentiator."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp

from jaxsim.derivative import Derivatives, Motion
from jaxsim.law import Measured, Scalar
from jaxsim.parameters import POSITIVE, parameter

_GAINS = (3.0, 4.16, 3.06, 1.1)  # for bound = 1, non-recursive form of third order


class Levant(Derivatives):
    """z_i' = -k_i bound^((i+1)/4) |e|^((3-i)/4) sign(e) + z_{i+1}, e = z_0 - theta_L, i = 0..3.

    Exact for |theta_L''''| <= bound without noise and sampling; at a period T the errors are of
    the order bound*T^3 (velocity), bound*T^2 (acceleration), bound*T (jerk). It sees load angles
    only. Explicit steps with Taylor terms, which keep these orders (Livne and Levant, 2014);
    a continuous form would chatter under any fixed step. The estimates are those for the present
    sample, from the samples before it. Its derivatives with respect to parameters are those of a
    sliding mode: do not optimise through it.

    Source: Levant (2003), cited as [16], [17] in the 2014 paper, section 2.3.
    """

    bound: Scalar = parameter("rad/s^4", "largest fourth derivative of theta_L", rule=POSITIVE)

    @property
    def discrete(self) -> bool:
        return True

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        return tuple((y.theta_L, y.omega_L, 0.0 * y.T_s, 0.0 * y.T_s, y.theta_L) for y in ys)

    def field(self, state: Any, ys: tuple[Measured, ...]) -> Any:
        return tuple(tuple(jnp.zeros_like(v) for v in own) for own in state)

    def on_sample(self, state: Any, ys: tuple[Measured, ...], period: float) -> Any:
        return tuple(
            (*self._next(own[:4], own[4], period), y.theta_L)
            for own, y in zip(state, ys, strict=True)
        )

    def _next(self, z: Any, seen: Scalar, period: float) -> list[Scalar]:
        error = z[0] - seen
        size = jnp.where(error == 0.0, 1.0, jnp.abs(error))  # roots have no derivative at zero
        advanced = []
        for i, gain in enumerate(_GAINS):
            pull = self.bound ** ((i + 1) / 4) * size ** ((3 - i) / 4) * jnp.sign(error)
            taylor = sum(z[j] * period ** (j - i) / math.factorial(j - i) for j in range(i, 4))
            advanced.append(taylor - period * gain * pull)
        return advanced

    def motion(self, state: Any, ys: tuple[Measured, ...]) -> tuple[Motion, ...]:
        return tuple(Motion(*own[1:4]) for own in state)
