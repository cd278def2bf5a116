"""Simulator of geared drives with backlash and flexible joints, differentiable, in JAX.

Importing it is quick and changes nothing: names are loaded at their first use (PEP 562), and
`jaxsim.configure()` is what switches float64 and the compilation cache on.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names as in _EXPORTS, for type checkers; a test compares them
    from jaxsim._configure import configure as configure

# Public name -> module that defines it. A name must not be that of a module in this folder:
# importing that module would put the module in place of the name.
_EXPORTS = {
    "configure": "jaxsim._configure",
}

__all__ = list(_EXPORTS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_EXPORTS[name]), name)
    globals()[name] = value  # the next look-up does not come here
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_EXPORTS})
