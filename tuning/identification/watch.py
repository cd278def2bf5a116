"""Wear: the same axis, log after log; trends with intervals, and a rule that raises an alarm."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from jaxsim.errors import InputError
from jaxsim.quantity import to_si
from jaxsim.study import Study
from tuning.identification import uncertainty
from tuning.identification.doubts import misfits
from tuning.identification.estimator import fit
from tuning.identification.mapping import check_loops, experiments
from tuning.identification.residuals import Evaluation, Problem
from tuning.identification.session import Tell
from tuning.identification.spec import Spec, read_free


class Trend(NamedTuple):
    """One unknown over the logs.

    values, deviation: (E,), nan where a fit failed. slope: change per log, with its standard error;
    p: the chance of such a slope where nothing changes. limit: of the alarm, nan if none. alarm:
    what is wrong in words, or "".
    """

    name: str
    unit: str
    values: np.ndarray
    deviation: np.ndarray
    slope: float
    slope_deviation: float
    p: float
    limit: float
    alarm: str


class Watch(NamedTuple):
    """All trends, the logs in their order, those whose fit failed, and what speaks against some."""

    logs: tuple[str, ...]
    trends: tuple[Trend, ...]
    failed: tuple[str, ...]
    doubts: tuple[str, ...]
    confidence: float


def watch(study: Study, spec: Spec, tell: Tell | None = None) -> Watch:
    """Fit every log of a study by itself, in their order, and look at what changes.

    Alarm: the whole interval of the last log lies above the limit of [identify.watch]; or the trend
    is sure (p < 1 - confidence) and reaches the limit within as many logs as there were.

    Raises: InputError for fewer than two logs, and for limits of what is not free.
    """
    tell = tell or (lambda what, progress: None)
    tell("reading logs", None)
    recorded, dt = experiments(study, spec)
    if len(recorded) < 2:
        got = f"{len(recorded)} logs"
        raise InputError("identify.experiments", "must be a sequence of logs", got, "add logs")
    check_loops(recorded, dt)
    count = len(recorded)
    # One column per unknown: each fit sees one log, so what is each log's own is no other matter.
    free = [f._replace(own=False) for f in read_free(spec, recorded[0].experiment)]
    problem = Problem([r.experiment for r in recorded], free, dt=dt)
    limits = _limits(study, problem)
    who = np.arange(count)[:, None]
    starts = np.tile(problem.initial(), (count, 1))
    loss = spec.search.loss
    found = fit(problem, starts, who=who, loss=loss, tell=lambda p: tell("fitting", p))
    seen = problem.evaluate(found.values, who=who)
    good = np.isfinite(found.loss)
    names = tuple(r.experiment.name for r in recorded)
    given = [spec.columns[s].noise is not None for s in problem.signals]
    deviation = np.full(found.values.shape, np.nan)
    doubts: list[str] = []
    for i in np.flatnonzero(good):
        known = uncertainty.covariance(problem, seen, found.values[i], loss, row=int(i), who=who[i])
        deviation[i] = known.deviation
        mine = Evaluation(*(v[i : i + 1] for v in seen))
        wrong = misfits(problem, mine, known, given, loss, who[i])
        doubts += [f"{names[i]}: {d.words}" for d in wrong]
    values = np.where(good[:, None], found.values, np.nan)
    trends = tuple(
        trend(f.name, f.unit, values[:, k], deviation[:, k], limits[k], spec.search.confidence)
        for k, f in enumerate(free)
    )
    failed = tuple(n for n, ok in zip(names, good, strict=True) if not ok)
    return Watch(names, trends, failed, tuple(doubts), spec.search.confidence)


def _limits(study: Study, problem: Problem) -> np.ndarray:
    given: dict[str, Any] = study.section("identify").get("watch", {})
    free = problem.unknowns.free
    names = [f.name for f in free]
    for name in given:
        if name not in names:
            raise InputError.unknown(f"identify.watch.{name}", name, names)
    return np.array(
        [
            float(to_si(given[f.name], f.unit, f"identify.watch.{f.name}"))
            if f.name in given
            else np.nan
            for f in free
        ]
    )


def trend(
    name: str, unit: str, values: np.ndarray, deviation: np.ndarray, limit: float,
    confidence: float,
) -> Trend:  # fmt: skip
    """The straight line through the logs' values, weighted by their errors, and the alarm.

    Errors are enlarged where the values scatter more than they say (chi^2 above its freedom).
    """
    good = np.isfinite(values) & np.isfinite(deviation)
    slope, spread, p = _line(np.flatnonzero(good), values[good], deviation[good])
    alarm = ""
    if np.isfinite(limit) and good.any():
        last = int(np.flatnonzero(good)[-1])
        half = float(stats.norm.ppf(0.5 + 0.5 * confidence)) * deviation[last]
        ahead = (limit - values[last]) / slope if slope > 0.0 else np.inf
        if values[last] - half > limit:
            alarm = f"{name} = {values[last]:.4g} {unit} is above {limit:.4g}, its interval too"
        elif p < 1.0 - confidence and 0.0 <= ahead <= good.sum():
            there = f"{limit:.4g} {unit} is reached in {ahead:.1f} logs"
            alarm = f"{name} rises by {slope:.3g} {unit} per log: {there}"
    return Trend(name, unit, values, deviation, slope, spread, p, limit, alarm)


def _line(at: np.ndarray, values: np.ndarray, deviation: np.ndarray) -> tuple[float, float, float]:
    if len(at) < 3:
        return float("nan"), float("nan"), 1.0
    weight = 1.0 / np.maximum(deviation, 1e-300) ** 2
    middle = np.sum(weight * at) / np.sum(weight)
    mean = np.sum(weight * values) / np.sum(weight)
    inertia = np.sum(weight * (at - middle) ** 2)
    slope = float(np.sum(weight * (at - middle) * (values - mean)) / inertia)
    left = values - mean - slope * (at - middle)
    freedom = len(at) - 2
    scatter = max(1.0, float(np.sum(weight * left**2)) / freedom)
    spread = float(np.sqrt(scatter / inertia))
    return slope, spread, float(2.0 * stats.t.sf(abs(slope) / spread, freedom))
