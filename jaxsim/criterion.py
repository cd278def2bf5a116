"""Numbers of a closed loop that no single run shows: poles, margins, whether it cycles by itself.

They are asked for by name, like metrics, in objectives, limits and `simulate`, and are
differentiated like these. Unlike metrics they are left out where all metrics are asked for.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Collection
from functools import cached_property
from typing import Any, ClassVar

from jaxsim.catalog import CRITERIA
from jaxsim.errors import InputError
from jaxsim.loop import ClosedLoop
from jaxsim.scenario import Scenario


class Subject:
    """What is measured: drive, law and scenario of a run in one loop.

    again: runs the same loop in another scenario of the same duration and gives metrics by name.
    """

    def __init__(
        self, loop: ClosedLoop, again: Callable[[Scenario, tuple[str, ...]], dict[str, Any]]
    ) -> None:
        self.loop, self.again = loop, again

    @cached_property
    def in_contact(self) -> Any:
        """The `jaxsim.linear.traced.Modes` in contact: one for all criteria of a run."""
        from jaxsim.linear import traced  # SciPy: 0.2 s that other runs need not pay

        return traced.in_contact(self.loop)


class Criterion(abc.ABC):
    """A group of numbers of one closed loop that are computed together.

    `values` names them, each with its unit in the name.
    """

    values: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def measure(self, subject: Subject) -> dict[str, Any]:
        """The named numbers: one (), or one per axis (axes,).

        Raises: InputError for a loop that has no such numbers.
        """


def chosen(names: tuple[str, ...], metrics: Collection[str]) -> tuple[type[Criterion], ...]:
    """The criteria that hold those of the names that are no metrics.

    Raises: InputError for a name that is neither, with the nearest ones.
    """
    wanted = [name for name in names if name not in metrics]
    if not wanted:
        return ()
    owner = {v: group for group in CRITERIA.all().values() for v in group.values}
    for name in wanted:
        if name not in owner:
            raise InputError.unknown("metrics", name, [*metrics, *owner])
    return tuple(dict.fromkeys(owner[name] for name in wanted))
