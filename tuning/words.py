"""A tuning result in words: the verdict, what the limits cost, and how far to believe it."""

from __future__ import annotations

import math

import numpy as np

from jaxsim.hybrid import Exact
from jaxsim.objective import Goal
from jaxsim.status import Status
from tuning import working
from tuning.local import size
from tuning.result import Result, Verdict
from tuning.session import FULL, Session
from tuning.solver import CONVERGED
from tuning.spec import Free

# Fresh runs of the same model may differ from those of the search by rounding only.
_SAME = 1e-6
# The price of a limit is told for about this share of its bound.
_TOLD = 0.05
_UNITS = {
    "per_s": "1/s",
    "rad_s2": "rad s²",
    "rad_s": "rad s",
    "Nm": "Nm",
    "pct": "%",
    "deg": "deg",
    "dB": "dB",
    "rad": "rad",
    "J": "J",
    "Hz": "Hz",
    "s": "s",
}  # longest endings first


def unit_of(metric: str) -> str:
    """The unit at the end of a metric's name, as people write it; empty where it has none."""
    if metric.endswith("speed_rad_s"):
        return "rad/s"
    return next((unit for end, unit in _UNITS.items() if metric.endswith(f"_{end}")), "")


def quantity(value: float, metric: str) -> str:
    """A value with its unit, three digits; short times in ms."""
    unit = unit_of(metric)
    if unit == "s" and 0.0 < abs(value) < 0.1:
        value, unit = 1e3 * value, "ms"
    return f"{value:.3g} {unit}".rstrip()


def at_bound(f: Free, value: float) -> bool:
    """Whether a gain ended at one of its bounds."""
    return bool(min(value - f.lower, f.upper - value) <= 1e-6 * abs(value))


def sentences(session: Session, result: Result) -> list[str]:
    """The outcome: the verdict first, then goals, limits, evidence, and what was left out."""
    label = session.problem.label
    lines = [headline(result)]
    lines += [_goal(session, result, g) for g in session.spec.objective.goals]
    lines += [_limit(session, result, v) for v in result.verdicts]
    lines += [*working.sentences(result.check), _cost(session, result)]
    lines += [_certified(session, result), *_model(session, result)]
    lines += [f"Left out, {label(i)}: {why}." for i, why in session.excluded.items()]
    for k, c in np.argwhere(result.after.status):
        words = Status(int(result.after.status[k, c])).words
        lines.append(f"The tuned law fails on {label(int(result.drives[k]), c)}: {words}.")
    return lines


def headline(result: Result) -> str:
    """The verdict."""
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
    if result.status == "interrupted":
        names = " and ".join(v.limit.metric for v in result.verdicts if not v.holds)
        return f"No feasible law was found yet: {names} beyond the limit.{ended}"
    names = " and ".join(v.limit.metric for v in result.conflict)
    rule = "conflict" if len(result.conflict) > 1 else "cannot be kept"
    return f"NO FEASIBLE LAW was found: the limits on {names} {rule}; least violation met.{ended}"


def _ending(result: Result) -> str:
    return f"{result.status}, {result.reason}" if result.reason else result.status


def _goal(session: Session, result: Result, goal: Goal) -> str:
    before, after = (s.over(goal.metric, goal.over) for s in (result.before, result.after))
    change = f" ({100.0 * (after / before - 1.0):+.1f} %)" if 0.0 < before < np.inf else ""
    value, row, scenario = result.after.worst(goal.metric)
    over = goal.over if isinstance(goal.over, str) else f"{100.0 * goal.over:g} % quantile"
    worst = f", worst {value:.4g}" if goal.over != "worst" else ""
    where = session.problem.label(int(result.drives[row]), scenario)
    told = f"{goal.metric} ({over}): {before:.4g} -> {after:.4g} {unit_of(goal.metric)}".rstrip()
    return f"{told}{change}{worst} on {where}."


def _limit(session: Session, result: Result, v: Verdict) -> str:
    name = v.limit.words
    over = v.limit.over if isinstance(v.limit.over, str) else f"{100.0 * v.limit.over:g} % quantile"
    where = f"{v.value:.6g} ({over}, {session.problem.label(v.drive, v.scenario)})"
    if not v.holds:
        by = f"{100.0 * v.share:.2g} % too {'little' if v.limit.least else 'much'}"
        return f"{name} does NOT hold: {where}, {by}."
    if v.price > 0.0:
        return f"{name} holds and is active: {where}; {price(session, result, v)}."
    return f"{name} holds: {where}."


def price(session: Session, result: Result, v: Verdict) -> str:
    """What loosening an active limit would buy, to first order, from its multiplier."""
    more = _round(_TOLD * size(v.limit))
    saved, goals = more * v.price, session.spec.objective.goals
    cost = result.after.cost(session.spec.objective)
    if len(goals) == 1:
        what = f"{quantity(saved / goals[0].weight, goals[0].metric)} of {goals[0].metric}"
    else:
        what = f"{saved:.3g} of the cost"
    share = f" ({100.0 * saved / cost:.2g} %)" if cost > 0.0 else ""
    loose = "less" if v.limit.least else "more"
    return f"{quantity(more, v.limit.metric)} {loose} would buy {what}{share}, to first order"


def _round(value: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten, in the logarithm."""
    power = math.floor(math.log10(value))
    steps = [m * 10.0**power for m in (1.0, 2.0, 5.0, 10.0)]
    return min(steps, key=lambda s: abs(math.log(s / value)))


def _cost(session: Session, result: Result) -> str:
    dt, objective = session.study.run.dt, session.spec.objective
    before, after, finer = (s.cost(objective) for s in (result.before, result.after, result.finer))
    return (
        f"Cost {before:.6g} -> {after:.6g}, by fresh runs of the exact model at dt = {dt:g} s; "
        f"at dt = {0.5 * dt:g} s {finer:.6g}."
    )


def _certified(session: Session, result: Result) -> str:
    """The certificate in one sentence; every component that is not right by name."""
    where = " and ".join(session.problem.label(*case) for case in result.cases)
    told = ", ".join(f"{n} {verdict}" for verdict, n in result.certificate.counts.items())
    line = f"Gradients at this law against differences of exact runs, on {where}: {told}"
    doubtful = [c for c in result.certificate.components if c.verdict not in ("right", "zero")]
    named = dict.fromkeys(f"{c.metric} in {c.gain} {c.verdict}" for c in doubtful)
    return f"{line} ({', '.join(named)})." if named else f"{line}."


def _model(session: Session, result: Result) -> list[str]:
    """Where fresh runs say another cost than the search had."""
    spec = session.spec
    if session.stage == FULL and spec.working < spec.count:
        few = f"{spec.working} drives that stand for all in a mean"
        return [f"The search ran on {few}, {len(session.drives)} with those next to a limit."]
    again = result.after.cost(spec.objective)
    if session.stage != FULL or abs(again - result.searched) <= _SAME * abs(again):
        return []
    model = "" if isinstance(session.study.run.deadzone, Exact) else " (it was not exact)"
    return [f"The model of the search{model} gave {result.searched:.6g}, fresh runs {again:.6g}."]
