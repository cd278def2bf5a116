"""Open loop: the reference is the command."""

from __future__ import annotations

from typing import Any

from jaxsim.hybrid import Switch
from jaxsim.law import Law, Measured, Scalar


class Feedforward(Law):
    """u = reference, in the unit that the motor takes; for identification and for torque steps."""

    def command(self, state: Any, y: Measured, switches: tuple[Switch, ...]) -> Scalar:
        return y.reference
