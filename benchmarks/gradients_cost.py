"""What gradients cost: time in forward runs, and memory, by number of parameters and of steps.

The bench, ITAE of 64 drives that differ in half_gap. Forward mode gives each drive's own
derivatives, reverse mode those of the mean. Memory is what the compiled programs of all cores set
aside for intermediate results.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import measuring
import numpy as np

import jaxsim
from envs.task import TASKS
from jaxsim import tree
from jaxsim.hybrid import Deadzone, Exact, Plain, Smoothed
from jaxsim.laws.policy import Layer, Network, Policy

MEMBERS = 64
# In the order in which they are taken: gains first, then the drive.
LAW = ("K_P", "K_D", "tau_D", "K_B")
DRIVE = ("J_M", "D_M", "K", "D_B", "J_L", "D_L")
OWN = len(LAW) + len(DRIVE)
FORWARD, REVERSE = (1, 4, 10, 32), (10, 32)
STEPS = (300, 3000, 30_000)
HIDDEN = 32
RUN = "forward run"

Costs = Callable[[Any], Any]


class Case(NamedTuple):
    """The costs of all drives as a function of some parameters, and their values."""

    costs: Costs
    values: Any


def bench(steps: int, deadzone: Deadzone, members: int = MEMBERS) -> Case:
    """The ten parameters, shared by all drives."""
    study = jaxsim.load("bench_switched")
    values = [tree.get(study.law, n) for n in LAW] + [tree.get(study.drive, n) for n in DRIVE]

    def costs(p: Any) -> Any:
        law = tree.replace(study.law, dict(zip(LAW, p[: len(LAW)], strict=True)))
        drive = tree.replace(study.drive, dict(zip(DRIVE, p[len(LAW) :], strict=True)))
        return _itae(drive, law, steps, deadzone, members)

    return Case(costs, jnp.asarray(values, float))


def _itae(drive: Any, law: Any, steps: int, deadzone: Deadzone, members: int = MEMBERS) -> Any:
    study = jaxsim.load("bench_switched")
    scenario = replace(study.scenario, duration=steps * study.run.dt)
    gaps = 7.8e-3 * np.linspace(0.8, 1.2, members)
    run = jaxsim.simulate(
        jaxsim.spread(drive, half_gap=gaps), law, scenario,
        dt=study.run.dt, deadzone=deadzone, metrics=("itae_rad_s2",), store=None,
    )  # fmt: skip
    return run.metrics["itae_rad_s2"]


def first(case: Case, count: int) -> Case:
    """The costs by their first parameters, each relative to its value.

    For more than there are, by as many directions in the space of all of them.
    """
    random = np.random.default_rng(0).normal(size=(OWN, count))
    directions = jnp.asarray(np.eye(count) if count <= OWN else random)

    def costs(q: Any) -> Any:
        moved = case.values[:count] * (1.0 + directions @ q)
        return case.costs(jnp.concatenate([moved, case.values[count:]]))

    return Case(costs, jnp.zeros(count))


def policy(steps: int) -> Case:
    """A trained law's weights, shared by all drives."""
    study, task = jaxsim.load("bench_switched"), TASKS.find("backlash_position_residual")()
    random, sizes = np.random.default_rng(0), (len(task.channels), HIDDEN, len(task.actions))
    layers = tuple(
        Layer(random.normal(0.0, 0.2, (b, a)), random.normal(0.0, 0.1, b))
        for a, b in itertools.pairwise(sizes)
    )
    network = Network(layers, np.zeros(sizes[0]), np.ones(sizes[0]))
    law = Policy(task.law(), network, task.channels, task.actions, task.period, task.duration)

    def costs(layers: Any) -> Any:
        own = eqx.tree_at(lambda v: v.network.layers, law, layers)
        return _itae(study.drive, own, steps, Exact())

    return Case(costs, jax.tree.map(jnp.asarray, layers))


def forward(case: Case) -> Costs:
    """All derivatives in one run."""
    return jax.jacfwd(case.costs)


def reverse(case: Case) -> Costs:
    return jax.grad(lambda p: jnp.mean(case.costs(p)))


class Program(NamedTuple):
    """A compiled function with its argument; memory of all cores, MB."""

    call: Callable[[], Any]
    memory: float


def compiled(function: Costs, values: Any, members: int = MEMBERS) -> Program:
    program = jax.jit(function).lower(values).compile()
    call = lambda: jax.block_until_ready(program(values))  # noqa: E731
    return Program(call, measuring.megabytes(program, members))


def counted(steps: int) -> Iterator[dict[str, Any]]:
    """Rows of one number of steps: both modes by number of parameters."""
    case = bench(steps, Exact())
    programs = {(RUN, 0): compiled(case.costs, case.values)}
    for mode, counts in ((forward, FORWARD), (reverse, REVERSE)):
        for count in counts:
            some = first(case, count)
            programs[f"{mode.__name__} mode", count] = compiled(mode(some), some.values)
    names = {f"{what}, {count}": (what, count) for what, count in programs}
    timings = measuring.interleaved({k: programs[v].call for k, v in names.items()})
    run = timings[f"{RUN}, 0"].best_s
    for name, (what, count) in names.items():
        spent = timings[name].best_s
        yield {
            "steps": steps, "what": what, "parameters": count, "ms": 1e3 * spent,
            "of a forward run": spent / run, "MB": programs[what, count].memory,
        }  # fmt: skip


def kinds() -> Iterator[dict[str, Any]]:
    """Rows of reverse mode over other modes, batches and parameters."""
    steps = STEPS[1]
    cases = {
        "exact": (bench(steps, Exact()), MEMBERS),
        "exact, 4096 drives": (bench(steps, Exact(), 4096), 4096),
        "exact, weights of a policy": (policy(steps), MEMBERS),
        "plain": (bench(steps, Plain()), MEMBERS),
        "smoothed": (bench(steps, Smoothed()), MEMBERS),
    }
    for what, (case, members) in cases.items():
        run = compiled(case.costs, case.values, members)
        back = compiled(reverse(case), case.values, members)
        timings = measuring.interleaved({"run": run.call, "back": back.call}, repeats=3)
        spent = timings["back"].best_s
        yield {
            "what": what, "parameters": sum(v.size for v in jax.tree.leaves(case.values)),
            "ms": 1e3 * spent, "of a forward run": spent / timings["run"].best_s,
            "MB per 64 drives": back.memory * MEMBERS / members,
        }  # fmt: skip


def main() -> None:
    jaxsim.configure()
    rows = [row for steps in measuring.progress(STEPS, "Gradients ...") for row in counted(steps)]
    tables = {"rows": rows, "reverse mode": list(kinds())}
    ratios = {
        f"forward run of {r['what']}, {r['parameters']}, {r['steps']}": 1.0 / r["of a forward run"]
        for r in rows
        if r["parameters"]
    }
    ratios |= {
        f"forward run of reverse mode, {r['what']}": 1.0 / r["of a forward run"]
        for r in tables["reverse mode"]
    }
    measuring.save("gradients_cost", tables, ratios)


if __name__ == "__main__":
    main()
