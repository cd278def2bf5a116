"""The nominal case: the paper's drive and step, run with every law."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from envs.task import TASKS
from jaxsim._simulate import simulate
from jaxsim.components import read_json
from jaxsim.run import Run
from rl import store
from rl.study import Comparison

# What a law is judged by there, by the unit of the reference.
JUDGED = {
    "rad": (
        "first_impact_Nm",
        "braking_peak_Nm",
        "overshoot_pct",
        "settle_2pct_s",
        "itae_rad_s2",
    ),
    "Nm": ("torque_error_rms_Nm", "torque_overshoot_pct", "torque_settle_2pct_s"),
}


def case(study: Comparison) -> tuple[Any, Any]:
    """Its drive and scenario."""
    task = TASKS.find(study.task)(nominal=True)  # type: ignore[call-arg]
    episode = task.draw(jax.random.key(0), 0)
    return episode.drive, episode.scenario


def best_policies(study: Comparison, folder: Path) -> dict[str, Any]:
    """Of each agent the policy of the seed that was best on the validation episodes."""
    found = {}
    for name, specs in study.agents.items():
        results = {s.seed: read_json(folder / f"{name}-{s.seed}" / "result.json") for s in specs}
        best = min(results, key=lambda seed: results[seed]["validation_loss"])
        found[name] = store.read_policy(folder / f"{name}-{best}")
    return found


def run(laws: Mapping[str, Any], drive: Any, scenario: Any) -> dict[str, Run]:
    """One run of each law, with all signals and metrics."""
    return {name: simulate(drive, law, scenario, throw=False) for name, law in laws.items()}


def no_worse(found: Run, rival: Run, unit: str) -> bool:
    """Whether a run is no worse than another in all of `JUDGED`, to the last digit."""
    sizes = [tuple(abs(float(r.metrics[m])) for r in (found, rival)) for m in JUDGED[unit]]
    return all(a <= b for a, b in sizes)


def sentence(study: Comparison, folder: Path, name: str, rival: Run, unit: str) -> str:
    """How many seeds of each agent are no worse than a rival, the law of that name."""
    drive, scenario = case(study)
    counts = []
    for agent, specs in study.agents.items():
        policies = {str(s.seed): store.read_policy(folder / f"{agent}-{s.seed}") for s in specs}
        fine = [no_worse(r, rival, unit) for r in run(policies, drive, scenario).values()]
        counts.append(f"{agent} {sum(fine)} of {len(fine)}")
    metrics = ", ".join(JUDGED[unit])
    return f"Seeds no worse than {name} in the nominal case in all of {metrics}: " + (
        ", ".join(counts) + "."
    )


__all__ = ["JUDGED", "best_policies", "case", "no_worse", "run", "sentence"]
