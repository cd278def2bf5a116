"""What puts a whole identification in doubt: logs that contradict each other, wrong units."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tuning.identification.residuals import Evaluation, Problem

_UNITS = {
    180.0 / np.pi: "degrees read as rad",
    np.pi / 180.0: "rad read as degrees",
    30.0 / np.pi: "rpm read as rad/s",
    -1.0: "opposite sign",
    1e3: "a factor of 1000",
    1e-3: "a factor of 1000",
}


class Alone(NamedTuple):
    """One shared unknown as each log alone gives it: values and standard errors (E,).

    p: the chance that logs of one machine differ so much.
    """

    name: str
    values: np.ndarray
    deviation: np.ndarray
    p: float


def contradiction(a: Alone) -> str:
    low, high = float(a.values.min()), float(a.values.max())
    return (
        f"The logs contradict each other about {a.name}: alone they give {low:.4g} to {high:.4g} "
        f"({_chance(a.p)} on one machine). Two machines, or a change between the logs?"
    )


def _chance(p: float) -> str:
    return f"chance {p:.1g}" if p > 1e-12 else "chance below 1e-12"


def wrong_units(problem: Problem, there: Evaluation, train: np.ndarray) -> list[str]:
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
                found.append(
                    f"{name}: readings are {factor:.3g} times what the model gives: {words}?"
                )
    return found
