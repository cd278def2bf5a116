"""Frequency response: Bode data, bandwidth, peak, gain and phase margins."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize

from jaxsim.errors import InputError
from jaxsim.linear.stability import sign_change, stable_intervals
from jaxsim.linear.state_space import StateSpace, poles

_MINUS_3_DB = math.sqrt(0.5)


class Bode(NamedTuple):
    """omega (n,) rad/s; magnitude and phase (n, outputs, inputs), 1 and rad (unwrapped)."""

    omega: np.ndarray
    magnitude: np.ndarray
    phase: np.ndarray


class Margins(NamedTuple):
    """gain: factor to the next unstable one, above (inf: none) and below (0: none); phase: rad.

    The phase margin is the smallest of all crossings |L| = 1, at omega_phase rad/s; inf: none.
    """

    gain: float
    gain_below: float
    phase: float
    omega_phase: float


class Peak(NamedTuple):
    """Largest magnitude and where it is, rad/s."""

    magnitude: float
    omega: float


def response(system: StateSpace, omega: float | np.ndarray) -> np.ndarray:
    """C (j omega - A)^-1 B + D, (..., outputs, inputs) complex; omega (...,) rad/s."""
    s = system.balanced()
    shifted = 1j * np.asarray(omega)[..., None, None] * np.eye(len(s.A)) - s.A
    return s.C @ np.linalg.solve(shifted, s.B.astype(complex)) + s.D


def bode(system: StateSpace, omega: np.ndarray) -> Bode:
    """Magnitude and phase over ascending frequencies."""
    values = response(system, omega)
    return Bode(np.asarray(omega), np.abs(values), np.unwrap(np.angle(values), axis=0))


def level_crossings(channel: StateSpace, level: float) -> np.ndarray:
    """All omega > 0 at which |G(j omega)| = level, ascending, rad/s; one input and one output.

    They are the imaginary eigenvalues of a Hamiltonian matrix, so none is missed between grid
    points; each is then polished on |G| itself, which also throws out those that only touch.
    """
    _single(channel)
    s = channel.balanced()
    gain = level**2 - s.D[0, 0] ** 2
    if gain == 0.0:
        raise InputError("level", "must differ from |D|", level, "choose another level")
    shifted = s.A + s.B @ s.C * (s.D[0, 0] / gain)
    drive = s.B @ s.B.T / gain
    sense = s.C.T @ s.C * (1.0 + s.D[0, 0] ** 2 / gain)
    hamiltonian = np.block([[shifted, drive], [-sense, -shifted.T]])
    found = np.linalg.eigvals(linalg.matrix_balance(hamiltonian)[0])
    near = (np.imag(found) > 0.0) & (np.abs(np.real(found)) < _NEAR_AXIS * np.abs(found))
    return _polished(
        lambda w: abs(response(channel, w)[0, 0]) - level, np.sort(np.imag(found)[near])
    )


_NEAR_AXIS = 1e-3  # wide: what is no crossing is thrown out by its sign


def _polished(excess: Callable[[float], float], guesses: np.ndarray) -> np.ndarray:
    """The sign changes of `excess` next to the guesses."""
    roots: list[float] = []
    between = np.sqrt(guesses[1:] * guesses[:-1])
    ends = np.concatenate([guesses[:1] * 0.5, between, guesses[-1:] * 2.0])
    for low, high in itertools.pairwise(ends):
        if (excess(low) > 0.0) != (excess(high) > 0.0):
            roots.append(sign_change(excess, low, high))
    return np.array(roots)


def bandwidth(channel: StateSpace) -> float:
    """The first omega at which |G| has fallen 3 dB below |G(0)|, rad/s; inf: it never does."""
    crossings = level_crossings(channel, _MINUS_3_DB * abs(response(channel, 0.0)[0, 0]))
    return float(crossings[0]) if len(crossings) else math.inf


def peak(channel: StateSpace) -> Peak:
    """The largest |G(j omega)| over omega >= 0 of a stable system (omega = inf where it is D).

    Bruinsma and Steinbuch (1990): between crossings of the best level so far lies a better one.
    """
    _single(channel)

    def size(omega: float) -> float:
        return float(np.abs(response(channel, omega)[0, 0]))

    omega = max([0.0, *np.abs(poles(channel))], key=size)
    while len(above := level_crossings(channel, size(omega) * (1.0 + _PEAK))) > 1:
        higher = max(np.sqrt(above[1:] * above[:-1]), key=size)
        if size(higher) <= size(omega):
            break  # rounding: nothing is left to be gained
        omega = higher
    if abs(channel.D[0, 0]) >= size(omega):
        return Peak(abs(channel.D[0, 0]), math.inf)
    ends = (omega * (1.0 - 1e-3), omega * (1.0 + 1e-3))
    best = optimize.minimize_scalar(lambda w: -size(w), bounds=ends, options={"xatol": 1e-9})
    return max(Peak(size(omega), float(omega)), Peak(float(-best.fun), float(best.x)))


_PEAK = 1e-6  # relative rise that is still looked for; then a bounded search


def margins(loop: StateSpace) -> Margins:
    """Gain and phase margins of a loop L(s) closed by 1 + L, one input and one output.

    The gain margins are the edges of the stable interval around gain 1 (exact, also for
    conditionally stable loops); the phase margin the least |180 deg + arg L| where |L| = 1.
    Raises: InputError for a loop that is unstable when closed: it has no margins.
    """
    _single(loop)
    A_1 = -loop.B @ loop.C
    if loop.D[0, 0] != 0.0:
        raise InputError("loop", "must be strictly proper", loop.D[0, 0], "model its fastest lag")
    around = [i for i in stable_intervals(loop.A, A_1) if i[0] < 1.0 < i[1]]
    if not around:
        raise InputError("loop", "must be stable when closed", "unstable", "see stable_intervals")
    crossings = level_crossings(loop, 1.0)
    away = [abs(np.angle(-response(loop, w)[0, 0])) for w in crossings]
    least = int(np.argmin(away)) if away else -1
    phase, omega = (away[least], crossings[least]) if away else (math.inf, math.nan)
    return Margins(around[0][1], around[0][0], float(phase), float(omega))


def _single(channel: StateSpace) -> None:
    if len(channel.inputs) != 1 or len(channel.outputs) != 1:
        raise InputError(
            "channel", "must have one input and one output",
            (channel.inputs, channel.outputs), "take system.channel([output], [input])",
        )  # fmt: skip
