"""A tuning result in words: the verdict, what the limits cost, and how far to believe it."""

from __future__ import annotations

import math

import numpy as np

from jaxsim.hybrid import Exact
from jaxsim.metric import unit_of
from jaxsim.objective import Goal
from jaxsim.status import Status
from tuning import working
from tuning.conflict import Attained
from tuning.local import size
from tuning.result import Result, Verdict
from tuning.session import Session
from tuning.solver import CONVERGED, SPENT
from tuning.spec import Free

# Fresh runs of the same model may differ from those of the search by rounding only.
_SAME = 1e-6
# The price of a limit is told for about this share of its bound.
_TOLD = 0.05
# So many drives of a kind are named by their numbers.
_NAMED = 20


def quantity(value: float, metric: str, digits: int = 3) -> str:
    """A value with its unit; short times in ms."""
    unit = unit_of(metric)
    if unit == "s" and 0.0 < abs(value) < 0.1:
        value, unit = 1e3 * value, "ms"
    return f"{value:.{digits}g} {unit}".rstrip()


def at_bound(f: Free, value: float) -> bool:
    """Whether a gain ended at one of its bounds."""
    return bool(min(value - f.lower, f.upper - value) <= 1e-6 * abs(value))


def sentences(session: Session, result: Result) -> list[str]:
    """The outcome: the verdict first, then goals, limits, evidence, and what was left out."""
    label = session.problem.label
    lines = [headline(session, result), *_conflicts(result)]
    lines += [_goal(session, result, g) for g in session.spec.objective.goals]
    lines += [_limit(session, result, v) for v in result.verdicts]
    lines += [*working.sentences(result.check), _cost(session, result)]
    lines += [_certified(session, result), *_bounds(session, result), *_model(session, result)]
    lines += _left_out(session)
    for k, c in np.argwhere(result.after.status):
        words = Status(int(result.after.status[k, c])).words
        lines.append(f"The tuned law fails on {label(int(result.drives[k]), c)}: {words}.")
    return lines


def _left_out(session: Session) -> list[str]:
    """Drives that run under no law, by what is wrong with them; result.json has their values."""
    by_rule: dict[str, list[int]] = {}
    for index, why in session.excluded.items():
        by_rule.setdefault(why.partition("; got")[0], []).append(index)
    lines = []
    for rule, own in by_rule.items():
        own.sort()
        numbers = ", ".join(map(str, own[:_NAMED])) + (", ..." if len(own) > _NAMED else "")
        first = session.excluded[own[0]]
        lines.append(
            f"Left out, {len(own)} of {session.spec.count} drives ({rule}): {numbers}; "
            f"{session.problem.label(own[0])}: {first}."
        )
    return lines


def headline(session: Session, result: Result) -> str:
    """The verdict."""
    count, scenarios = result.after.status.shape
    drives = f"all {count} drives" if count > 1 else "the drive"
    if session.excluded:
        drives = f"{count} of {session.spec.count} drives, the others being impossible,"
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
        names = " and ".join(v.limit.metric for v in broken_limits(result))
        return f"No feasible law was found yet: {names} beyond the limit.{ended}"
    by = " and ".join(f"{v.limit.words} by {100.0 * v.share:.2g} %" for v in broken_limits(result))
    yet = " yet" if result.status == SPENT else ""
    return f"NO FEASIBLE LAW was found{yet}: the best one breaks {by}.{ended}"


def broken_limits(result: Result) -> list[Verdict]:
    return [v for v in result.verdicts if not v.holds]


def _conflicts(result: Result) -> list[str]:
    """Which limits are in each other's way, and how far each can be met."""
    told = [_attained(x, len(result.attained) > 1) for x in result.attained]
    if told:
        told.append("The law that is kept breaks its worst limit least; goals were set aside.")
    rivals = [x.limit.words for x in result.attained if x.others and x.share > 0.0]
    return [f"In conflict: {' and '.join(rivals)}.", *told] if len(rivals) > 1 else told


def _attained(x: Attained, several: bool) -> str:
    while_ = " while all other limits hold" if several else ""
    if not x.others:
        return f"Even without {x.limit.words} the other limits do not all hold."
    if x.share <= 0.0:
        return f"{x.limit.words} by itself can be kept{while_} on the drives looked at."
    too = "little" if x.limit.least else "much"
    least = quantity(x.value, x.limit.metric, 4)
    return f"{x.limit.words}: {least} is the best met{while_}, {100.0 * x.share:.2g} % too {too}."


def _ending(result: Result) -> str:
    ending = f"{result.status}, {result.reason}" if result.reason else result.status
    return f"{ending}; --resume goes on" if result.status == SPENT else ending


def _goal(session: Session, result: Result, goal: Goal) -> str:
    before, after = (s.aimed(goal) for s in (result.before, result.after))
    change = f" ({100.0 * (after / before - 1.0):+.1f} %)" if 0.0 < before < np.inf else ""
    value, row, scenario = result.after.worst(goal.metric, session.spec.objective)
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


def _bounds(session: Session, result: Result) -> list[str]:
    """Gains that their bounds stop."""
    pairs = zip(session.spec.free, result.gains, strict=True)
    names = [f.name for f, value in pairs if at_bound(f, value)]
    return [f"At a bound of [tune.free]: {', '.join(names)}."] if names else []


def _model(session: Session, result: Result) -> list[str]:
    """Where fresh runs say another cost than the search had."""
    spec = session.spec
    if session.final and spec.working < spec.count:
        few = f"{spec.working} drives that stand for all in a mean"
        return [f"The search ran on {few}, {len(session.drives)} with those next to a limit."]
    again = result.after.cost(spec.objective)
    if not session.final or abs(again - result.searched) <= _SAME * abs(again):
        return []
    model = "" if isinstance(session.study.run.deadzone, Exact) else " (it was not exact)"
    return [f"The model of the search{model} gave {result.searched:.6g}, fresh runs {again:.6g}."]
