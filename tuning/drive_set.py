"""The drives that a law is tuned for: what differs between them, and its values drive by drive."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.stats import qmc

from jaxsim import tree
from jaxsim.catalog import Catalog
from jaxsim.errors import InputError, called
from jaxsim.quantity import to_si
from jaxsim.sampled import Sampled
from jaxsim.study import Study

SETS = Catalog("drive sets", "tuning.sets", "tuning.drive_set:DriveSet")


# From a sample to its command: a property of the machine, though a sampled law has it.
DELAY = "law.delay"


class Spread(NamedTuple):
    """What differs: a parameter of the drive (by path) or the delay, and its range in SI units.

    step: the values are whole multiples of it; 0 where there is none.
    """

    name: str
    path: str
    lower: float
    upper: float
    step: float = 0.0


class Quantity(NamedTuple):
    """A number that may differ from drive to drive: where it is, and its value in the study."""

    name: str
    path: str
    unit: str
    own: float
    step: float

    def values(self, study: Study, given: Any, where: str) -> np.ndarray:
        """What a file gives, numbers or text, in SI units.

        Raises: InputError for what is none, and for delays that a sampled law cannot have.
        """
        values = np.atleast_1d(np.asarray(to_si(given, self.unit, where), float))
        if self.path == DELAY:
            self._check_delays(study, values, where)
        return values

    def spread(self, lower: float, upper: float) -> Spread:
        return Spread(self.name, self.path, lower, upper, self.step)

    def _check_delays(self, study: Study, values: np.ndarray, where: str) -> None:
        for value in values:
            with called(where):
                with_delay(study.law, value).ticks(study.run.dt)


class Drives(NamedTuple):
    """What differs and how: values (drives, spreads), SI; the first row is the study's drive."""

    spreads: tuple[Spread, ...]
    values: np.ndarray


class DriveSet(abc.ABC):
    """A kind of set, known in `[tune.drives]` by the key that is its name in snake_case.

    counted: whether it takes `count`, how many drives there are.
    """

    counted: ClassVar[bool] = False

    @abc.abstractmethod
    def read(self, study: Study, given: Any, count: int, seed: int, where: str) -> Drives:
        """The drives that `given`, the value of its key, describes, the study's own among them.

        Raises: InputError naming what does not fit.
        """


def path_in(owner: Any, name: str, where: str) -> str:
    """The path of a parameter by its name.

    Raises: InputError at `where` for unknown and ambiguous names.
    """
    with called(where):
        return tree.resolve(owner, name)


def quantity_in(study: Study, name: str, where: str) -> Quantity:
    """A parameter of the study's drive by its name, or the "delay" of its sampled law.

    Raises: InputError for unknown and ambiguous names, and where it is no single number.
    """
    if name in ("delay", DELAY):
        if not isinstance(study.law, Sampled):
            fix = 'give the law type = "sampled" and a period'
            raise InputError(where, "needs a sampled law", "a continuous one", fix)
        return Quantity(name, DELAY, "s", study.law.delay, study.run.dt)
    path = path_in(study.drive, name, where)
    value = tree.get(study.drive, path)
    if np.ndim(value):
        raise InputError(where, "must be a single number", np.shape(value), "name one entry")
    return Quantity(name, path, tree.unit(study.drive, path), float(value), 0.0)


def with_delay(law: Any, delay: float) -> Any:
    """A sampled law whose commands come so late, s."""
    return dataclasses.replace(law, delay=float(delay))


def table_of(given: Any, where: str, example: str) -> dict[str, Any]:
    """A table with at least one entry."""
    if not isinstance(given, dict) or not given:
        raise InputError(where, "must be a table of parameters", repr(given), example)
    return given


def spread_of(study: Study, name: str, given: Any, where: str) -> Spread:
    """A half-width relative to the study's drive, such as "20 %", or a list [lower, upper].

    Raises: InputError for an unknown name, another form, and an empty range.
    """
    quantity = quantity_in(study, name, where)
    if isinstance(given, list) and len(given) == 2:
        ends = quantity.values(study, given, where)
    elif isinstance(given, str) and given.rstrip().endswith("%"):
        share = _percent(given, where)
        ends = quantity.values(
            study, sorted(quantity.own * (1.0 + sign * share) for sign in (-1, 1)), where
        )
    else:
        rule = 'must be relative like "20 %" or a list [lower, upper]'
        raise InputError(where, rule, repr(given), 'e.g. "20 %"')
    lower, upper = ends.tolist()
    if not lower < upper:
        raise InputError(where, "must span a range", [lower, upper], "give lower < upper")
    return quantity.spread(lower, upper)


def _percent(text: str, where: str) -> float:
    try:
        share = float(text.rstrip().removesuffix("%")) / 100.0
    except ValueError:
        raise InputError(where, "must be a number and %", repr(text), 'e.g. "20 %"') from None
    if not 0.0 < share < float("inf"):
        raise InputError(where, "must be > 0 %", text, 'e.g. "20 %"')
    return share


def hypercube(spreads: Sequence[Spread], count: int, seed: int) -> np.ndarray:
    """(count, spreads): a Latin hypercube over the ranges, all steps of a range alike."""
    sampler = qmc.LatinHypercube(len(spreads), rng=np.random.default_rng([seed, 0]))
    columns = zip(spreads, sampler.random(count).T, strict=True)
    return np.stack([_placed(s, share) for s, share in columns], axis=1)


def _placed(s: Spread, share: np.ndarray) -> np.ndarray:
    if s.step == 0.0:
        return s.lower + (s.upper - s.lower) * share
    first, last = (round(end / s.step) for end in (s.lower, s.upper))
    return s.step * (first + np.floor((last - first + 1) * share))


def with_own(study: Study, spreads: tuple[Spread, ...], others: np.ndarray) -> Drives:
    """The study's drive, and the others in their order; its copies among these are left out."""
    own = np.array([[quantity_in(study, s.name, s.name).own for s in spreads]])
    distinct = others[~np.isclose(others, own, rtol=1e-12, atol=0.0).all(axis=1)]
    return Drives(spreads, np.concatenate([own, distinct]))
