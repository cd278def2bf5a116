"""The certificate of a tuned law: its gradients and sensitivities against fresh exact runs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxsim._certify import STEPS, judge
from tuning import space
from tuning.local import localise
from tuning.problem import Outcome, Problem
from tuning.scoring import Scores

# Differences at these two steps (1e-4 and 1e-5 of a gain) must agree for a sensitivity to be told.
PAIR = (2, 3)
_AGREE, _SMALL = 0.02, 1e-3


class Case(NamedTuple):
    """A drive, by its index, in a scenario."""

    drive: int
    scenario: int


class Component(NamedTuple):
    """d metric/d gain in one case, SI (of several axes the sum).

    gradient: as the search had it. differences: central ones of runs on the exact model, one per
    relative step of `jaxsim._certify.STEPS`. error: of the gradient, times the size of the gain.
    verdict: right, zero, jumps or wrong as `gearlash certify` judges, or unchecked where the runs
    beside the gain fail.
    """

    metric: str
    gain: str
    case: Case
    gradient: float
    differences: tuple[float, ...]
    error: float
    verdict: str


class Sensitivity(NamedTuple):
    """Per cent of a metric per per cent of a gain in one case; nan where it has no such number.

    It has none where metric or gain is 0, or where differences at two steps disagree.
    """

    metric: str
    gain: str
    case: Case
    share: float


class Certificate(NamedTuple):
    """At the tuned law, for the study's drive and the worst case."""

    components: tuple[Component, ...]
    sensitivities: tuple[Sensitivity, ...]

    @property
    def counts(self) -> dict[str, int]:
        """How often each verdict was given, the most frequent first."""
        verdicts = [c.verdict for c in self.components]
        return {
            v: verdicts.count(v) for v in sorted(set(verdicts), key=lambda v: -verdicts.count(v))
        }


def cases(problem: Problem, outcome: Outcome, drives: np.ndarray) -> tuple[Case, ...]:
    """The study's drive in its first scenario, and the case that decides at a law.

    outcome: of one law on these drives. The deciding case is the worst of the limit that is
    nearest to its bound, or of the first goal where there is no limit.
    """
    objective, values = problem.spec.objective, outcome.values[0]
    local = localise(objective, problem.metrics, values, outcome.slopes[0])
    if objective.limits:
        nearest = objective.limits[int(np.argmax(local.excess))]
        first, sign = nearest.metric, nearest.sign
    else:
        first, sign = objective.goals[0].metric, 1.0
    own = sign * values[..., problem.metrics.index(first)]
    row, case = np.unravel_index(int(np.nanargmax(own)), own.shape)
    scenario = int(case) // (values.shape[1] // len(problem.scenarios))
    return tuple(dict.fromkeys([Case(int(drives[0]), 0), Case(int(drives[row]), scenario)]))


def scales(gains: np.ndarray) -> np.ndarray:
    """What relative steps are relative to: the size of a gain, or 1 SI unit where it is 0."""
    return np.where(gains == 0.0, 1.0, np.abs(gains))


def moved(gains: np.ndarray) -> np.ndarray:
    """(steps*P*2, P): each gain up and down by each of `STEPS`."""
    moves = np.array(STEPS)[:, None, None, None] * np.array([1.0, -1.0])[:, None]
    table = gains + moves * np.diag(scales(gains))[:, None, :]
    return table.reshape(-1, len(gains))


def certificate(
    problem: Problem,
    z: np.ndarray,
    outcome: Outcome,
    drives: np.ndarray,
    chosen: tuple[Case, ...],
    there: Scores,
    beside: list[Scores],
) -> Certificate:
    """Compare and tell.

    z (P,): the law on the unit cube; outcome: of it on these drives; there: its fresh scores on
    them; beside: per case the scores of `moved` gains on its drive.
    """
    gains = space.to_gains(problem.spec.free, z)
    slopes = outcome.slopes[0] / space.slope(problem.spec.free, z)
    components: list[Component] = []
    told: list[Sensitivity] = []
    for case, runs in zip(chosen, beside, strict=True):
        row = int(np.flatnonzero(drives == case.drive)[0])
        by_scenario = slopes[row].reshape(len(problem.scenarios), -1, *slopes.shape[2:])
        gradients = by_scenario[case.scenario].sum(axis=0)
        for at, metric in enumerate(problem.metrics):
            found = _differences(runs.values[metric][:, case.scenario].sum(axis=-1), gains)
            components += _components(problem, case, metric, gradients[at], found, gains)
        for metric, values in there.values.items():
            found = _differences(runs.values[metric][:, case.scenario].sum(axis=-1), gains)
            own = float(values[row, case.scenario].sum())
            told += _sensitivities(problem, case, metric, own, found, gains)
    return Certificate(tuple(components), tuple(told))


def _differences(values: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Central differences (steps, P) of the values (steps*P*2,) at `moved` gains."""
    pairs = values.reshape(len(STEPS), len(gains), 2)
    with np.errstate(invalid="ignore"):  # inf - inf: a metric that is never reached on both sides
        return (pairs[..., 0] - pairs[..., 1]) / (2.0 * np.array(STEPS)[:, None] * scales(gains))


def _components(
    problem: Problem,
    case: Case,
    metric: str,
    gradient: np.ndarray,
    differences: np.ndarray,
    gains: np.ndarray,
) -> list[Component]:
    norm = float(np.linalg.norm(gradient * scales(gains)))
    found = []
    for k, f in enumerate(problem.spec.free):
        own = differences[:, k]
        error, verdict = judge(float(gradient[k]), own.tolist(), float(scales(gains)[k]), norm)
        finite = np.isfinite(own)
        if not (finite[1:] & finite[:-1]).any():
            verdict = "unchecked"
        found.append(
            Component(metric, f.name, case, float(gradient[k]), tuple(own.tolist()), error, verdict)
        )
    return found


def _sensitivities(
    problem: Problem,
    case: Case,
    metric: str,
    value: float,
    differences: np.ndarray,
    gains: np.ndarray,
) -> list[Sensitivity]:
    with np.errstate(invalid="ignore", divide="ignore"):
        coarse, fine = differences[list(PAIR)] * gains / value
        same = np.abs(coarse - fine) <= _AGREE * np.maximum(abs(coarse), abs(fine)) + _SMALL
    told = np.where(same & np.isfinite(fine) & (gains != 0.0), fine, np.nan)
    return [
        Sensitivity(metric, f.name, case, float(share))
        for f, share in zip(problem.spec.free, told, strict=True)
    ]
