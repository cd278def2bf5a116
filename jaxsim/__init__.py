"""Simulator of geared drives with backlash and flexible joints, differentiable, in JAX.

Importing it is quick and changes nothing: names are loaded at their first use (PEP 562), and
`jaxsim.configure()` is what switches float64 and the compilation cache on.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names as in _EXPORTS, for type checkers; a test compares them
    from jaxsim._certify import certify as certify
    from jaxsim._configure import configure as configure
    from jaxsim._simulate import RunError as RunError
    from jaxsim._simulate import simulate as simulate
    from jaxsim.batch import spread as spread
    from jaxsim.batch import stack as stack
    from jaxsim.errors import InputError as InputError
    from jaxsim.hybrid import Exact as Exact
    from jaxsim.hybrid import Plain as Plain
    from jaxsim.hybrid import Smoothed as Smoothed
    from jaxsim.run import Run as Run
    from jaxsim.sampled import Encoders as Encoders
    from jaxsim.sampled import Sampled as Sampled
    from jaxsim.sampled import TrueSpeeds as TrueSpeeds
    from jaxsim.scenario import Scenario as Scenario
    from jaxsim.scenario import Start as Start
    from jaxsim.study import load as load

# Public name -> module that defines it. A name must not be that of a module in this folder:
# importing that module would put the module in place of the name.
_EXPORTS = {
    "Encoders": "jaxsim.sampled",
    "Exact": "jaxsim.hybrid",
    "InputError": "jaxsim.errors",
    "Plain": "jaxsim.hybrid",
    "Run": "jaxsim.run",
    "RunError": "jaxsim._simulate",
    "Sampled": "jaxsim.sampled",
    "Scenario": "jaxsim.scenario",
    "Smoothed": "jaxsim.hybrid",
    "Start": "jaxsim.scenario",
    "TrueSpeeds": "jaxsim.sampled",
    "certify": "jaxsim._certify",
    "configure": "jaxsim._configure",
    "load": "jaxsim.study",
    "simulate": "jaxsim._simulate",
    "spread": "jaxsim.batch",
    "stack": "jaxsim.batch",
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
