"""What speaks against a model: logs or parts of them that disagree, what is left, wrong units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from tuning.identification.parts import Pulled
from tuning.identification.residuals import Evaluation, Problem
from tuning.identification.robust import Loss, Squares
from tuning.identification.uncertainty import Covariance

# What happens more rarely than this if the model is right speaks against it.
ODD = 1e-4
# Differences that matter, as shares of an unknown: between logs, and (weighted rms) within them.
_NOTICED, _NOTICED_WITHIN = 0.05, 0.01
# What may be left of a signal: in units of a given noise, and as a share of its scatter.
_LEFT, _SHARE = 1.5, 0.3
_UNITS = {
    180.0 / np.pi: "degrees read as rad",
    np.pi / 180.0: "rad read as degrees",
    30.0 / np.pi: "rpm read as rad/s",
    -1.0: "opposite sign",
    1e3: "a factor of 1000",
    1e-3: "a factor of 1000",
}


class Doubt(NamedTuple):
    """What speaks against the model: a sentence, the same in short, and which unknowns it is about.

    names: none stands for all of them.
    """

    words: str
    short: str
    names: tuple[str, ...] = ()


class Alone(NamedTuple):
    """One shared unknown as each log alone gives it: values and standard errors (E,).

    p: the chance that logs of one machine differ so much.
    """

    name: str
    values: np.ndarray
    deviation: np.ndarray
    p: float


def compared(name: str, values: np.ndarray, deviation: np.ndarray) -> Alone:
    """What logs say of an unknown, each for itself, by the chi^2 of their scatter."""
    weight = 1.0 / np.maximum(deviation, 1e-300) ** 2
    mean = np.sum(weight * values) / np.sum(weight)
    statistic = float(np.sum(weight * (values - mean) ** 2))
    p = float(stats.chi2.sf(statistic, max(len(values) - 1, 1)))
    # A difference that nobody would notice is none, however sure it is.
    if np.ptp(values) < _NOTICED * abs(mean):
        p = max(p, ODD)
    return Alone(name, values, deviation, p)


def contradictions(alone: Sequence[Alone]) -> list[Doubt]:
    """Unknowns about which the logs contradict each other."""
    found = []
    for a in alone:
        if a.p < ODD:
            low, high = float(a.values.min()), float(a.values.max())
            words = (
                f"The logs contradict each other about {a.name}: alone they give {low:.4g} to "
                f"{high:.4g} ({_chance(a.p)} on one machine). Two machines, or a change between "
                "the logs?"
            )
            found.append(Doubt(words, f"the logs alone give {low:.4g} to {high:.4g}", (a.name,)))
    return found


def torn(parts: Sequence[Pulled], sizes: np.ndarray) -> list[Doubt]:
    """Unknowns about which parts of the record disagree by more than their errors; sizes (P',)."""
    found = []
    for part, size in zip(parts, sizes, strict=True):
        if part.p * len(parts) < ODD and part.spread > _NOTICED_WITHIN * size:
            short = f"{part.furthest} alone would make it {part.to:.4g}"
            words = (
                f"Parts of the record contradict each other about {part.name} ({_chance(part.p)} "
                f"if the model is right): {short}. The model leaves something out."
            )
            found.append(Doubt(words, short, (part.name,)))
    return found


def misfits(
    problem: Problem, seen: Evaluation, known: Covariance, given: Sequence[bool], loss: Loss,
    train: np.ndarray,
) -> list[Doubt]:  # fmt: skip
    """Signals of which more is left than their noise, where that was given, or than a third.

    seen: of the experiments `train`. given: per signal, whether a person said its noise. What is
    left of the others cannot be compared with anything but the readings: more than 30 % of their
    scatter, and not white.
    """
    found = []
    for s, name in enumerate(problem.signals):
        tests = [own[s] for own in known.whiteness]
        used = problem.readings.used[train][:, s]
        r = seen.residuals[0][:, s][used]
        left = _size(r, loss)
        count = sum(t.count / t.inflation for t in tests)
        chance = float(stats.chi2.sf(count * left**2, count))
        share = left * problem.readings.noise[train[0], s] / _scatter(problem, train, s)
        if given[s] and left > _LEFT and chance < ODD:
            short = f"of {name} {left:.3g} times the noise that was given is left"
        elif share > _SHARE and not all(t.white for t in tests):
            short = f"of the scatter of {name} {100.0 * share:.3g} % is left, in a pattern"
        else:
            continue
        words = f"{short[0].upper()}{short[1:]}: the model is wrong, or that signal is."
        found.append(Doubt(words, short))
    return found


def _size(r: np.ndarray, loss: Loss) -> float:
    """Root mean square; where a robust loss lets wild readings be, that of the others."""
    if isinstance(loss, Squares):
        return float(np.sqrt(np.mean(r * r)))
    return float(np.median(np.abs(r)) / stats.norm.ppf(0.75))


def _scatter(problem: Problem, train: np.ndarray, s: int) -> float:
    """Standard deviation of one signal within the logs."""
    used = problem.readings.used[train][:, s]
    values = problem.readings.values[train][:, s]
    squares = [np.sum((v[m] - v[m].mean()) ** 2) for v, m in zip(values, used, strict=True)]
    return max(float(np.sqrt(np.sum(squares) / used.sum())), 1e-300)


def _chance(p: float) -> str:
    return f"chance {p:.1g}" if p > 1e-12 else "chance below 1e-12"


def wrong_units(problem: Problem, there: Evaluation, train: np.ndarray) -> list[Doubt]:
    """Readings that are some known factor times what the model gives: units, signs."""
    found = []
    for s, name in enumerate(problem.signals):
        used = problem.readings.used[train][:, s]
        values = problem.readings.values[train][:, s][used]
        left = (there.residuals[0][train][:, s] * problem.readings.noise[train][:, s, None])[used]
        model = values + left
        if not np.isfinite(model).all() or np.ptp(model) == 0.0 or np.ptp(values) == 0.0:
            continue
        a, b = model - model.mean(), values - values.mean()
        factor = float(a @ b / (a @ a))
        alike = float(a @ b / np.sqrt((a @ a) * (b @ b)))
        for known, words in _UNITS.items():
            if abs(alike) > 0.9 and abs(factor / known - 1.0) < 0.15:
                short = f"readings of {name} are {factor:.3g} times what the model gives"
                found.append(Doubt(f"{short[0].upper()}{short[1:]}: {words}?", short))
    return found
