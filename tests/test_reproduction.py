"""The reproduction of the 2018 paper, judged by the oracle and by the errata's numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import bench
import numpy as np
import oracle
import pytest
from rich.console import Console
from test_reproduction_2014 import KNOWN_DISAGREEMENTS as OF_2014

from jaxsim import findings_report
from jaxsim.commands.reproduce import _chosen, _reproduce, command
from jaxsim.errors import InputError
from jaxsim.findings import GROUPS, Findings, Group, Row, against_paper, measured
from jaxsim.reproduction import _bench_2018, free
from jaxsim.reproduction.limit_cycle import contraction

KINDS: tuple[oracle.Law, ...] = ("none", "linear", "switched")
# What the step of the reproduction, 1e-4 s, is good for.
RELATIVE = 1e-5
LOADS = ((0.010, -0.50), (0.15, 1.0))
KNOWN_DISAGREEMENTS = {
    "claim.impact_reduction_linear",
    "claim.overshoot_same_switched",
    "claim.exact_model_negligible_cycle",
}


def _rows(name: str) -> dict[str, Row]:
    return {row.id: row for row in GROUPS.find(name)().find().rows}


# --- numbers --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def step() -> dict[str, Row]:
    return _rows("step")


@pytest.mark.parametrize("kind", KINDS)
def test_step_agrees_with_the_oracle(step: dict[str, Row], kind: oracle.Law) -> None:
    truth = oracle.solve(oracle.Params(), kind, duration=1.2).metrics()
    compared = [(name, f"step.{kind}.{ours}") for name, ours in bench.SAME.items()]
    compared = [(name, id) for name, id in compared if id in step]
    assert len(compared) >= 15
    for name, id in compared:
        assert step[id].value == pytest.approx(truth[name], rel=RELATIVE), id


def test_every_judged_number_of_the_step_holds(step: dict[str, Row]) -> None:
    judged = [row for row in step.values() if row.ok is not None]
    assert {row.id for row in judged if not row.ok} <= KNOWN_DISAGREEMENTS
    assert step["step.linear.impact_reduction_pct"].value == pytest.approx(42.74, abs=0.005)
    assert step["claim.impact_reduction_linear"].paper == 44.0


@pytest.mark.parametrize("kind", KINDS)
def test_disturbance_agrees_with_the_oracle(kind: oracle.Law) -> None:
    rows = _rows("disturbance")
    # Near complete rest the switched law toggles on rounding in the oracle: stop before.
    duration = 0.4 if kind == "switched" else 1.2

    def solve(sign: float) -> oracle.Metrics:
        loads = [(t, sign * torque) for t, torque in LOADS]
        run = oracle.solve(oracle.Params(), kind, step=0.0, loads=loads, duration=duration)
        return run.metrics()

    truth = solve(1.0)
    expected = {
        "first_contact_s": truth["first_contact_s"],
        "entry_speed_rad_s": truth["first_entry_wB_rad_s"],
        "peak_1_Nm": truth["first_impact_peak_Nm"],
        "peak_2_Nm": truth["braking_peak_Nm"],
        "theta_max_rad": truth["theta_max_rad"],
        "theta_min_rad": -solve(-1.0)["theta_max_rad"],
        "command_min": truth["TM_min_Nm"],
    }
    if duration == 1.2:
        expected |= {"iae_rad_s": truth["IAE_rad_s"], "itae_rad_s2": truth["ITAE_rad_s2"]}
    for name, value in expected.items():
        found = rows[f"disturbance.{kind}.{name}"].value
        assert found == pytest.approx(value, rel=RELATIVE), name


@pytest.mark.parametrize(("suffix", "duration"), [("", 1.2), ("_damping_only", 0.4)])
def test_free_responses_agree_with_the_oracle(suffix: str, duration: float) -> None:
    """Without position loop all is over at 0.4 s, and the oracle chatters on rounding later."""
    rows = _rows("free")
    order = "omega_L", "omega_B", "theta_L", "theta_B"
    for case, start in free.CASES.items():
        truth = oracle.solve(
            oracle.Params(),
            "switched",
            step=0.0,
            start=tuple(float(getattr(start, name)) for name in order),  # type: ignore[arg-type]
            duration=duration,
            position_loop=suffix == "",
        )
        final = dict(zip(order, truth.state(duration)[: len(order)], strict=True))
        for name, unit in free.FINAL.items():
            found = rows[f"free.{case}{suffix}.final_{name}_{unit.replace('/', '_')}"].value
            size = 1.0 if unit == "rad/s" else 2.0 * oracle.Params().half_gap
            assert found == pytest.approx(final[name], abs=RELATIVE * size), (case, name)
        peaks = truth.metrics()
        for name in ("theta_max_rad", "largest_torque_Nm"):
            found = rows[f"free.{case}{suffix}.{name}"].value
            assert found == pytest.approx(peaks[name], rel=RELATIVE), (case, name)


def test_sampled_reduction_is_that_of_the_errata() -> None:
    rows = _rows("sampled")
    assert rows["sampled.linear.impact_reduction_pct"].value == pytest.approx(44.57, abs=0.005)
    assert all(row.ok is not False for row in rows.values())


def test_limit_cycle_is_that_of_the_errata() -> None:
    run = _bench_2018.step_runs()["none"]
    assert _bench_2018.metric(run, "limit_cycle_Hz") == pytest.approx(9.766, abs=5e-4)
    assert _bench_2018.metric(run, "limit_cycle_rad") == pytest.approx(8.669e-3, abs=5e-7)
    assert _bench_2018.metric(run, "limit_cycle_Nm") == pytest.approx(0.1618, abs=5e-5)


@pytest.mark.parametrize(("kind", "threshold"), [("linear", -0.022651), ("switched", -0.217609)])
def test_small_oscillations_grow_and_die_on_the_two_sides_of_the_threshold(
    kind: oracle.Law, threshold: float
) -> None:
    ratio = contraction(kind, [1.2 * threshold, threshold, 0.8 * threshold])
    assert ratio[0] < 1.0 < ratio[2]
    assert ratio[1] == pytest.approx(1.0, abs=1e-4)
    spans = []
    for factor in (1.2, 0.8):
        p = replace(oracle.Params(), K_B=factor * threshold)
        run = oracle.solve(p, kind, step=0.0, start=(0.02, 0.0, 0.0, 0.0), duration=4.0)
        spans += [np.ptp(run.state(np.linspace(t, t + 1.0, 2001))[:, 2]) for t in (1.0, 3.0)]
    assert spans[1] < 0.9 * spans[0]
    assert spans[3] > 1.1 * spans[2]


def test_gap_is_identified_to_the_digits_of_the_paper(tmp_path: Path) -> None:
    found = GROUPS.find("gap_identification")().find()
    row = found.rows[0]
    assert (row.id, row.paper, row.ok) == ("gap_identification.half_gap_rad", 7.80e-3, True)
    assert row.value == pytest.approx(7.80e-3, abs=5e-6)
    found.figures["fig_2"](tmp_path / "fig_2.png")
    assert (tmp_path / "fig_2.png").stat().st_size > 10_000


def test_design_and_poles_hold() -> None:
    rows = _rows("design") | _rows("poles")
    assert all(rows[f"design.{name}"].ok for name in ("K_P", "K_D", "tau_D", "zeta"))
    assert rows["claim.cells"].ok
    # In the gap without damping the motor is alone: -D_M/J_M; the filter and the load likewise.
    gap = sorted(rows[f"poles.gap_undamped.p{k}_real_rad_s"].value for k in (3, 4, 5))
    expected = sorted(-x for x in (9.30e-2 / 8.78e-4, 3.60e-2 / 8.78e-4, 1.0 / 5.82812354062619e-3))
    assert gap == pytest.approx(expected, rel=1e-9)


# --- rows and groups ------------------------------------------------------------------------------


def test_groups_say_what_they_are() -> None:
    figures = [name for group in GROUPS.all().values() for name in group.figures]
    assert len(figures) == len(set(figures))
    papers = ("2", "3a", "3b", "4", "5a", "5b", "6", "7", "8a", "8b", "9a", "9b", "10")
    assert {f"fig_{name}" for name in papers} <= set(figures)
    assert all(group.title and group.paper for group in GROUPS.all().values())


def test_a_number_off_the_paper_is_marked() -> None:
    good = against_paper("x", "x", "Nm", 1.004, 1.00, 0.005)
    bad = against_paper("x", "x", "Nm", 1.006, 1.00, 0.005)
    assert (good.ok, bad.ok) == (True, False)
    assert measured("x", "x", "Nm", 1.0).ok is None


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "message"),
    [(["limit_cycl"], "did you mean limit_cycle"), (["al"], "did you mean all"), ([], "--list")],
)
def test_names_are_checked_before_anything_runs(names: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        _chosen(names)


def test_a_folder_that_cannot_be_made_is_said_first(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="--out: must lie in a folder"):
        command(["step"], out=tmp_path / "file" / "below")


class _Broken(Group):
    paper = title = "none"

    def find(self) -> Findings:
        raise RuntimeError("on purpose")


def test_a_failing_group_does_not_lose_the_others(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    groups = {"broken": _Broken, **_chosen(["design", "disturbance"])}
    found = _reproduce(groups, tmp_path, file, Console(quiet=True))
    findings_report.write(tmp_path, groups, *found)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert page.count("<img") == 2
    assert "<td>design.K_P</td>" in page
    assert "broken failed." in page
    content = json.loads(file.read_text())
    assert "on purpose" in content["failed"]["broken"]
    ids = [row["id"] for row in content["rows"]]
    assert "design.K_P" in ids
    assert set(content["rows"][0]) == set(Row._fields)
    assert content["provenance"]["versions"]["jax"]
    assert sorted(p.stem for p in tmp_path.glob("*.png")) == ["fig_6", "fig_7"]


@pytest.mark.slow
def test_everything_is_reproduced(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    command(["all"], out=tmp_path, json=file)
    content = json.loads(file.read_text())
    assert content["failed"] == {}
    ids = [row["id"] for row in content["rows"]]
    assert len(ids) == len(set(ids)) > 700
    wrong = {row["id"] for row in content["rows"] if row["ok"] is False}
    assert wrong == KNOWN_DISAGREEMENTS | OF_2014
    figures = {name for group in GROUPS.all().values() for name in group.figures}
    assert {p.stem for p in tmp_path.glob("*.png")} == figures
