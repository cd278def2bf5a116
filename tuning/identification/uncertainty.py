"""How sure: covariance for residuals that are not white, profiles, bootstrap over experiments."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

from tuning.identification.estimator import Fit, Progress, Stage, fit
from tuning.identification.residuals import Evaluation, Problem
from tuning.identification.robust import Loss

# Residuals pass for white where this test would only rarely fail on white noise.
_WHITE = 0.01
_LAGS = 20
_MANY = 20  # experiments from which on their scatter tells more than a model of the residuals
# From a good fit on, there is no way to find.
_LAST = (Stage(),)


class Whiteness(NamedTuple):
    """One signal of one experiment: what is left of it.

    rms: of the residuals, in standard deviations of the assumed noise. p: Ljung-Box test, the
    probability that white noise looks as coloured as this. inflation: how many readings carry the
    information of one (integrated autocorrelation time). count: readings used.
    """

    rms: float
    p: float
    inflation: float
    count: int

    @property
    def white(self) -> bool:
        return self.p >= _WHITE


class Covariance(NamedTuple):
    """Covariances of the unknowns in SI units, and the eyes they were seen with.

    matrix: (P, P), what is reported. naive: (P, P), for white residuals of exactly the assumed
    noise. information: (P, P), J^T W J in SI units. whiteness: per experiment and signal.
    sandwiched: whether coloured residuals took part in `matrix`. freedom: effective readings less
    unknowns.
    """

    matrix: np.ndarray
    naive: np.ndarray
    information: np.ndarray
    whiteness: tuple[tuple[Whiteness, ...], ...]
    sandwiched: bool
    freedom: float

    @property
    def deviation(self) -> np.ndarray:
        """(P,) standard errors."""
        return np.sqrt(np.diag(self.matrix))


def covariance(
    problem: Problem, seen: Evaluation, values: np.ndarray, loss: Loss,
    *, row: int = 0, who: np.ndarray | None = None,
) -> Covariance:  # fmt: skip
    """The covariance at a fit's end.

    With A = sum of w J J^T: A^-1 (sum over signals of kappa A_signal) A^-1, where kappa is the mean
    square of a signal's residuals times its inflation; and, where residuals are coloured, for each
    unknown at least the sandwich A^-1 B A^-1, B summing products of scores w r J over lags
    (Newey and West, 1987, Econometrica 55, with Bartlett's weights). With many experiments, more
    than twice as many as unknowns, B sums products of whole experiments' scores instead, which
    asks nothing of what happens within one (Liang and Zeger, 1986, Biometrika 73), times E/(E - P).

    seen: an evaluation with derivatives by SI values (scale 1), of which `row` is the fit. values:
    (P,). who: (E,) the experiments that the fit looked at; all of them by default.
    """
    who = np.arange(len(problem.experiments)) if who is None else who
    r, used = seen.residuals[row], problem.readings.used[who]
    scale = sizes(problem, values)
    J = by_columns(problem, seen.jacobian[row], who) * scale
    weight = loss.weight(r)
    white = tuple(
        tuple(whiteness(r[e, s][used[e, s]]) for s in range(r.shape[1])) for e in range(r.shape[0])
    )
    size, logs = len(scale), len(who)
    scores = np.einsum("esn,esn,esnp->ep", weight, np.where(used, r, 0.0), J)
    A, middle, B = (np.zeros((size, size)) for _ in range(3))
    for e, own in enumerate(white):
        for s, test in enumerate(own):
            mask = used[e, s]
            rows, w, left = J[e, s][mask], weight[e, s][mask], r[e, s][mask]
            part = (rows * w[:, None]).T @ rows
            A += part
            middle += max(test.rms, 1e-300) ** 2 * test.inflation * part
            B += _lagged((w * left)[:, None] * rows, test.inflation)
    count = sum(t.count / t.inflation for own in white for t in own)
    freedom = max(count - size, 1.0)
    total = sum(t.count for own in white for t in own)
    back = inverse(A)
    matrix = back @ middle @ back * (total / max(total - size, 1.0))
    coloured = not all(t.white for own in white for t in own)
    if coloured and logs >= max(_MANY, 2 * size):
        matrix = back @ (scores.T @ scores) @ back * (logs / (logs - size))
        freedom = float(logs - size)
    elif coloured:
        matrix = _at_least(matrix, back @ B @ back * (total / max(total - size, 1.0)))
    outer = scale[:, None] * scale[None, :]
    return Covariance(matrix * outer, back * outer, A / outer, white, coloured, freedom)


def sizes(problem: Problem, values: np.ndarray) -> np.ndarray:
    """(P,) a natural size of each unknown, so that matrices of mixed units can be inverted."""
    spans = np.array([f.upper - f.lower for f in problem.unknowns.free])[problem.unknowns.of]
    return np.where(np.abs(values) > 1e-3 * spans, np.abs(values), spans)


def by_columns(problem: Problem, jacobian: np.ndarray, who: np.ndarray) -> np.ndarray:
    """(E, signals, samples, P) from the derivatives by each experiment's own parameters."""
    columns = problem.unknowns.columns()[who]
    full = np.zeros((*jacobian.shape[:-1], len(problem.unknowns.of)))
    for e, at in enumerate(columns):
        full[e][..., at] = jacobian[e]
    return full


def inverse(A: np.ndarray) -> np.ndarray:
    """The inverse, with what is not determined given a large variance instead of none."""
    values, vectors = np.linalg.eigh(0.5 * (A + A.T))
    floor = max(float(values.max()), 1e-300) * 1e-14
    return (vectors / np.maximum(values, floor)) @ vectors.T


def _lagged(scores: np.ndarray, inflation: float) -> np.ndarray:
    """The long-run covariance of a series of scores, lags weighted by a triangle."""
    lags = min(int(np.ceil(5.0 * inflation)), max(len(scores) // 4, 0))
    total = scores.T @ scores
    for lag in range(1, lags + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    return total


def _at_least(model: np.ndarray, sandwich: np.ndarray) -> np.ndarray:
    """The model's correlations, with each variance raised to the sandwich's where that is more."""
    before = np.sqrt(np.diag(model))
    after = np.sqrt(np.maximum(np.diag(model), np.diag(sandwich)))
    grow = after / np.maximum(before, 1e-300)
    return model * grow[:, None] * grow[None, :]


def whiteness(residuals: np.ndarray) -> Whiteness:
    """The statistics of one series of residuals."""
    count = residuals.size
    if count < 3 * _LAGS:
        rms = float(np.sqrt(np.mean(residuals**2))) if count else 0.0
        return Whiteness(rms, 1.0, 1.0, count)
    rms = float(np.sqrt(np.mean(residuals**2)))
    rho = autocorrelation(residuals)
    lags = np.arange(1, _LAGS + 1)
    statistic = count * (count + 2) * np.sum(rho[1 : _LAGS + 1] ** 2 / (count - lags))
    p = float(stats.chi2.sf(statistic, _LAGS))
    return Whiteness(rms, p, _inflation(rho) if p < _WHITE else 1.0, count)


def autocorrelation(residuals: np.ndarray) -> np.ndarray:
    """Sample autocorrelation, about zero: a mean that is left over counts as colour."""
    count = residuals.size
    spectrum = np.fft.rfft(residuals, 2 * count)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[:count]
    return covariance / covariance[0] if covariance[0] > 0.0 else np.eye(1, count)[0]


def _inflation(rho: np.ndarray) -> float:
    """Integrated autocorrelation time, summed up to five times itself (Sokal's window)."""
    total = 1.0 + 2.0 * np.cumsum(rho[1:])
    window = np.flatnonzero(np.arange(1, len(total) + 1) >= 5.0 * total)
    at = int(window[0]) if window.size else len(total) - 1
    return float(max(1.0, total[at]))


def intervals(
    problem: Problem, values: np.ndarray, deviation: np.ndarray, freedom: float, confidence: float
) -> np.ndarray:
    """(P, 2) bounds of the confidence intervals; in the logarithm where the search was."""
    half = float(stats.t.ppf(0.5 + 0.5 * confidence, freedom)) * deviation
    log = np.array([f.log for f in problem.unknowns.free])[problem.unknowns.of]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        grow = np.exp(np.minimum(half / np.abs(values), 700.0))
        low = np.where(log, np.minimum(values / grow, values * grow), values - half)
        high = np.where(log, np.maximum(values / grow, values * grow), values + half)
    return np.stack([low, high], axis=1)


class Profile(NamedTuple):
    """The loss along one unknown, all others fitted anew at every point.

    values, loss: (n,); least: the lowest loss; lowest: (P,) all unknowns there; rise: what the loss
    rises by at the ends of the interval; interval: (low, high), nan on a side where the loss does
    not rise so far.
    """

    name: str
    values: np.ndarray
    loss: np.ndarray
    least: float
    lowest: np.ndarray
    rise: float
    interval: tuple[float, float]


def profile(
    problem: Problem, best: np.ndarray, column: int, seen: Covariance, loss: Loss,
    confidence: float, *, who: np.ndarray, points: int = 11,
    tell: Callable[[Progress], None] | None = None, fitted: Fit = fit,
) -> Profile:  # fmt: skip
    """The profile likelihood of one unknown over three intervals' width.

    The rise that bounds the interval is that of chi^2, times how much larger the variance is than
    that of white residuals of the assumed noise.
    """
    spread = seen.deviation[column]
    free = problem.unknowns.free[problem.unknowns.of[column]]
    quantile = float(stats.t.ppf(0.5 + 0.5 * confidence, seen.freedom))
    grid = best[column] + np.linspace(-1.5, 1.5, points) * quantile * spread
    grid = np.unique(np.clip(grid, free.lower, free.upper))
    starts = np.tile(best, (len(grid), 1))
    starts[:, column] = grid
    frozen = np.zeros_like(starts, bool)
    frozen[:, column] = True
    whose = np.tile(who, (len(grid), 1))
    found = fitted(problem, starts, who=whose, stages=_LAST, loss=loss, frozen=frozen, tell=tell)
    least = float(found.loss.min())
    kappa = seen.matrix[column, column] / seen.naive[column, column]
    rise = 0.5 * quantile**2 * kappa
    # What was interrupted before its first run has no loss: no interval either.
    above = found.loss - least if np.isfinite(least) else np.zeros_like(found.loss)
    interval = _crossings(grid, above, rise)
    name = problem.unknowns.names[column]
    lowest = found.values[found.best]
    return Profile(name, grid, found.loss, least, lowest, rise, interval)


def _crossings(grid: np.ndarray, loss: np.ndarray, rise: float) -> tuple[float, float]:
    """Where the loss first exceeds `rise` on both sides of its lowest point."""
    bottom = int(np.argmin(loss))

    def cross(order: np.ndarray) -> float:
        for a, b in itertools.pairwise(order):
            if loss[a] < rise <= loss[b]:
                # Straight in the root: the loss is nearly a parabola.
                ra, rb, r = (np.sqrt(max(v, 0.0)) for v in (loss[a], loss[b], rise))
                return float(grid[a] + (r - ra) / (rb - ra) * (grid[b] - grid[a]))
        return float("nan")

    return cross(np.arange(bottom, -1, -1)), cross(np.arange(bottom, len(grid)))


def bootstrap(
    problem: Problem, best: np.ndarray, loss: Loss, who: np.ndarray, samples: int, seed: int,
    *, tell: Callable[[Progress], None] | None = None, fitted: Fit = fit,
) -> np.ndarray:  # fmt: skip
    """(samples, P) fits to experiments drawn with replacement, from the best fit on.

    Parameters that each experiment has for itself follow their experiment. Fits that fail are left
    out.
    """
    draws = np.random.default_rng(seed).choice(who, (samples, len(who)))
    starts = np.tile(best, (samples, 1))
    found = fitted(problem, starts, who=draws, stages=_LAST, loss=loss, tell=tell)
    return found.values[np.isfinite(found.loss)]
