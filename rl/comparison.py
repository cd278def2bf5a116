"""Agents and classical laws on the same episodes: medians, intervals, wins, what they took."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from envs.environment import Environment, build
from jaxsim.components import read_json
from jaxsim.law import as_joint_law
from jaxsim.status import Status
from rl import store
from rl.classical import Rival, Tuned, conditions, rivals, run_law, tune
from rl.episodes import score, unseen_keys
from rl.study import Comparison

_RESAMPLED = 2000
_LEVEL = 95.0  # of the intervals, %
TUNED = "tuned"


class Entry(NamedTuple):
    """One contestant. numbers: per metric (seeds, episodes), `cost` first; failed: likewise.

    learned: whether it was trained. steps, cpu: per seed, zero for laws that are not tuned.
    """

    name: str
    learned: bool
    numbers: dict[str, np.ndarray]
    failed: np.ndarray
    steps: np.ndarray
    cpu: np.ndarray


class Line(NamedTuple):
    """One line of the table; every number is of all seeds and episodes.

    median: the median over seeds of the median cost over episodes; low, high: its 95 % interval;
    ratio: to the tuned law's; wins: share of episodes on which each metric is less than its.
    """

    name: str
    learned: bool
    median: float
    low: float
    high: float
    ratio: float
    ratio_low: float
    ratio_high: float
    failed: float
    medians: dict[str, float]
    wins: dict[str, float]
    steps: float
    cpu: float


def unit_of(env: Environment) -> str:
    """Unit of the reference: rad or Nm."""
    return as_joint_law(env.task.law(), 1).reference_unit or "rad"


def classical(env: Environment, study: Comparison) -> tuple[list[Entry], dict[str, Any], Rival]:
    """The classical laws of a task on the test episodes; their laws; and the one to tune."""
    drives, scenarios = conditions(env, unseen_keys(study.episodes))
    entries, laws, last = [], {}, None
    for name, last in rivals(unit_of(env)).items():
        entries.append(_entry_of_law(name, run_law(env, last.law, drives, scenarios), 0, 0.0))
        laws[name] = last.law
    assert last is not None
    return entries, laws, last


def tuned(
    env: Environment, study: Comparison, rival: Rival, tell: Callable[[int], None]
) -> tuple[Entry, Tuned]:
    """The last classical law, tuned on the same cost, on the test episodes."""
    found = tune(env, rival, study.tuning, tell)
    drives, scenarios = conditions(env, unseen_keys(study.episodes))
    steps = found.runs * 256 * env.steps
    return _entry_of_law(TUNED, run_law(env, found.law, drives, scenarios), steps, found.cpu), found


def _entry_of_law(name: str, numbers: dict[str, np.ndarray], steps: int, cpu: float) -> Entry:
    failed = numbers.pop("failed")[None]
    rows = {key: value[None] for key, value in numbers.items()}
    return Entry(name, False, rows, failed, np.array([float(steps)]), np.array([cpu]))


def agents(study: Comparison, folder: Path) -> list[Entry]:
    """The trained policies on the test episodes, in their environments: noise, delay, encoders."""
    keys, entries = unseen_keys(study.episodes), []
    for name, specs in study.agents.items():
        env = build(specs[0].task)
        results, scores = [], []
        for spec in specs:
            own = folder / f"{name}-{spec.seed}"
            results.append(read_json(own / "result.json"))
            policy = store.read_policy(own)
            store.law_of(env, policy.network)  # does it fit the task's observations?
            scores.append(score(env, policy.network, keys))
        failed = np.stack([s.status != Status.OK.value for s in scores])
        rows = {"cost": np.stack([s.cost for s in scores])}
        rows["cost"] = np.where(failed, env.task.failure, rows["cost"])
        rows |= {key: np.stack([s.numbers[key] for s in scores]) for key in env.task.terms}
        steps, cpu = (np.array([r[key] for r in results], float) for key in ("steps", "cpu_s"))
        entries.append(Entry(name, True, rows, failed, steps, cpu))
    return entries


def table(entries: list[Entry]) -> list[Line]:
    """The lines of the table, the least cost first."""
    yardstick = next(e for e in entries if e.name == TUNED)
    return sorted((_line(e, yardstick) for e in entries), key=lambda line: line.median)


def _line(entry: Entry, yardstick: Entry) -> Line:
    cost, other = entry.numbers["cost"], yardstick.numbers["cost"]
    medians, ratios = _resampled(cost, other)
    low, high = _interval(medians)
    ratio_low, ratio_high = _interval(ratios)
    median = _middle(cost)
    wins = {key: float(np.mean(v < yardstick.numbers[key])) for key, v in entry.numbers.items()}
    middles = {key: _middle(v) for key, v in entry.numbers.items()}
    effort = float(np.mean(entry.steps)), float(np.mean(entry.cpu))
    ratio = median / _middle(other)
    failed = float(np.mean(entry.failed))
    interval = median, low, high, ratio, ratio_low, ratio_high
    return Line(entry.name, entry.learned, *interval, failed, middles, wins, *effort)


def _middle(values: np.ndarray) -> float:
    """The median over seeds of the medians over episodes."""
    return float(np.median(np.median(values, axis=1)))


def _resampled(cost: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians, and ratios to those of the yardstick, of resampled seeds AND episodes.

    The same episodes for both, so that the ratio's interval does not hold what they share.
    """
    random = np.random.default_rng(0)
    medians, ratios = np.empty(_RESAMPLED), np.empty(_RESAMPLED)
    seeds, episodes = cost.shape
    for i in range(_RESAMPLED):
        row = random.integers(0, seeds, seeds)
        column = random.integers(0, episodes, episodes)
        medians[i] = _middle(cost[row][:, column])
        ratios[i] = medians[i] / _middle(other[:, column])
    return medians, ratios


def _interval(values: np.ndarray) -> tuple[float, float]:
    rest = 0.5 * (100.0 - _LEVEL)
    low, high = np.percentile(values, [rest, 100.0 - rest])
    return float(low), float(high)


def sentences(lines: list[Line]) -> list[str]:
    """Where learning pays and where it does not, in words; the verdict first."""
    learned = [line for line in lines if line.learned]
    yardstick = next(line for line in lines if line.name == TUNED)
    tuned_text = f"the tuned law ({yardstick.median:.3g}, {yardstick.cpu:.0f} CPU s)"
    pays = [line for line in learned if line.ratio_high < 1.0]
    words = []
    if pays:
        best = pays[0]
        words.append(
            f"Learning pays: {best.name} costs {best.ratio:.3g} ({best.ratio_low:.3g} to "
            f"{best.ratio_high:.3g}) of {tuned_text}."
        )
    else:
        words.append(f"Learning does not pay here: no agent is surely better than {tuned_text}.")
    for line in learned:
        if line not in pays:
            words.append(
                f"{line.name} does not pay: {line.ratio:.3g} ({line.ratio_low:.3g} to "
                f"{line.ratio_high:.3g}) of the tuned law after {line.cpu:.0f} CPU s per seed."
            )
    for line in pays:
        lost = [key for key, share in line.wins.items() if share < 0.5]
        if lost:
            words.append(
                f"{line.name} loses to the tuned law in most episodes on {', '.join(lost)}."
            )
    return words


__all__ = [
    "TUNED",
    "Entry",
    "Line",
    "agents",
    "classical",
    "sentences",
    "table",
    "tuned",
    "unit_of",
]
