"""The drives that a law is tuned for: parameters that differ, and their values drive by drive."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.stats import qmc

from jaxsim import tree
from jaxsim.catalog import Catalog
from jaxsim.errors import InputError
from jaxsim.quantity import to_si
from jaxsim.study import Study

SETS = Catalog("drive sets", "tuning.sets", "tuning.drive_set:DriveSet")


class Spread(NamedTuple):
    """A parameter of the drive (by path) that differs, and its range in SI units."""

    name: str
    path: str
    lower: float
    upper: float


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
    try:
        return tree.resolve(owner, name)
    except InputError as error:
        raise InputError(where, error.rule, error.value, error.fix) from None


def table_of(given: Any, where: str, example: str) -> dict[str, Any]:
    """A table with at least one entry."""
    if not isinstance(given, dict) or not given:
        raise InputError(where, "must be a table of parameters", repr(given), example)
    return given


def spread_of(study: Study, name: str, given: Any, where: str) -> Spread:
    """A half-width relative to the study's drive, such as "20 %", or a list [lower, upper].

    Raises: InputError for an unknown name, another form, and an empty range.
    """
    path = path_in(study.drive, name, where)
    unit, value = tree.unit(study.drive, path), own_value(study, path, where)
    if isinstance(given, list) and len(given) == 2:
        lower, upper = (float(v) for v in to_si(given, unit, where))
    elif isinstance(given, str) and given.rstrip().endswith("%"):
        share = _percent(given, where)
        lower, upper = sorted((value * (1.0 - share), value * (1.0 + share)))
    else:
        rule = 'must be relative like "20 %" or a list [lower, upper]'
        raise InputError(where, rule, repr(given), 'e.g. "20 %"')
    if not lower < upper:
        raise InputError(where, "must span a range", [lower, upper], "give lower < upper")
    return Spread(name, path, lower, upper)


def own_value(study: Study, path: str, where: str) -> float:
    """A parameter of the study's drive.

    Raises: InputError where it is no single number.
    """
    value = tree.get(study.drive, path)
    if np.ndim(value):
        raise InputError(where, "must be a single number", np.shape(value), "name one entry")
    return float(value)


def _percent(text: str, where: str) -> float:
    try:
        share = float(text.rstrip().removesuffix("%")) / 100.0
    except ValueError:
        raise InputError(where, "must be a number and %", repr(text), 'e.g. "20 %"') from None
    if not 0.0 < share < float("inf"):
        raise InputError(where, "must be > 0 %", text, 'e.g. "20 %"')
    return share


def hypercube(spreads: Sequence[Spread], count: int, seed: int) -> np.ndarray:
    """(count, spreads): a Latin hypercube over the ranges."""
    sampler = qmc.LatinHypercube(len(spreads), rng=np.random.default_rng([seed, 0]))
    low, high = (np.array([getattr(s, k) for s in spreads]) for k in ("lower", "upper"))
    return low + (high - low) * sampler.random(count)


def with_own(study: Study, spreads: tuple[Spread, ...], others: np.ndarray) -> Drives:
    """The study's drive, and the others in their order; its copies among these are left out."""
    own = np.array([[own_value(study, s.path, s.name) for s in spreads]])
    distinct = others[~np.isclose(others, own, rtol=1e-12, atol=0.0).all(axis=1)]
    return Drives(spreads, np.concatenate([own, distinct]))
