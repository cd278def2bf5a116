"""The command of an agent, held over one control period."""

from __future__ import annotations

from typing import Any

from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar
from jaxsim.parameters import parameter


class Held(Law):
    """u = level. The environment replaces the level at every control period: zero-order hold."""

    level: Scalar = parameter("Nm or V", "the command", default=0.0)

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return self.level
