"""Numbers from files: SI as they are, or text with a unit, such as "0.45 deg"."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.errors import InputError


def to_si(value: Any, unit: str, where: str) -> Any:
    """A number or list of numbers in the SI unit that a field declares.

    value: a number (taken to be in `unit`), text such as "26 arcmin" or "8.78 kg cm^2", or a list
    of these. unit: as declared by the field; "rad or Nm" accepts either, "1" no unit.

    Raises: InputError for anything that is not a number, for unknown units and for units of
    another quantity. Hz and rad/s are never converted into each other: a factor 2 pi is too
    easily meant or forgotten.
    """
    if isinstance(value, list | tuple):
        return [to_si(v, unit, where) for v in value]
    if isinstance(value, str):
        return _parse(value, unit, where)
    if isinstance(value, bool) or not isinstance(value, int | float | np.number | np.ndarray):
        raise InputError(where, f"must be a number in {unit}", repr(value), "give a number")
    return value


def _parse(text: str, unit: str, where: str) -> float:
    if _is_number(text):
        raise InputError(where, f"must be a number in {unit}", repr(text), "leave out the quotes")
    reasons = []
    for candidate in unit.split(" or "):
        try:
            return _convert(text, candidate)
        except Exception as error:  # pint raises a different class per way to be wrong
            reasons.append(str(error))
    raise InputError(where, f"must be convertible to {unit}", repr(text), "; ".join(reasons))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _convert(text: str, unit: str) -> float:
    units = _registry()
    quantity = units.Quantity(text)
    if ("Hz" in text) != (unit == "Hz"):
        raise ValueError("give Hz for frequencies and rad/s, deg/s or rpm for speeds")
    # 15 digits: 400 us is 4e-4 s, not 3.9999999999999996e-4.
    return float(f"{quantity.to('' if unit == '1' else unit).magnitude:.15g}")


@functools.cache
def _registry() -> Any:
    import jax
    import pint  # 0.2 s; only files that use units pay it

    # Where configure() has been allowed to keep things: reading the definitions takes 0.1 s more.
    kept = jax.config.values["jax_compilation_cache_dir"]
    units = pint.UnitRegistry(cache_folder=Path(kept) / "units" if kept else None)
    units.define("newton_meter = newton * meter = Nm")
    return units
