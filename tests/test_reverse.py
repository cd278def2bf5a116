"""Reverse mode over many parameters: forward mode's derivatives, in little memory."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import bench
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.task import TASKS
from jaxsim import batch, tree
from jaxsim._simulate import simulate
from jaxsim.hybrid import Deadzone, Exact, Plain, Smoothed
from jaxsim.laws.policy import Layer, Network, Policy

DT = 2e-4
MEMBERS = 64
GAPS = np.linspace(0.7, 1.3, MEMBERS) * bench.PAPER.half_gap
LAW = ("K_P", "K_D", "tau_D", "K_B")
DRIVE = ("J_M", "D_M", "K", "D_B", "J_L", "D_L")
SAME = 1e-10  # of the sum of the terms: forward mode adds up in another order
MB = 0.7  # for 64 drives and 3000 steps
ROOT = 2.1  # more memory for four times the steps; what does not grow is in it, too


def values() -> Any:
    return jnp.array([getattr(bench.PAPER, name) for name in (*LAW, *DRIVE)])


def cost(drive: Any, law: Any, steps: int, deadzone: Deadzone) -> Any:
    """The ITAE of a run; contact and switching are in it."""
    found = simulate(
        drive, law, bench.scenario(steps * DT), dt=DT, deadzone=deadzone,
        metrics=("itae_rad_s2",), store=None, throw=False,
    )  # fmt: skip
    return found.metrics["itae_rad_s2"]


def with_values(p: Any) -> tuple[Any, Any]:
    """Drive and law with the ten parameters."""
    law = tree.replace(bench.law("switched"), dict(zip(LAW, p[: len(LAW)], strict=True)))
    return tree.replace(bench.drive(), dict(zip(DRIVE, p[len(LAW) :], strict=True))), law


def of_all(steps: int, deadzone: Deadzone) -> Callable[[Any], Any]:
    """The costs of drives with gaps of their own, by parameters that they share."""

    def costs(p: Any) -> Any:
        drive, law = with_values(p)
        return cost(batch.spread(drive, half_gap=GAPS), law, steps, deadzone)

    return costs


def agree(gradient: Any, slope: Any, direction: Any) -> None:
    """The gradient along a direction is the slope that forward mode finds there."""
    terms = [
        np.ravel(g * d)
        for g, d in zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True)
    ]
    terms = np.concatenate(terms)
    assert np.isfinite(terms).all()
    assert np.count_nonzero(terms) > 0.9 * len(terms)
    assert abs(terms.sum() - slope) <= SAME * np.abs(terms).sum()


@pytest.mark.parametrize("deadzone", [pytest.param(Exact(), marks=pytest.mark.slow), Plain()])
def test_shared_parameters_have_forward_modes_derivatives(deadzone: Deadzone) -> None:
    costs, weights = of_all(500, deadzone), np.cos(np.arange(MEMBERS))
    rows = np.asarray(jax.jit(jax.jacfwd(costs))(values()))
    reverse = np.asarray(jax.jit(jax.grad(lambda p: costs(p) @ weights))(values()))
    size = np.abs(rows * weights[:, None]).sum(axis=0)
    assert np.all(size > 0.0)
    assert np.all(np.abs(reverse - weights @ rows) <= SAME * size)


def test_every_drive_has_its_own_and_one_that_is_none_spoils_no_other() -> None:
    factors = 1.0 + 0.2 * np.random.default_rng(0).uniform(-1.0, 1.0, (MEMBERS, 10))
    factors[3, LAW.index("tau_D")] = -1.0  # breaks its rule
    own = values()[None] * factors

    def costs(p: Any) -> Any:
        def one(values: Any, half_gap: Any) -> Any:
            drive, law = with_values(values)
            return cost(tree.replace(drive, {"half_gap": half_gap}), law, 250, Exact())

        return jax.vmap(one)(p, GAPS)

    def total(p: Any) -> Any:
        return jnp.nansum(costs(p))

    gradient = np.asarray(jax.jit(jax.grad(total))(own))
    # Members do not look at each other: one direction for all of them finds all slopes.
    found, slopes = jax.jit(lambda p, d: jax.jvp(costs, (p,), (d,)))(own, own)
    terms = gradient * np.asarray(own)
    fine = np.arange(MEMBERS) != 3
    assert np.isnan(found[3])
    assert np.all(np.count_nonzero(terms, axis=1)[fine] == 10)
    error = np.abs(terms.sum(axis=1) - slopes)
    assert np.all(error[fine] <= SAME * np.abs(terms).sum(axis=1)[fine])


@pytest.mark.parametrize("deadzone", [pytest.param(Exact(), marks=pytest.mark.slow), Smoothed()])
def test_the_weights_of_a_policy_have_forward_modes_derivatives(deadzone: Deadzone) -> None:
    task, random = TASKS.find("backlash_position_residual")(), np.random.default_rng(1)
    sizes = len(task.channels), 9, len(task.actions)

    def drawn() -> tuple[Layer, ...]:
        pairs = itertools.pairwise(sizes)
        return tuple(
            Layer(random.normal(0, 0.2, (b, a)), random.normal(0, 0.1, b)) for a, b in pairs
        )

    network = Network(drawn(), np.zeros(sizes[0]), np.ones(sizes[0]))
    policy = Policy(task.law(), network, task.channels, task.actions, task.period, task.duration)

    def mean(layers: Any) -> Any:
        law = eqx.tree_at(lambda p: p.network.layers, policy, layers)
        return jnp.mean(cost(batch.spread(bench.drive(), half_gap=GAPS), law, 250, deadzone))

    layers, direction = jax.tree.map(jnp.asarray, (network.layers, drawn()))
    gradient = jax.jit(jax.grad(mean))(layers)
    slope = jax.jit(lambda p, d: jax.jvp(mean, (p,), (d,))[1])(layers, direction)
    agree(gradient, slope, direction)


def mean(steps: int, deadzone: Deadzone) -> Callable[[Any], Any]:
    costs = of_all(steps, deadzone)
    return lambda p: jnp.mean(costs(p))


def compiled(steps: int, deadzone: Deadzone) -> tuple[Any, float]:
    """The compiled gradient, and the MB that it sets aside.

    The compiler tells that of one core, and there may be two.
    """
    program = jax.jit(jax.grad(mean(steps, deadzone))).lower(values()).compile()
    report = program.memory_analysis()
    assert report is not None
    return program, report.temp_size_in_bytes * min(2, jax.local_device_count()) / 1e6


def test_thousands_of_steps_keep_little_memory_and_all_of_the_derivative() -> None:
    """Left to itself, reverse mode keeps 6.2 MB of them."""
    program, memory = compiled(3000, Exact())
    assert memory < MB
    p = values()
    slope = jax.jit(lambda d: jax.jvp(mean(3000, Exact()), (p,), (d,))[1])(p)
    agree(program(p), slope, p)


def test_memory_grows_with_the_root_of_the_steps() -> None:
    assert compiled(16_000, Plain())[1] < ROOT * compiled(4000, Plain())[1]
