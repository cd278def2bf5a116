"""Batches cut into chunks and spread over cores: the same numbers as one run by itself."""

from __future__ import annotations

from typing import Any

import bench
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsim import batch, tree
from jaxsim._simulate import simulate
from jaxsim.batch import Batch
from jaxsim.hybrid import Plain

METRICS = ("itae_rad_s2", "largest_torque_Nm")
GAPS = np.linspace(0.7, 1.3, 4096) * bench.PAPER.half_gap
MANY = 150  # more than one chunk on each of two cores
TURNS = 1e-12  # forward = reverse, and over cores = at once


def gaps(size: int) -> Batch:
    return batch.spread(bench.drive(), half_gap=GAPS[:size])


def run(drive: Any, duration: float = 0.05, **options: Any) -> Any:
    law, scenario = bench.law("switched"), bench.scenario(duration)
    return simulate(drive, law, scenario, metrics=METRICS, store=None, **options)


def numbers(found: Any) -> np.ndarray:
    return np.stack([np.asarray(found.metrics[name]) for name in METRICS])


@pytest.fixture(scope="module")
def all_of_them() -> np.ndarray:
    return numbers(run(gaps(4096)))


@pytest.mark.parametrize("lanes", [64, 256])
@pytest.mark.parametrize("cores", [1, 2, 3, 64])
def test_every_member_has_a_place_and_every_core_as_many(cores: int, lanes: int) -> None:
    for size in [*range(1, 700), 4096, 65536]:
        layout = batch._layout(size, cores, lanes)
        spare = layout.width * layout.cores + 16 * cores * (1 + size / lanes)
        assert size <= layout.padded < size + spare
        assert layout.padded % (layout.width * layout.cores) == 0
        assert 0 < layout.width <= lanes
        assert layout.width % 16 == 0
        assert 0 < layout.cores <= cores


@pytest.mark.parametrize("size", [*range(1, 67), 127, 128, 129, 500, 4096])
def test_members_keep_their_order_and_their_shared_leaves(size: int) -> None:
    own, shared = np.arange(float(size)), np.array([2.0, 3.0])
    members = Batch({"a": own, "b": shared}, (True, False), size)
    function = jax.jit(lambda: batch.map_members(lambda t: t["a"] * t["b"], members))
    assert np.array_equal(function(), own[:, None] * shared)


@pytest.mark.parametrize("size", [2, 65, MANY])
def test_a_member_is_the_same_in_every_batch(size: int, all_of_them: np.ndarray) -> None:
    assert np.array_equal(numbers(run(gaps(size))), all_of_them[:, :size])


def test_a_member_is_the_drive_alone(all_of_them: np.ndarray) -> None:
    for i in (0, 63, 64, 4095):
        alone = numbers(run(gaps(4096)[i]))
        assert alone == pytest.approx(all_of_them[:, i], rel=1e-13)


def test_bad_members_are_named_and_spoil_nothing(all_of_them: np.ndarray) -> None:
    values = GAPS[:MANY].copy()
    values[[3, 149]] = -1.0, np.nan
    found = run(batch.spread(bench.drive(), half_gap=values), throw=False)
    assert sorted(found.failures()) == [3, 149]
    good = np.delete(np.arange(MANY), [3, 149])
    assert np.array_equal(numbers(found)[:, good], all_of_them[:, good])


def test_results_lie_on_one_device_and_mix_with_any_other() -> None:
    metric = run(gaps(MANY)).metrics[METRICS[0]]
    assert len(metric.sharding.device_set) == 1
    assert (metric + jax.device_put(jnp.ones(MANY), jax.devices()[0])).shape == (MANY,)


def itae(drive: Any, gains: Any) -> Any:
    """Without location, whose reverse mode would compile three times as long."""
    law = tree.replace(bench.law("switched"), dict(zip(("K_P", "K_B"), gains, strict=True)))
    found = simulate(
        drive, law, bench.scenario(0.04), dt=5e-4, deadzone=Plain(), metrics=METRICS[:1],
        store=None, throw=False,
    )  # fmt: skip
    return found.metrics[METRICS[0]]


def summary(each: Any) -> Any:
    """The mean, which takes a sum over the cores, and two members' own numbers."""
    return jnp.stack([jnp.mean(each), each[3], each[MANY - 1]])


def test_a_users_jit_vmap_and_gradients_see_nothing_of_it() -> None:
    def cost(gains: Any) -> Any:
        return summary(itae(gaps(MANY), gains))

    def at_once(gains: Any) -> Any:
        def one(half_gap: Any) -> Any:
            return itae(tree.replace(bench.drive(), {"half_gap": half_gap}), gains)

        return summary(jax.vmap(one)(jnp.asarray(GAPS[:MANY])))

    gains = jnp.array([[bench.PAPER.K_P, bench.PAPER.K_B], [1.1 * bench.PAPER.K_P, -0.7]])
    forward = jax.jit(jax.vmap(jax.jacfwd(cost)))(gains)
    reverse = jax.jit(jax.jacrev(cost))(gains[0])
    expected = jax.jit(jax.vmap(jax.jacfwd(at_once)))(gains)
    size = np.abs(expected).max(axis=-1, keepdims=True)
    assert np.all(np.abs(forward - expected) <= TURNS * size)
    assert np.all(np.abs(reverse - expected[0]) <= TURNS * size[0])
