"""A first-order low-pass on the reference of another law."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxsim.hybrid import Surface, Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import POSITIVE, parameter


class Prefilter(Law):
    """The law sees r instead of theta_Lref: r' = 2 pi cutoff (theta_Lref - r).

    Source: 2018 paper, section III.B (20 Hz). The derivative of a PD law then acts on the error
    to the FILTERED reference.
    """

    law: Law
    cutoff: Scalar = parameter("Hz", "cut-off of the low-pass", rule=POSITIVE, default=20.0)

    command_unit: str = eqx.field(static=True, init=False)

    def __post_init__(self) -> None:
        self.command_unit = self.law.command_unit

    @property
    def reference_unit(self) -> str | None:
        return self.law.reference_unit

    def _seen(self, state: Any, y: Measured) -> Measured:
        return y._replace(reference=state[0])

    def rest(self, y: Measured) -> Any:
        return y.reference, self.law.rest(y)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return self.law.surfaces

    def guards(self, state: Any, y: Measured) -> tuple[Scalar, ...]:
        return self.law.guards(state[1], self._seen(state, y))

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        rate = 2.0 * jnp.pi * self.cutoff * (y.reference - state[0])
        return rate, self.law.field(state[1], self._seen(state, y), switches)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return self.law.command(state[1], self._seen(state, y), switches)
