"""Metrics are folds over the accepted pieces of a run: start, update, finish.

They never see a stored trajectory, so a batch of thousands keeps none, and the same definitions
serve tables, objectives, rewards and limits.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxsim.engine import Piece
from jaxsim.errors import InputError
from jaxsim.loop import ClosedLoop, When

Scalar = Any


_UNITS = {
    "per_s": "1/s",
    "rad_s2": "rad s²",
    "rad_s": "rad s",
    "Nm": "Nm",
    "pct": "%",
    "deg": "deg",
    "dB": "dB",
    "rad": "rad",
    "J": "J",
    "Hz": "Hz",
    "s": "s",
}  # longest endings first


def unit_of(metric: str, command: str = "") -> str:
    """The unit at the end of a metric's name, as people write it; empty where it has none.

    command: the unit of the drive's command, which no name can hold.
    """
    if metric.startswith("command_"):
        return command
    if metric.endswith("speed_rad_s"):
        return "rad/s"
    return next((unit for end, unit in _UNITS.items() if metric.endswith(f"_{end}")), "")


class Task(NamedTuple):
    """What was asked of one axis: the reference before and after, when it changes, how long."""

    initial: Scalar
    target: Scalar
    onset: Scalar
    duration: Scalar

    @property
    def direction(self) -> Scalar:
        """+1 or -1 towards the target; 0 where the reference does not step."""
        return jnp.sign(self.target - self.initial)

    def begun(self, piece: Piece) -> Scalar:
        """Whether a piece lies after the onset; its middle tells, ends meet it to rounding only."""
        return piece.t + 0.5 * piece.h >= self.onset


class Metric(eqx.Module):
    """A group of numbers computed together over one axis of a run.

    reference_unit: of the references that the numbers are about; what compares with a reference
    is nan in a run whose law follows another kind (an overshoot in rad of a torque law).

    `values` names them, each with its unit in the name; the last of each line of the class
    docstring says what a run that never touches, settles or oscillates gives. never: the same for
    tables, name -> (that value, what it says).
    """

    values: ClassVar[tuple[str, ...]]
    never: ClassVar[Mapping[str, tuple[float, str]]] = {}
    reference_unit: ClassVar[str] = "rad"
    task: Task

    @abc.abstractmethod
    def start(self) -> Any:
        """The fold before the first piece: a tuple of arrays in the dtype of the task."""

    @abc.abstractmethod
    def update(self, fold: Any, piece: Piece) -> Any:
        """The fold after one more accepted piece."""

    @abc.abstractmethod
    def finish(self, fold: Any) -> dict[str, Scalar]:
        """The named numbers."""


def task_of(loop: ClosedLoop, axis: int, unit: str) -> Task:
    """The task of one axis, read off its reference signal; nan where that is not in `unit`."""
    reference = loop.scenario.reference[axis]
    like = jnp.zeros_like(jnp.asarray(loop.scenario.start[axis].theta_L))
    onset = reference.onset()
    end = like + loop.scenario.duration
    about = like if (loop.law.reference_unit or "rad") == unit else like + jnp.nan
    return Task(
        initial=about + reference.value(*When(like, like - 1.0)),
        target=about + reference.value(*When(end, end)),
        # A reference that never moves is there from the start.
        onset=like + jnp.where(jnp.isinf(onset), 0.0, onset),
        duration=end,
    )


def choose(known: dict[str, type[Metric]], names: tuple[str, ...]) -> tuple[type[Metric], ...]:
    """The metric groups that hold the named numbers.

    Raises: InputError for an unknown name, with the nearest ones.
    """
    owner = {value: group for group in known.values() for value in group.values}
    for name in names:
        if name not in owner:
            raise InputError.unknown("metrics", name, owner)
    return tuple(dict.fromkeys(owner[name] for name in names))
