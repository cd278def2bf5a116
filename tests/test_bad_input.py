"""A person's mistakes: one clear message, and nothing computed is lost."""

from __future__ import annotations

from functools import cache
from typing import Any

import bench
import numpy as np
import pytest

from jaxsim import batch, tree
from jaxsim._simulate import RunError, simulate
from jaxsim.batch import Batch
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact, Smoothed
from jaxsim.laws.pd import PD
from jaxsim.loads.inertia import Inertia
from jaxsim.motors.ideal import Ideal
from jaxsim.run import Run
from jaxsim.scenario import Scenario
from jaxsim.signals.step import Step
from jaxsim.signals.table import Table
from jaxsim.status import Status
from jaxsim.transmissions.backlash import Backlash

# With the one breakpoint 256 micro-steps: a run without room for events has none to spare.
DURATION = 0.051

BAD_PARTS = {
    "negative inertia": (lambda: Inertia(J_L=-1e-3), "Inertia.J_L", "must be > 0"),
    "no inertia": (lambda: Ideal(J_M=0.0), "Ideal.J_M", "must be > 0"),
    "nan": (lambda: Inertia(J_L=np.nan), "Inertia.J_L", "a number, not nan"),
    "infinite viscosity": (lambda: Ideal(J_M=1e-3, D_M=np.inf), "Ideal.D_M", "must be finite"),
    "negative gap": (lambda: Backlash(K=300.0, half_gap=-1e-3), "Backlash.half_gap", ">= 0"),
    "infinite gain": (lambda: PD(np.inf, 0.05, 6e-3), "PD.K_P", "must be finite"),
    "nan gain": (lambda: PD(10.0, np.nan, 6e-3), "PD.K_D", "a number, not nan"),
    "no filter": (lambda: PD(10.0, 0.05, 0.0), "PD.tau_D", "must be > 0"),
    "infinite damping": (lambda: bench.LinearDamping(-np.inf), "LinearDamping.K_B", "finite"),
    "no duration": (lambda: Scenario(Step(0.3), duration=0.0), "scenario.duration", "> 0 s"),
    "step that is nan": (lambda: Step(np.nan), "Step.size", "a number, not nan"),
    "samples out of order": (lambda: Table([0.0, 0.2, 0.1], [0.0] * 3), "Table.times", "increase"),
    "samples missing": (lambda: Table([0.0, 0.2], [0.0] * 3), "Table", "one length"),
    "no width": (lambda: Smoothed(width=0.0), "width", "must be > 0"),
    "negative room": (lambda: Exact(max_events=-1), "max_events", "must be >= 0"),
}


@pytest.mark.parametrize("name", BAD_PARTS)
def test_a_part_names_field_rule_value_and_fix(name: str) -> None:
    build, field, rule = BAD_PARTS[name]
    with pytest.raises(InputError) as caught:
        build()
    assert caught.value.field == field
    assert rule in caught.value.rule
    assert caught.value.fix


def _run(**options: Any) -> Run:
    given = {"metrics": ("first_impact_Nm",), "store": None} | options
    return simulate(bench.drive(), bench.law("linear"), bench.scenario(DURATION), **given)


BAD_RUNS: dict[str, tuple[dict[str, Any], str, str]] = {
    "dt that does not divide": ({"dt": 4e-4}, "dt", "must divide the duration 0.051 s"),
    "dt of zero": ({"dt": 0.0}, "dt", "must be > 0 s"),
    "dt longer than the run": ({"dt": 0.2}, "dt", "must divide the duration 0.051 s"),
    "dt that is nan": ({"dt": np.nan}, "dt", "must be > 0 s"),
    "storing every 0 ticks": ({"store": 0}, "store", "must be >= 1"),
}


@pytest.mark.parametrize("name", BAD_RUNS)
def test_a_run_that_cannot_be_set_up_is_refused_before_it_starts(name: str) -> None:
    options, field, rule = BAD_RUNS[name]
    with pytest.raises(InputError) as caught:
        _run(**options)
    assert caught.value.field == field
    assert rule in caught.value.rule


@pytest.mark.parametrize(
    ("duration", "dt", "fix"),
    [
        (0.3, 2.3e-4, "e.g. 0.0002"),
        (0.051, 4e-4, "e.g. 0.00034"),
        (0.1, 0.2, "e.g. 0.1"),
        (1.0 / 3.0, 1e-4, "e.g. 9.9980004e-05"),
    ],
)
def test_the_step_that_is_proposed_is_short_and_divides(
    duration: float, dt: float, fix: str
) -> None:
    with pytest.raises(InputError) as caught:
        Scenario(Step(0.3), duration=duration).ticks(dt)
    assert caught.value.fix == fix
    Scenario(Step(0.3), duration=duration).ticks(float(caught.value.fix.removeprefix("e.g. ")))


def test_unknown_names_come_with_the_nearest_ones() -> None:
    with pytest.raises(InputError, match="first_impact_Nm"):
        _run(metrics=("first_impct_Nm",))
    with pytest.raises(InputError, match="half_gap"):
        batch.spread(bench.drive(), half_gp=[1e-3, 2e-3])
    with pytest.raises(InputError, match="tau_D"):
        tree.get(bench.law("none"), "tau_d")


def test_batches_must_fit() -> None:
    gaps = batch.spread(bench.drive(), half_gap=[7e-3, 8e-3])
    gains = batch.spread(bench.law("linear"), K_B=[-0.8, -0.7, -0.6])
    with pytest.raises(InputError, match="must have one size"):
        simulate(gaps, gains, bench.scenario(DURATION))
    with pytest.raises(InputError, match="same components"):
        batch.stack([bench.law("linear"), bench.law("switched")])
    with pytest.raises(InputError, match="at least one"):
        batch.stack([])
    with pytest.raises(InputError, match="one common length"):
        batch.spread(bench.drive(), half_gap=[1e-3], K=[1.0, 2.0])


# Members of one batch: half_gap, J_L, K_P, K_B.
GOOD = {"half_gap": 7.8e-3, "J_L": 8.78e-4, "K_P": 10.0, "K_B": -0.8}
MEMBERS = {
    "good": {},
    "negative gap": {"half_gap": -1e-3},
    "other": {"half_gap": 6e-3},
    "nan inertia": {"J_L": np.nan},
    "infinite gain": {"K_P": np.inf},
    "diverges": {"K_B": 1e60},
    "last": {"K_B": -0.7},
}
SOUND = ("good", "other", "last")


def _members(members: list[dict[str, float]]) -> tuple[Batch, Batch]:
    values = [GOOD | m for m in members]
    drives = batch.spread(bench.drive(), **{n: [v[n] for v in values] for n in ("half_gap", "J_L")})
    laws = batch.spread(bench.law("linear"), **{n: [v[n] for v in values] for n in ("K_P", "K_B")})
    return drives, laws


def _batch(members: list[dict[str, float]], **options: Any) -> Run:
    drives, laws = _members(members)
    return simulate(
        drives, laws, bench.scenario(DURATION), metrics=("first_impact_Nm", "iae_rad_s"), **options
    )


@cache
def mixed() -> Run:
    return _batch(list(MEMBERS.values()), throw=False)


def test_impossible_members_spoil_no_others() -> None:
    """To the bit, of the same batch with sound members in their places."""
    clean = _batch([m if name in SOUND else {} for name, m in MEMBERS.items()])
    for i, name in enumerate(MEMBERS):
        if name in SOUND:
            assert int(mixed().status[i]) == Status.OK
            for key, values in (mixed().metrics | mixed().signals).items():
                right = (clean.metrics | clean.signals)[key]
                assert np.array_equal(values[i], right[i]), (name, key)


def test_failures_say_which_member_and_why() -> None:
    failures = mixed().failures()
    names = list(MEMBERS)
    assert {names[i] for i in failures} == {
        "negative gap", "nan inertia", "infinite gain", "diverges",
    }  # fmt: skip
    assert "half_gap: must be >= 0" in failures[names.index("negative gap")]
    assert "J_L: must be a number, not nan" in failures[names.index("nan inertia")]
    assert "K_P: must be finite; got inf" in failures[names.index("infinite gain")]
    assert "infinite" in failures[names.index("diverges")]
    assert int(mixed().status[names.index("diverges")]) == Status.DIVERGED
    for name in ("negative gap", "nan inertia"):
        assert np.isnan(mixed().metrics["first_impact_Nm"][names.index(name)])


def test_by_default_failures_raise_with_the_results_of_the_others_inside() -> None:
    with pytest.raises(RunError, match=r"member 1: .*half_gap") as caught:
        _batch(list(MEMBERS.values()))
    inside = caught.value.run
    assert float(inside.metrics["iae_rad_s"][0]) == float(mixed().metrics["iae_rad_s"][0])


def test_a_run_with_too_little_room_for_events_says_so_and_keeps_what_it_did() -> None:
    run = _run(deadzone=Exact(max_events=0), throw=False, store=1)
    assert int(run.status) == Status.EVENTS
    assert "max_events" in run.failures()[0]
    theta_M = np.asarray(run.signals["theta_M"])
    assert theta_M[60] > 0.0
    assert np.isnan(theta_M[-1])
    with pytest.raises(RunError, match="max_events"):
        _run(deadzone=Exact(max_events=0), store=1)
