"""Drives drawn at random within ranges."""

from __future__ import annotations

from typing import Any, ClassVar

from jaxsim.errors import InputError
from jaxsim.study import Study
from tuning.drive_set import Drives, DriveSet, hypercube, spread_of, table_of, with_own


class Spread(DriveSet):
    """`spread = { half_gap = "20 %", K = [200, 300] }`: the study's drive and a Latin hypercube.

    "20 %" is a half-width relative to the study's drive, a list the two ends; `count` is of all.
    """

    counted: ClassVar[bool] = True

    def read(self, study: Study, given: Any, count: int, seed: int, where: str) -> Drives:
        table = table_of(given, where, 'e.g. spread = { half_gap = "20 %" }')
        if count < 2:
            raise InputError(
                "tune.drives", "needs both count > 1 and spread", f"count = {count}", "give both"
            )
        spreads = tuple(spread_of(study, n, v, f"{where}.{n}") for n, v in table.items())
        return with_own(study, spreads, hypercube(spreads, count - 1, seed))
