"""Errors for users: one clear message naming the field, the rule, the value and the fix."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class InputError(ValueError):
    """Input that breaks a rule; renders as `field: rule; got value; fix`.

    Attributes: field, rule, value, fix.
    """

    def __init__(self, field: str, rule: str, value: Any, fix: str) -> None:
        self.field, self.rule, self.value, self.fix = field, rule, value, fix
        super().__init__(f"{field}: {rule}; got {value}; {fix}")

    @classmethod
    def unknown(cls, field: str, name: str, known: Iterable[str]) -> InputError:
        """An unknown name, with the nearest known ones, or all of them where none is near."""
        known = sorted(known)
        near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
        fix = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
        return cls(field, "must be a known name", repr(name), fix)
