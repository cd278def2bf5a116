"""What a run leaves: signals, events, metrics, status."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxsim.errors import InputError
from jaxsim.status import Status


class Event(NamedTuple):
    """One crossing of a surface: time in s, name of the surface, speed = rate of its guard.

    For contact surfaces the rate is +-omega_B in rad/s: positive when contact is made.
    """

    time: float
    surface: str
    speed: float


class Run(eqx.Module):
    """Result of `simulate`; with a leading axis on every array if anything was a batch.

    time: (ticks + 1,) s, and signals: name -> (ticks + 1,) for one axis, (ticks + 1, n) for n
    axes (names and SI units in `Run.units`; values AFTER an event that falls on the tick); both
    are empty when nothing was stored. metrics: name -> scalar or (n,). status: `Status` codes.
    """

    time: Any
    signals: dict[str, Any]
    metrics: dict[str, Any]
    status: Any
    event_times: Any
    event_surfaces: Any
    event_rates: Any
    event_count: Any
    surfaces: tuple[str, ...] = eqx.field(static=True)
    units: dict[str, str] = eqx.field(static=True)
    problems: dict[int, str] = eqx.field(static=True, default_factory=dict)

    @property
    def batched(self) -> bool:
        return np.ndim(self.status) == 1

    def member(self, index: int) -> Run:
        """The run of one member of a batch."""
        arrays, rest = eqx.partition(self, eqx.is_array)
        picked = eqx.combine(eqx.filter(arrays, eqx.is_array), rest)
        return eqx.tree_at(
            lambda r: tuple(getattr(r, n) for n in _ARRAYS),
            picked,
            tuple(
                {k: v[index] for k, v in value.items()} if isinstance(value, dict) else value[index]
                for value in (getattr(self, n) for n in _ARRAYS)
            ),
        )

    def events(self) -> list[Event]:
        """The events of a single stored run, in order.

        Raises: InputError for a batch (take a member first).
        """
        if self.batched:
            raise InputError("run", "must be a single run", "a batch", "use run.member(i)")
        codes = np.asarray(self.event_surfaces)
        return [
            Event(float(self.event_times[i]), self.surfaces[codes[i]], float(self.event_rates[i]))
            for i in np.flatnonzero(codes >= 0)
        ]

    def failures(self) -> dict[int, str]:
        """Index -> words for every member that did not complete; index 0 for a single run."""
        codes = np.atleast_1d(np.asarray(self.status))
        return {
            int(i): self.problems.get(int(i), Status(int(codes[i])).words)
            for i in np.flatnonzero(codes)
        }

    def to_csv(self, path: Path) -> None:
        """Write time and signals of a single one-axis or n-axis run, units in the header."""
        columns = {"time [s]": np.asarray(self.time)}
        for name, values in self.signals.items():
            table = np.asarray(values).reshape(len(self.time), -1)
            for i, column in enumerate(table.T):
                axis = f"[{i}]" if table.shape[1] > 1 else ""
                columns[f"{name}{axis} [{self.units[name]}]"] = column
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))


_ARRAYS = (
    "time",
    "signals",
    "metrics",
    "status",
    "event_times",
    "event_surfaces",
    "event_rates",
    "event_count",
)
