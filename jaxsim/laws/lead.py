"""A lead compensator behind another law."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxsim.hybrid import Surface, Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import POSITIVE, parameter


class Lead(Law):
    """u = (pole/zero) (s + zero)/(s + pole) v with v the command of `law`; gain 1 at rest.

    State z' = pole (v - z): u = (pole v - (pole - zero) z)/zero.
    Source: 2014 paper, section 3.3.1 (zero 128, pole 628 rad/s); section 4 (128, 750).
    """

    law: Law
    zero: Scalar = parameter("rad/s", "corner where the gain starts to rise", rule=POSITIVE)
    pole: Scalar = parameter("rad/s", "corner where it stops rising", rule=POSITIVE)
    command_unit: str = eqx.field(static=True, init=False)

    def __post_init__(self) -> None:
        self.command_unit = self.law.command_unit

    @property
    def reference_unit(self) -> str | None:
        return self.law.reference_unit

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return self.law.surfaces

    def rest(self, y: Measured) -> Any:
        """Its filter empty, as the integral of a `PITorque` inside it."""
        return 0.0 * y.T_s, self.law.rest(y)

    def guards(self, state: Any, y: Measured) -> tuple[Scalar, ...]:
        return self.law.guards(state[1], y)

    def field(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Any:
        v = self.law.command(state[1], y, switches)
        return self.pole * (v - state[0]), self.law.field(state[1], y, switches)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        v = self.law.command(state[1], y, switches)
        return (self.pole * v - (self.pole - self.zero) * state[0]) / self.zero
