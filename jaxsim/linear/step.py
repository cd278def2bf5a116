"""Step response of a linear system, by its matrix exponential."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import linalg

from jaxsim.errors import InputError
from jaxsim.linear.state_space import StateSpace


class StepResponse(NamedTuple):
    """t (n,) s; y (n, outputs, inputs): output per unit step of each input."""

    t: np.ndarray
    y: np.ndarray


def step_response(system: StateSpace, period: float, samples: int) -> StepResponse:
    """Exact values at t = 0, period, ..., of the answers to unit steps from rest."""
    if not period > 0.0 or samples < 2:
        raise InputError("period", "must be > 0, with 2 samples or more", period, "give a grid")
    s = system.balanced()
    n, m = s.B.shape
    grown = linalg.expm(period * np.block([[s.A, s.B], [np.zeros((m, n + m))]]))
    x, y = np.zeros((n, m)), [s.D]
    for _ in range(samples - 1):
        x = grown[:n, :n] @ x + grown[:n, n:]
        y.append(s.C @ x + s.D)
    return StepResponse(period * np.arange(samples), np.array(y))


def overshoot(response: StepResponse, final: float = 1.0) -> np.ndarray:
    """Largest value beyond `final`, relative to it, (outputs, inputs); 0 where it stays below.

    A parabola through the three samples at the top gives the value between samples.
    """
    y = response.y / final
    top = np.clip(np.argmax(y, axis=0), 1, len(y) - 2)
    before, at, after = (np.take_along_axis(y, (top + k)[None], axis=0)[0] for k in (-1, 0, 1))
    bend = 2.0 * at - before - after
    rise = np.where(bend > 0.0, (after - before) ** 2 / np.where(bend > 0.0, 8.0 * bend, 1.0), 0.0)
    return np.maximum(np.maximum(at + rise, y.max(axis=0)) - 1.0, 0.0)
