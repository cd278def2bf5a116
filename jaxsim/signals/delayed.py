"""A signal that arrives late."""

from __future__ import annotations

from jaxsim.parameters import NON_NEGATIVE, parameter
from jaxsim.signal import Scalar, Signal


class Delayed(Signal):
    """signal(t - delay): what a bus or a firmware hands on late. Its breakpoints move with it.

    So the delay is a parameter like any other, with the right derivative through every jump.
    """

    signal: Signal
    delay: Scalar = parameter("s", "age of what arrives", rule=NON_NEGATIVE)

    def value(self, t: Scalar, inside: Scalar) -> Scalar:
        return self.signal.value(t - self.delay, inside - self.delay)

    def next_break(self, t: Scalar) -> Scalar:
        return self.signal.next_break(t - self.delay) + self.delay

    @property
    def breaks(self) -> int:
        return self.signal.breaks

    def onset(self) -> Scalar:
        return self.signal.onset() + self.delay
