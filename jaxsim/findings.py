"""What a reproduction finds: rows of numbers next to a paper's, claims with verdicts, figures."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from jaxsim.catalog import Catalog

Draw = Callable[[Path], None]

# What event-accurate reference values are met to at the integration step of the reproductions.
RELATIVE = 1e-5


class Row(NamedTuple):
    """One number. `paper` is None where the paper gives none.

    `tolerance` says in words what `ok` is judged against; both are None where there is nothing
    to judge against. In a claim `ok` is the verdict: whether what the paper says holds here.
    """

    id: str
    quantity: str
    unit: str
    paper: float | None
    value: float
    tolerance: str | None
    ok: bool | None
    note: str


class Findings(NamedTuple):
    """All rows of one group, and for each of its figures a function that draws it to a path."""

    rows: list[Row]
    figures: Mapping[str, Draw]


class Group(abc.ABC):
    """One scenario of a paper with everything that is read off it.

    paper: short name of the paper; title: one line for the listing; figures: names of the files
    that `find` gives drawings for, without suffix.
    """

    paper: ClassVar[str]
    title: ClassVar[str]
    figures: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def find(self) -> Findings:
        """Run it."""


GROUPS = Catalog("reproduction", "jaxsim.reproduction", "jaxsim.findings:Group")


def measured(id: str, quantity: str, unit: str, value: Any, note: str = "") -> Row:
    """A number that there is nothing to judge against."""
    return Row(id, quantity, unit, None, float(value), None, None, note)


def against_paper(
    id: str, quantity: str, unit: str, value: Any, paper: float, within: float, note: str = ""
) -> Row:
    """A number that the paper prints; `within` is half a unit of its last digit, or as noted."""
    words = f"within {within:g} {unit} of the paper".replace(" 1 ", " ")
    ok = bool(abs(value - paper) <= within)
    return Row(id, quantity, unit, paper, float(value), words, ok, note)


def against_reference(
    id: str, quantity: str, unit: str, value: Any, reference: float, source: str, note: str = ""
) -> Row:
    """A number that the paper does not print, judged against an event-accurate reference."""
    ok = bool(abs(value - reference) <= RELATIVE * abs(reference))
    words = f"within {RELATIVE:g} of its size of the reference"
    told = f"reference {reference:.12g} ({source})"
    return Row(
        id, quantity, unit, None, float(value), words, ok, f"{told}; {note}" if note else told
    )


class Bound(NamedTuple):
    """What a claim asks of its number, in words and as the limits, which count."""

    text: str
    low: float
    high: float


def above(low: float) -> Bound:
    """More than `low`."""
    return Bound(f"> {low:g}", math.nextafter(low, math.inf), math.inf)


def below(high: float) -> Bound:
    """Less than `high`."""
    return Bound(f"< {high:g}", -math.inf, math.nextafter(high, -math.inf))


def near(centre: float, within: float) -> Bound:
    """`centre`, up to `within`."""
    text = f"{centre:.4g} +- {within:g}" if within else f"{centre:g}"
    return Bound(text, centre - within, centre + within)


def claim(
    name: str,
    quantity: str,
    unit: str,
    value: Any,
    bound: Bound,
    quote: str,
    *,
    paper: float | None = None,
) -> Row:
    """A statement of the paper's text, `quote`: it holds if `value` is within `bound`."""
    holds = bool(bound.low <= value <= bound.high)
    return Row(f"claim.{name}", quantity, unit, paper, float(value), bound.text, holds, quote)
