"""What a search has found: a law, scored afresh on the exact model, and whether its limits hold."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from jaxsim import batch
from jaxsim._simulate import simulate
from jaxsim.hybrid import Exact
from jaxsim.objective import Limit, Over, reduce
from jaxsim.status import Status
from jaxsim.study import Study
from tuning import space
from tuning.local import size
from tuning.session import FULL, Session
from tuning.solver import CONVERGED

# A limit whose multiplier is below this share of the cost does not hold the law back.
_IDLE = 1e-6
# Fresh runs of the same model may differ from those of the search by rounding only.
_SAME = 1e-6


class Scores(NamedTuple):
    """Metrics of one law: name -> (drives, scenarios, axes); status (drives, scenarios)."""

    values: dict[str, np.ndarray]
    status: np.ndarray

    def over(self, metric: str, over: Over) -> float:
        return float(reduce(self.values[metric].reshape(-1), over))

    def worst(self, metric: str) -> tuple[float, int, int]:
        """The value of largest size, with its sign, and its drive (by row) and scenario."""
        values = self.values[metric]
        sizes = np.where(np.isnan(values), -1.0, np.abs(values))
        row, scenario, axis = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        return float(values[row, scenario, axis]), int(row), int(scenario)


class Verdict(NamedTuple):
    """One limit at the end: value on the exact model, at half the step, worst drive and scenario.

    price: d cost/d bound as the search has it (nan if unknown); 0 where the limit is idle.
    """

    limit: Limit
    value: float
    finer: float
    drive: int
    scenario: int
    price: float

    @property
    def holds(self) -> bool:
        return max(self.value, self.finer) <= self.limit.most

    @property
    def share(self) -> float:
        """By what share of its bound it is exceeded."""
        return (max(self.value, self.finer) - self.limit.most) / size(self.limit)


class Result(NamedTuple):
    """A tuned law and its evidence.

    drives: indices of those scored, in every scenario. before, after: scores of the study's law
    and of the tuned one at the study's dt; finer: of the tuned one at dt/2, metrics of the
    objective only. searched: its cost as the search had it (on fewer drives if it was interrupted
    early).
    """

    law: Any
    gains: np.ndarray
    initial: np.ndarray
    drives: np.ndarray
    before: Scores
    after: Scores
    finer: Scores
    verdicts: tuple[Verdict, ...]
    searched: float
    status: str
    reason: str

    @property
    def feasible(self) -> bool:
        complete = not (self.after.status.any() or self.finer.status.any())
        return complete and all(v.holds for v in self.verdicts)

    @property
    def conflict(self) -> list[Verdict]:
        """The limits that stand against each other: exceeded, or pressing."""
        return [v for v in self.verdicts if not v.holds or v.price > 0.0]

    def cost(self, study: Study, scores: Scores) -> float:
        assert study.objective is not None
        return sum(g.weight * scores.over(g.metric, g.over) for g in study.objective.goals)


def conclude(session: Session) -> Result:
    """Score the study's law and the best one of a session on the exact model, by fresh runs."""
    study, spec, state = session.study, session.spec, session.best()
    gains = space.to_gains(spec.free, state.best)
    initial = space.gains_of(study.law, spec.free)
    drives = np.array([i for i in range(spec.count) if i not in session.excluded])
    metrics, dt = session.problem.metrics, study.run.dt
    with ThreadPoolExecutor(2) as pool:  # two programs, which compile side by side
        both = pool.submit(score, session, [initial, gains], drives, dt, None)
        half = pool.submit(score, session, [gains], drives, 0.5 * dt, metrics)
        before, after = both.result()
        (finer,) = half.result()
    prices = _prices(session)
    verdicts = tuple(
        _verdict(limit, price, after, finer, drives)
        for limit, price in zip(spec.objective.limits, prices, strict=True)
    )
    law = space.with_gains(study.law, spec.free, gains)
    status = "interrupted" if session.interrupted else state.status
    reason = "" if session.interrupted else state.reason
    assert state.best_local is not None
    return Result(
        law=law,
        gains=gains,
        initial=initial,
        drives=drives,
        before=before,
        after=after,
        finer=finer,
        verdicts=verdicts,
        searched=state.best_local.cost * session.unit,
        status=status,
        reason=reason,
    )


def score(
    session: Session, laws: list[np.ndarray], drives: np.ndarray, dt: float, metrics: Any
) -> list[Scores]:
    """Each law, given by its gains, on each drive in each scenario, on the exact model."""
    study, spec = session.study, session.spec
    table = np.repeat(np.array(laws), len(drives), axis=0)
    law = batch.spread(
        study.law, **{p: table[:, i] for i, f in enumerate(spec.free) for p in f.paths}
    )
    own = np.tile(session.problem.drives[drives], (len(laws), 1))
    drive = study.drive
    if spec.spreads:
        drive = batch.spread(drive, **{s.path: own[:, i] for i, s in enumerate(spec.spreads)})
    deadzone = study.run.deadzone
    runs = [
        simulate(
            drive,
            law,
            scenario,
            dt=dt,
            deadzone=deadzone if isinstance(deadzone, Exact) else Exact(),
            metrics=metrics,
            store=None,
            dtype=study.run.dtype,
            throw=False,
        )
        for scenario in study.scenarios.values()
    ]
    shape = (len(laws), len(drives), -1)
    status = np.stack([np.asarray(run.status).reshape(shape[:2]) for run in runs], axis=2)
    values = {
        name: np.stack([np.asarray(run.metrics[name], float).reshape(shape) for run in runs], 2)
        for name in runs[0].metrics
    }
    return [Scores({k: v[i] for k, v in values.items()}, status[i]) for i in range(len(laws))]


def _prices(session: Session) -> list[float]:
    """d cost/d bound of each limit, from the multipliers of the last step."""
    state, limits = session.best(), session.spec.objective.limits
    if state.step is None:
        return [np.nan] * len(limits)
    sums = [float(w.sum()) for w in state.step.limit_weights]
    return [
        total * session.unit / size(limit) if total > _IDLE else 0.0
        for total, limit in zip(sums, limits, strict=True)
    ]


def _verdict(
    limit: Limit, price: float, after: Scores, finer: Scores, drives: np.ndarray
) -> Verdict:
    values = after.values[limit.metric].max(axis=2)
    place = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    row, scenario = np.unravel_index(place, values.shape)
    there = after.over(limit.metric, limit.over), finer.over(limit.metric, limit.over)
    return Verdict(limit, *there, int(drives[row]), int(scenario), price)


def sentences(session: Session, result: Result) -> list[str]:
    """The outcome in words: the verdict first, then each limit, then what was left out."""
    label = session.problem.label
    lines = [_headline(result)]
    for v in result.verdicts:
        name = f"{v.limit.metric} <= {v.limit.most:g}"
        where = f"{v.value:.6g} ({v.limit.over}, {label(v.drive, v.scenario)})"
        if not v.holds:
            lines.append(f"{name} does NOT hold: {where}, {100.0 * v.share:.2g} % too much.")
        elif v.price > 0.0:
            gain = 0.01 * size(v.limit) * v.price
            lines.append(f"{name} holds and is active: {where}; 1 % more would save {gain:.3g}.")
        else:
            lines.append(f"{name} holds: {where}.")
    again = result.cost(session.study, result.after)
    if session.stage == FULL and not abs(again - result.searched) <= _SAME * abs(again):
        model = "" if isinstance(session.study.run.deadzone, Exact) else " (it was not exact)"
        lines.append(
            f"The model of the search{model} gave {result.searched:.6g}, fresh runs {again:.6g}."
        )
    lines += [f"Left out, {label(i)}: {why}." for i, why in session.excluded.items()]
    for k, c in np.argwhere(result.after.status):
        words = Status(int(result.after.status[k, c])).words
        lines.append(f"The tuned law fails on {label(int(result.drives[k]), c)}: {words}.")
    return lines


def _headline(result: Result) -> str:
    count, scenarios = result.after.status.shape
    drives = f"all {count} drives" if count > 1 else "the drive"
    drives += f" in {scenarios} scenarios" if scenarios > 1 else ""
    ended = "" if result.status == CONVERGED else f" The search ended early: {_ending(result)}."
    if result.feasible:
        kept = f"every limit holds on {drives}" if result.verdicts else "no limits were set"
        whole = f"Converged: {kept}" if result.status == CONVERGED else kept.capitalize()
        return f"{whole}.{ended}"
    broken = np.flatnonzero((result.after.status | result.finer.status).any(axis=1))
    if len(broken) and all(v.holds for v in result.verdicts):
        return f"NO FEASIBLE LAW was found: runs fail on {len(broken)} drives.{ended}"
    names = " and ".join(v.limit.metric for v in result.conflict)
    rule = "conflict" if len(result.conflict) > 1 else "cannot be kept"
    return f"NO FEASIBLE LAW was found: the limits on {names} {rule}; least violation met.{ended}"


def _ending(result: Result) -> str:
    return f"{result.status}, {result.reason}" if result.reason else result.status
