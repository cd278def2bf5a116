"""Losses that keep a few wild readings from deciding a fit."""

from __future__ import annotations

import abc

import equinox as eqx
import numpy as np

from jaxsim.errors import InputError


class Loss(eqx.Module):
    """rho(r) of a residual r in standard deviations; half its sum is what a fit makes smallest."""

    @abc.abstractmethod
    def value(self, r: np.ndarray) -> np.ndarray:
        """rho(r); r^2 for small residuals."""

    @abc.abstractmethod
    def weight(self, r: np.ndarray) -> np.ndarray:
        """rho'(r)/(2 r): how much of a residual counts; 1 for small ones."""


class Squares(Loss):
    """rho = r^2: readings without outliers."""

    def value(self, r: np.ndarray) -> np.ndarray:
        return r * r

    def weight(self, r: np.ndarray) -> np.ndarray:
        return np.ones_like(r)


class _Threshold(Loss):
    at: float = eqx.field(static=True, default=3.0)

    def __check_init__(self) -> None:
        if not self.at > 0.0:
            raise InputError("robust.at", "must be > 0", self.at, "e.g. 3 standard deviations")


class Huber(_Threshold):
    """rho = r^2 up to `at`, then 2 at |r| - at^2; Huber (1964)."""

    def value(self, r: np.ndarray) -> np.ndarray:
        size = np.abs(r)
        return np.where(size <= self.at, size * size, self.at * (2.0 * size - self.at))

    def weight(self, r: np.ndarray) -> np.ndarray:
        return self.at / np.maximum(np.abs(r), self.at)


class SoftL1(_Threshold):
    """rho = 2 at^2 (sqrt(1 + (r/at)^2) - 1): squares for small r, smoothly |r| for large."""

    def value(self, r: np.ndarray) -> np.ndarray:
        # In this form nothing cancels for small residuals.
        return 2.0 * r * r / (1.0 + np.sqrt(1.0 + (r / self.at) ** 2))

    def weight(self, r: np.ndarray) -> np.ndarray:
        return 1.0 / np.sqrt(1.0 + (r / self.at) ** 2)


LOSSES: dict[str, type[Loss]] = {"squares": Squares, "huber": Huber, "soft_l1": SoftL1}
