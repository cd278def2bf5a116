"""All combinations of given values."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from jaxsim.errors import InputError
from jaxsim.study import Study
from jaxsim.validation import check
from tuning.drive_set import Drives, DriveSet, quantity_in, spread_of, table_of, with_own

_MOST = 100_000  # drives: a digit too many in one of the numbers would fill the memory


class _Even(BaseModel):
    model_config = ConfigDict(extra="forbid")
    spread: Any
    points: int = Field(ge=2)


class Grid(DriveSet):
    """`grid = { payload = ["0 kg", "0.1 kg"], K = { spread = "20 %", points = 3 } }`.

    A list has the values of a parameter; spread and points give evenly spaced ones. The study's
    drive and all combinations.
    """

    def read(self, study: Study, given: Any, count: int, seed: int, where: str) -> Drives:
        table = table_of(given, where, 'e.g. grid = { K = { spread = "20 %", points = 3 } }')
        named = {name: _values(study, name, v, f"{where}.{name}") for name, v in table.items()}
        size = int(np.prod([len(values) for values in named.values()]))
        if size > _MOST:
            raise InputError(where, f"must have at most {_MOST} drives", size, "give fewer values")
        spreads = tuple(
            quantity_in(study, name, where).spread(float(values.min()), float(values.max()))
            for name, values in named.items()
        )
        return with_own(study, spreads, np.array(list(product(*named.values()))))


def _values(study: Study, name: str, given: Any, where: str) -> np.ndarray:
    quantity = quantity_in(study, name, where)
    if isinstance(given, dict):
        even = check(_Even, given, where)
        ends = spread_of(study, name, even.spread, f"{where}.spread")
        values = np.linspace(ends.lower, ends.upper, even.points)
        return quantity.values(study, values.tolist(), f"{where}.points")
    if not isinstance(given, list) or not given:
        rule = "must be a list of values, or { spread, points }"
        raise InputError(where, rule, repr(given), 'e.g. { spread = "20 %", points = 3 }')
    return quantity.values(study, given, where)
