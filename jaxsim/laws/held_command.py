"""A command that stays as it is until something sets it anew."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import parameter


class HeldCommand(Law):
    """u = level. Environments and policies set the level at every control period (zero-order hold).

    follows: unit of the reference that the one who sets it follows; the metrics need it.
    """

    level: Scalar = parameter("Nm or V", "the command", default=0.0)
    follows: str | None = eqx.field(static=True, default=None, kw_only=True)

    @property
    def reference_unit(self) -> str | None:
        return self.follows

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return self.level
