"""Errors for users: one clear message naming the field, the rule, the value and the fix."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

_NEAR = 0.5  # so much alike may be meant


class InputError(ValueError):
    """Input that breaks a rule; renders as `field: rule; got value; fix`.

    Attributes: field, rule, value, fix.
    """

    def __init__(self, field: str, rule: str, value: Any, fix: str) -> None:
        self.field, self.rule, self.value, self.fix = field, rule, value, fix
        super().__init__(f"{field}: {rule}; got {value}; {fix}")

    @classmethod
    def unknown(cls, field: str, name: str, known: Iterable[str]) -> InputError:
        """An unknown name, with the nearest known ones; all of them, nearest first, if none is."""
        every = sorted(sorted(known), key=lambda other: -_alike(name, other))
        near = [other for other in every[:3] if _alike(name, other) >= _NEAR]
        fix = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(every)}"
        return cls(field, "must be a known name", repr(name), fix)

    def called(self, field: str) -> InputError:
        """The same mistake, under the name that the person gave it."""
        return InputError(field, self.rule, self.value, self.fix)


@contextmanager
def called(field: str) -> Iterator[None]:
    """Mistakes inside are told under the name that the person typed, such as an option's."""
    try:
        yield
    except InputError as error:
        raise error.called(field) from None


@contextmanager
def inside(place: str) -> Iterator[None]:
    """Mistakes inside are told with the file that they are in before the field."""
    try:
        yield
    except InputError as error:
        raise error.called(f"{place}: {error.field}") from None


def _alike(a: str, b: str) -> float:
    """How much of two names is the same, 0 to 1; capitals count less than letters."""
    return difflib.SequenceMatcher(None, a.lower(), b.lower()).ratio()
