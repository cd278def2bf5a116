"""The yardstick: classical laws with the papers' gains, and tuned on the agents' own cost."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import cma
import jax
import numpy as np

from envs.environment import Environment
from jaxsim import batch, tree
from jaxsim._simulate import simulate
from jaxsim.errors import InputError
from jaxsim.law import Control, Decentral
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.positive_feedback import PositiveFeedback
from jaxsim.study import load
from rl.episodes import training_keys

_EPISODES = 256  # that a law is tuned on
_SEED = 7
_SIGMA = 0.3  # first standard deviation of the logarithms of the gains
_WIDE = np.log(20.0)  # gains may become so much larger or smaller


class Rival(NamedTuple):
    """A classical law. gains: those that tuning may change, each with its largest value."""

    law: Control
    gains: dict[str, float]


class Tuned(NamedTuple):
    """law, its gains, the median cost that it was tuned to, and what that took."""

    law: Control
    gains: dict[str, float]
    cost: float
    runs: int
    cpu: float


def rivals(unit: str) -> dict[str, Rival]:
    """The classical laws of the papers, weakest first; the last one is to be tuned.

    unit: of the reference, rad (2018 paper) or Nm (2014 paper).
    """
    return {"rad": _position, "Nm": _torque}[unit]()


def _position() -> dict[str, Rival]:
    switched = load("bench_switched").law
    gains: dict[str, float] = dict.fromkeys(("K_P", "K_D", "tau_D", "cutoff", "K_B"), np.inf)
    return {
        "no damping": Rival(tree.replace(switched, {"K_B": np.asarray(0.0)}), {}),
        "linear damping": Rival(load("bench_linear_kb").law, {}),
        "switched damping": Rival(switched, gains),
    }


def _torque() -> dict[str, Rival]:
    leg = load("leg_torque")
    pi = Decentral((PITorque(2.0, 10.0),))
    gains: dict[str, float] = dict.fromkeys(("K_p", "K_i", "zero", "pole"), np.inf)
    gains |= dict.fromkeys(("alpha_j", "alpha_a", "alpha_v"), 1.0)
    return {
        "PI": Rival(pi, {}),
        "PI + positive feedback": Rival(pi + PositiveFeedback.design(leg.drive), {}),
        "PI + positive feedback + lead": Rival(leg.law, gains),
    }


def conditions(env: Environment, keys: Any) -> tuple[batch.Batch, batch.Batch]:
    """The drives and scenarios of the episodes of these keys."""
    state, _ = jax.jit(jax.vmap(env.reset))(keys)
    return _batch(state.loop.drive, len(keys)), _batch(state.loop.scenario, len(keys))


def _batch(members: Any, size: int) -> batch.Batch:
    return batch.Batch(members, (True,) * len(jax.tree.leaves(members)), size)


def run_law(env: Environment, law: Any, drives: Any, scenarios: Any) -> dict[str, np.ndarray]:
    """The cost, its terms, and the status of a law, per episode; exact mode.

    A run that fails costs what a failure costs an agent.
    """
    run = simulate(
        drives, law, scenarios, dt=env.dt, metrics=tuple(env.task.terms), store=None, throw=False
    )
    terms = {name: np.asarray(run.metrics[name], float) for name in env.task.terms}
    failed = np.asarray(run.status) != 0
    cost = np.where(failed, env.task.failure, np.asarray(env.task.cost(terms)))
    return {"cost": cost, **terms, "failed": failed}


def tune(env: Environment, rival: Rival, runs: int, tell: Callable[[int], None]) -> Tuned:
    """CMA-ES on the median cost of episodes that no agent is validated or tested on.

    Over the logarithms of the gains, from the paper's. It is the statistic that laws and agents
    are compared by: the tuned law is as strong a rival as its structure allows.
    """
    drives, scenarios = conditions(env, training_keys(_SEED, 0, _EPISODES))
    start = {name: float(tree.get(rival.law, name)) for name in rival.gains}
    if not start:
        raise InputError("rival", "must have gains to tune", "none", "choose another")
    began = time.process_time()

    def at(x: Any) -> dict[str, float]:
        factors = np.exp(np.asarray(x))
        values = {n: v * f for (n, v), f in zip(start.items(), factors, strict=True)}
        return {n: min(v, rival.gains[n]) for n, v in values.items()}

    def cost(x: Any) -> float:
        law = tree.replace(rival.law, {n: np.asarray(v) for n, v in at(x).items()})
        value = float(np.median(run_law(env, law, drives, scenarios)["cost"]))
        return value if np.isfinite(value) else env.task.failure

    options = {"seed": _SEED, "verbose": -9, "maxfevals": runs, "bounds": [-_WIDE, _WIDE]}
    search = cma.CMAEvolutionStrategy(np.zeros(len(start)), _SIGMA, options)
    while not search.stop():
        tried = search.ask()
        search.tell(tried, [cost(x) for x in tried])
        tell(search.countevals)
    gains = at(search.result.xbest)
    law = tree.replace(rival.law, {n: np.asarray(v) for n, v in gains.items()})
    took = time.process_time() - began
    return Tuned(law, gains, float(search.result.fbest), search.countevals, took)


__all__ = ["Rival", "Tuned", "conditions", "rivals", "run_law", "tune"]
