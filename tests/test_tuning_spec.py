"""The [tune] section: bounds, ties, sets of drives, and mistakes in them."""

from __future__ import annotations

import copy
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tuning_cases import study

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.errors import InputError
from jaxsim.study import Study, from_table, load
from tuning import space
from tuning.phase import phases
from tuning.problem import Problem
from tuning.scoring import score
from tuning.spec import read_spec


def test_bounds_are_the_ends_of_the_unit_cube_in_every_scale() -> None:
    free = read_spec(
        study(
            free={
                "K_B": {"lower": -2.0, "upper": -0.02},
                "K_P": {"lower": 2.0, "upper": 5.0},
                "tau_D": {"lower": "1 ms", "upper": "20 ms"},
            }
        )
    ).free
    assert [f.log for f in free] == [True, False, True]
    np.testing.assert_allclose(space.to_gains(free, np.zeros(3)), [-2.0, 2.0, 1e-3])
    np.testing.assert_allclose(space.to_gains(free, np.ones(3)), [-0.02, 5.0, 0.02])
    z = np.random.default_rng(0).random((5, 3))
    np.testing.assert_allclose(space.to_unit(free, space.to_gains(free, z)), z, atol=1e-12)
    h = 1e-6
    slopes = (space.to_gains(free, z + h) - space.to_gains(free, z - h)) / (2.0 * h)
    np.testing.assert_allclose(space.slope(free, z), slopes, rtol=1e-8)


def test_drives_are_a_seeded_latin_hypercube_with_the_study_first() -> None:
    what = study(drives={"count": 9, "spread": {"half_gap": "20 %", "J_L": [5e-4, 9e-4]}})
    drives = read_spec(what).drives
    np.testing.assert_array_equal(drives[0], [7.8e-3, 8.78e-4])
    shares = (drives[1:] - [0.8 * 7.8e-3, 5e-4]) / [0.4 * 7.8e-3, 4e-4]
    for column in shares.T:  # one in each of the eight strata
        assert sorted(np.floor(8.0 * column).astype(int)) == list(range(8))
    np.testing.assert_array_equal(drives, read_spec(what).drives)
    other = read_spec(what, seed=1).drives
    assert not np.array_equal(drives[1:], other[1:])


def test_the_screen_sees_drives_that_span_all() -> None:
    points = np.array(list(itertools.product([0.0, 0.5, 1.0], repeat=2)))
    chosen = space.spanning(points, 4)
    assert chosen[0] == 0
    corners = {(0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)}
    assert {tuple(p) for p in points[chosen]} == corners


def test_tied_parameters_move_together() -> None:
    what = study(free={"gain": {"of": ["K_P", "K_D"], "lower": 0.01, "upper": 30.0}})
    spec = read_spec(what)
    law = space.with_gains(what.law, spec.free, np.array([0.5]))
    assert float(tree.get(law, "K_P")) == float(tree.get(law, "K_D")) == 0.5


def test_a_tie_follows_by_factor_and_offset_in_every_way_to_write_it() -> None:
    bounds = {"lower": 3.0, "upper": 30.0}
    for text, factor, offset in (
        ("K_P / 200", 0.005, 0.0), ("0.005*K_P + 1e-3", 0.005, 1e-3),
        ("(K_P - 2) * 0.01 + 2 * K_P / 100", 0.03, -0.02), ("0.5 - K_P / 100", -0.01, 0.5),
    ):  # fmt: skip
        what = study(free={"K_P": bounds, "K_D": text})
        spec = read_spec(what)
        law = space.with_gains(what.law, spec.free, np.array([7.0]))
        assert [f.name for f in spec.free] == ["K_P"]
        assert float(tree.get(law, "K_P")) == 7.0
        assert float(tree.get(law, "K_D")) == pytest.approx(7.0 * factor + offset, rel=1e-14)


def test_what_follows_is_searched_with_what_it_follows() -> None:
    """The slope by the free one is that of a run in which both move."""
    what = study(
        free={"K_P": {"lower": 3.0, "upper": 30.0}, "K_D": "K_P / 200"},
        drives={}, limits={"largest_torque_Nm": 1.5},
    )  # fmt: skip
    spec = read_spec(what)
    problem, step = Problem(what, spec), 1e-4

    def by_hand(z: float) -> float:
        K_P = 3.0 * 10.0**z
        law = tree.replace(what.law, {"K_P": K_P, "K_D": K_P / 200.0})
        run = simulate(what.drive, law, what.scenario, metrics=("itae_rad_s2",), store=None)
        return float(run.metrics["itae_rad_s2"])

    found = problem.evaluate(np.array([[0.5]]), np.arange(1))
    assert found.values[0, 0, 0, 0] == pytest.approx(by_hand(0.5), rel=1e-9)
    slope = (by_hand(0.5 + step) - by_hand(0.5 - step)) / (2.0 * step)
    assert found.slopes[0, 0, 0, 0, 0] == pytest.approx(slope, rel=1e-5)
    (fresh,) = score(problem, [np.array([9.0])], np.arange(1), what.run.dt, ("itae_rad_s2",))
    assert fresh.values["itae_rad_s2"][0, 0, 0] == pytest.approx(by_hand(np.log10(3.0)), rel=1e-9)


# --- sets of drives -------------------------------------------------------------------------


def test_a_grid_is_every_combination_and_the_study_once() -> None:
    even, some = {"spread": "20 %", "points": 3}, ["8e-4 kg m^2", 1e-3]
    what = study(drives={"screen": 3, "grid": {"half_gap": even, "J_L": some}})
    spec = read_spec(what)
    gaps = [0.8 * 7.8e-3, 7.8e-3, 1.2 * 7.8e-3]
    wanted = [(7.8e-3, 8.78e-4), *itertools.product(gaps, [8e-4, 1e-3])]
    np.testing.assert_allclose(spec.drives, wanted, rtol=1e-12)
    assert [(s.name, s.lower, s.upper) for s in spec.spreads][1] == ("J_L", 8e-4, 1e-3)
    # The study's own drive, met again in the middle of a grid, stays one.
    again = read_spec(study(drives={"grid": {"half_gap": even, "K": even}}))
    assert again.count == 9
    assert Problem(what, spec).label(1).startswith("drive 1 (half_gap=0.00624, J_L=0.0008)")


CSV = "half_gap [mrad],J_L\n7.1,8e-4\n8.2,9e-4\n"
TOML = '[[drive]]\nhalf_gap = "7.1 mrad"\nJ_L = 8e-4\n[[drive]]\nJ_L = 9e-4\nhalf_gap = 8.2e-3\n'


@pytest.mark.parametrize("form", ["inline", "measured.csv", "measured.toml"])
def test_a_list_of_drives_is_the_study_and_each_of_them(form: str, tmp_path: Path) -> None:
    (tmp_path / "measured.csv").write_text(CSV)
    (tmp_path / "measured.toml").write_text(TOML)
    inline = [{"half_gap": "7.1 mrad", "J_L": 8e-4}, {"half_gap": 8.2e-3, "J_L": 9e-4}]
    what = study(drives={"list": inline if form == "inline" else form})._replace(folder=tmp_path)
    spec = read_spec(what)
    wanted = [(7.8e-3, 8.78e-4), (7.1e-3, 8e-4), (8.2e-3, 9e-4)]
    np.testing.assert_allclose(spec.drives, wanted, rtol=1e-12)
    assert spec.screen == 3


def late(drives: dict[str, Any]) -> Study:
    """A sampled law without damping, up to the first impact; its study has no delay."""
    table = copy.deepcopy(load("bench_sampled").table)
    table["law"] |= {"delay": 0.0, "sensors": {"type": "true_speeds"}}
    table["law"]["law"]["law"][1] = {"type": "linear_damping", "K_B": 0.0}
    table["scenario"]["duration"] = 0.03
    table["objective"] = {"minimise": {"first_contact_s": 1.0, "entry_speed_rad_s": 1.0}}
    table["tune"] = {"free": {"K_P": {"lower": 5.0, "upper": 20.0}}, "drives": drives}
    return from_table(table, Path(), "late")


DELAYS = ["0 us", "600 us"]


@pytest.mark.parametrize(
    "drives",
    [
        {"grid": {"half_gap": [7e-3, 8e-3], "delay": DELAYS}},
        {"list": [{"half_gap": g, "law.delay": d} for g in (7e-3, 8e-3) for d in DELAYS]},
        {"count": 9, "spread": {"half_gap": "20 %", "delay": DELAYS}},
    ],
)
def test_a_delay_that_differs_moves_the_first_contact_by_itself(drives: dict[str, Any]) -> None:
    """Before it the load rests and the law feeds nothing back: all is the same, only later."""
    what = late(drives)
    spec = read_spec(what)
    problem = Problem(what, spec)
    delays = spec.drives[:, 1]
    np.testing.assert_allclose(delays, 2e-4 * np.round(delays / 2e-4), atol=1e-12)
    assert len(np.unique(delays)) == len(problem.laws) > 1
    prompt = Problem(what, spec._replace(drives=spec.drives * [1.0, 0.0]))
    z, every = space.to_unit(spec.free, np.array([[8.0], [12.0]])), np.arange(spec.count)
    now, later = (p.evaluate(z, every, slopes=False).values[:, :, 0] for p in (prompt, problem))
    np.testing.assert_allclose(later[..., 0], now[..., 0] + delays, rtol=1e-9)
    np.testing.assert_allclose(later[..., 1], now[..., 1], rtol=1e-9)
    scored = score(problem, [np.array([12.0])], every, what.run.dt, problem.metrics)[0]
    np.testing.assert_allclose(scored.values["first_contact_s"][:, 0, 0], later[1, :, 0], rtol=1e-9)
    if "grid" in drives:
        outcome = problem.evaluate(z, every)
        np.testing.assert_allclose(outcome.values[:, :, 0], later, rtol=1e-9)
        step = np.array([[1e-4]])
        up, down = (problem.evaluate(z + s * step, every, slopes=False).values for s in (1, -1))
        np.testing.assert_allclose(outcome.slopes[..., 0], (up - down) / 2e-4, rtol=1e-5)


@pytest.mark.parametrize(
    ("drives", "message"),
    [
        ({"grid": {"delay": ["100 us"]}}, r"grid\.delay: must be a multiple of dt"),
        ({"grid": {"delay": ["-200 us"]}}, r"grid\.delay: must be >= 0"),
        ({"grid": {"delay": [{"K": 1}]}}, r"grid\.delay"),
        ({"list": [{"delay": ["0 us", "200 us"]}]}, r"list\[0\]\.delay: must be one number"),
        ({"count": 5, "spread": {"delay": ["0 us", "300 us"]}}, r"delay: must be a multiple of dt"),
        ({"count": 5, "spread": {"delay": ["0 s", "1 s"]}}, r"delay: must be at most 32 periods"),
    ],
)
def test_delays_that_a_sampled_law_cannot_have(drives: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_spec(late(drives))
    with pytest.raises(InputError, match="needs a sampled law"):
        read_spec(study(drives=drives))


@pytest.mark.parametrize(
    ("drives", "message"),
    [
        ({"grid": {"K": [200.0]}, "spread": {"K": "5 %"}}, "must name one set"),
        ({"grid": {"K": [200.0]}, "count": 3}, r"drives\.count: must follow from grid"),
        ({"grid": {"K": {"spread": "5 %", "points": 1}}}, r"grid\.K\.points: must be greater"),
        ({"grid": {"K": 200.0}}, r"grid\.K: must be a list of values"),
        ({"grid": {"KK": [1.0]}}, r"grid\.KK: .*K"),
        ({"grid": {"K": list(range(1, 999)), "J_L": list(range(1, 999))}}, "at most 100000 drives"),
        ({"list": [{"K": 200.0}, {"J_L": 1e-3}]}, r"list\[1\]: must name the same"),
        ({"list": [{"K": "5 kg"}]}, r"list\[0\]\.K: must be convertible"),
        ({"list": "none.csv"}, r"none\.csv: must be a file"),
        ({"list": []}, "must be a list of drives"),
        ({"gird": {"K": [200.0]}}, "did you mean grid"),
    ],
)  # fmt: skip
def test_mistakes_in_sets_of_drives(drives: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_spec(study(drives=drives))


@pytest.mark.parametrize(
    ("tune", "message"),
    [
        ({"free": {"K_Bee": {"lower": -1.0, "upper": 0.0}}}, r"tune\.free\.K_Bee: .*K_B"),
        ({"free": {"K_B": {"lower": 0.0, "upper": -1.0}}}, r"tune\.free\.K_B: .*lower < upper"),
        ({"free": {"tau_D": {"lower": 0.0, "upper": 1.0}}}, r"tau_D\.lower: must be > 0"),
        ({"free": {"K_B": {"lower": -1.0}}}, r"tune\.free\.K_B\.upper: must be given"),
        ({"free": {"K_B": {"lower": -1.0, "upper": 1.0, "scale": "log"}}}, "of one sign"),
        ({"free": {"tau_D": {"lower": "1 m", "upper": "2 s"}}}, r"tau_D\.lower: .*convertible"),
        ({"free": {}}, "must name a parameter"),
        ({"free": {"K_D": "2 * K_P"}}, r"free\.K_D: .*K_P"),
        ({"free": {"K_P": {"lower": 1.0, "upper": 2.0}, "K_D": "K_P * K_P"}}, "times one free"),
        ({"free": {"K_P": {"lower": 1.0, "upper": 2.0}, "K_D": "open(1)"}}, "times one free"),
        ({"free": {"K_P": {"lower": 1.0, "upper": 2.0}, "tau_D": "K_P - 1"}}, r"at K_P\.lower"),
        ({"free": {"K_P": {"lower": 1.0, "upper": 2.0, "of": ["K_P", "K_P"]}}}, "each parameter o"),
        ({"start": 3}, "did you mean starts"),
        ({"starts": 0}, r"tune\.starts: must be greater"),
        ({"drives": {"count": 4, "spread": {"half_gab": "20 %"}}}, "half_gap"),
        ({"drives": {"count": 4, "spread": {"K": 0.2}}}, r"spread\.K: must be relative"),
        ({"drives": {"count": 4, "spread": {"K": "-5 %"}}}, "must be > 0 %"),
        ({"drives": {"count": 4}}, "both count > 1 and spread"),
        ({"drives": {"check": 4}}, r"drives\.check: needs a spread"),
    ],
)
def test_mistakes_in_the_study_are_one_clear_message(tune: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_spec(study(**tune))


def test_a_working_set_with_a_limit_on_a_quantile_is_refused() -> None:
    limits: Any = {"largest_torque_Nm": {"most": 1.5, "over": 0.9}}
    drives = {"count": 8, "working": 2, "spread": {"K": "5 %"}}
    with pytest.raises(InputError, match="needs limits on the worst case"):
        read_spec(study(limits=limits, drives=drives))


def test_smoothed_models_come_first_and_the_last_phase_is_on_the_models_own() -> None:
    what = study(smoothing=["3 mrad", 1e-3], solver="sqp")
    found = phases(what, read_spec(what))
    assert [getattr(p.deadzone, "width", None) for p in found] == [3e-3, 1e-3, None]
    assert found[-1].deadzone == what.run.deadzone
    with pytest.raises(InputError, match=r"tune\.smoothing: must be > 0"):
        read_spec(study(smoothing=[0.0]))
    with pytest.raises(InputError, match="sqp"):
        read_spec(study(solver="sqq"))
