"""What the session asks of an algorithm."""

from __future__ import annotations

import abc
from pathlib import Path

from jaxsim.laws.policy import Network


class Trainer(abc.ABC):
    """An algorithm that trains in segments; its whole state goes to files and comes back.

    A training that is stopped between two segments and taken up again gives the same numbers as
    one that is not.
    """

    @property
    @abc.abstractmethod
    def done(self) -> int:
        """How far it is, in the unit of `spec.total`."""

    @property
    @abc.abstractmethod
    def steps(self) -> int:
        """Steps of control that it has seen."""

    @abc.abstractmethod
    def advance(self) -> float:
        """Train one segment; minus the mean return of the episodes in it."""

    @abc.abstractmethod
    def network(self) -> Network:
        """The policy now."""

    @abc.abstractmethod
    def save(self, folder: Path) -> None:
        """Write all of its state into an empty folder."""

    @abc.abstractmethod
    def load(self, folder: Path) -> None:
        """Take up the state in a folder.

        Raises: InputError where files are missing, incomplete, or of another training.
        """

    def judged(self, loss: float, best: float) -> None:  # noqa: B027, most do not care
        """Told after each segment: the loss on validation episodes now, and the least so far."""


__all__ = ["Trainer"]
