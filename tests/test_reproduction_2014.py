"""The reproduction of the 2014 paper, judged by the errata's numbers and by scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from joint_oracle import Arm

from jaxsim.findings import GROUPS, Row
from jaxsim.reproduction import _joints_2014 as paper

# What the text says and its own equations do not give; and what a gap or a wrong model undoes.
KNOWN_DISAGREEMENTS = {
    "zeros.straight.1.re",
    "claim.routh_22_as_printed",
    "claim.torque_overshoot_joint2",
    "claim.lead_all_below",
    "claim.leg_lead_ripple",
    "claim.gap_decoupled",
    "claim.gap_overshoot",
    "claim.gap_joint2_held",
    "claim.model_error_stable",
}
INTERVALS = {
    "full": [12.2104094],
    "none": [10.8365569],
    "no_jerk": [12.9877310],
    "velocity_only": [0.000730016, 7.51953, 12.5317],
    "velocity_only_more_BL": [12.7034940],
    "no_jerk_10L": [0.18211, 1.38191],
    "no_jerk_10L_BL0.1": [1.3819703],
    "full_10L": [1.2420421],
    "none_10L": [0.24880606],
    "no_jerk_KL0": [12.9877105],
    "velocity_only_KL0": [12.5316849],
}
ZEROS = {
    "hanging": [(-0.0304, 3.0036), (-0.2037, 7.4767)],
    "more_BL": [(-0.9408, 3.3033), (-2.4747, 0.0), (-17.29, 0.0)],
    "KL0": [(0.0, 0.0), (-0.0186, 0.0), (-0.4496, 0.0)],
    "straight": [(3.38931, 0.0), (0.0, 0.0), (-0.0919, 0.0), (-3.5042, 0.0)],
    "folded": [(3.4511, 0.0), (2.3118, 0.0), (-2.4371, 0.0), (-3.5034, 0.0)],
}


def _rows(name: str) -> dict[str, Row]:
    return {row.id: row for row in GROUPS.find(name)().find().rows}


def _wrong(rows: dict[str, Row]) -> set[str]:
    return {id for id, row in rows.items() if row.ok is False}


# --- linear ---------------------------------------------------------------------------------------


def test_zeros_are_those_printed() -> None:
    rows = _rows("transmission_zeros")
    for case, wanted in ZEROS.items():
        found = [
            (rows[f"zeros.{case}.{n}.re"].value, rows[f"zeros.{case}.{n}.im"].value)
            for n in range(1, 5)
        ]
        for zero in wanted:
            assert min(math.dist(zero, f) for f in found) < 8e-5, (case, zero)
    spring = [rows[f"motor_position.folded.{edge}_V_rad"].value for edge in ("low", "high")]
    assert spring == pytest.approx([0.0018549318, 85.805683], rel=1e-6)  # tests/test_linearise.py
    assert rows["zeros.hanging.1.re"].paper == -0.0304
    assert _wrong(rows) == {"zeros.straight.1.re"}


def test_gammas_and_bounds_are_those_of_the_errata() -> None:
    rows = _rows("torque_gains")
    for name, value in {"j": 1.62380e-5, "a": 0.0337173, "v": 6.198488}.items():
        assert rows[f"gammas.{name}"].value == pytest.approx(value, rel=5e-6)
    assert rows["routh.kp_max"].value == pytest.approx(14.1128, rel=5e-6)
    assert rows["routh.kp_max"].paper == 14.0
    limit = rows["routh.ki_max_at_kp2"].value
    for factor, stable in ((0.999, True), (1.001, False)):  # s^4 .. s^0 of (15), by numpy
        L, R, K_t, J, B, N, K = 3.2e-4, 0.664, 0.041, 1.387e-5, 1.996e-5, 150.0, 912.0
        a = [L * J * N / K_t / K, (L * B + R * J) * N / K_t / K,
             (R * B * N / K_t + K_t * N) / K + L / (K_t * N), R / (K_t * N)]  # fmt: skip
        roots = np.roots([*a[:3], a[3] + 2.0, 2.0 * factor * limit])
        assert bool(roots.real.max() < 0.0) is stable
    assert _wrong(rows) == {"claim.routh_22_as_printed"}


def test_interval_edges_are_those_of_the_errata() -> None:
    rows = _rows("stability_intervals")
    for case, edges in INTERVALS.items():
        found = [rows[f"intervals.{case}.edge{n}"] for n in range(1, len(edges) + 1)]
        assert [row.value for row in found] == pytest.approx(edges, rel=1e-5), case
        assert f"intervals.{case}.edge{len(edges) + 1}" not in rows
        assert all(row.ok for row in found)
    assert rows["intervals.velocity_only.edge2"].paper == 7.5196
    assert _wrong(rows) == set()


# --- figures --------------------------------------------------------------------------------------


def test_every_figure_of_the_paper_is_there_and_groups_say_their_paper() -> None:
    groups = [g for g in GROUPS.all().values() if g.paper.startswith(paper.PAPER)]
    figures = {name for group in groups for name in group.figures}
    numbers = {name.removeprefix("fig14_").rstrip("ab") for name in figures if "fig14_" in name}
    assert numbers == {str(n) for n in [*range(2, 15), *range(16, 20)]}
    assert len(groups) >= 10


# --- nonlinear ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_torque_step_and_ripple() -> None:
    rows = _rows("torque_step") | _rows("torque_ripple")
    at = {id: row.value for id, row in rows.items()}
    for joint, (width, over) in enumerate(((55.3, 32.4), (55.7, 39.4)), start=1):
        prefix = f"torque_step.full.joint{joint}"
        assert at[f"{prefix}.bandwidth_Hz"] == pytest.approx(width, abs=0.05)
        assert at[f"{prefix}.overshoot_linear_pct"] == pytest.approx(over, abs=0.05)
    assert at["torque_step.full.joint1.overshoot_pct"] == pytest.approx(32.4, abs=0.05)
    assert at["torque_step.none.joint1.bandwidth_Hz"] == pytest.approx(0.62, abs=0.005)
    wanted = {"full": (0.0946, 0.0727), "lead": (0.0643, 0.0387)}
    for case, values in wanted.items():
        for joint, value in enumerate(values, start=1):
            id = f"ripple.{case}.rms_joint{joint}_Nm"
            assert at[id] == pytest.approx(value, abs=5e-5), id
    assert at["disturbance_transfer.full.joint1.peak"] == pytest.approx(13.09, abs=0.005)
    assert at["disturbance_transfer.full.joint2.peak"] == pytest.approx(14.35, abs=0.005)
    assert at["disturbance_transfer.lead.joint1.peak_scaled_Nm"] == pytest.approx(0.0941, abs=5e-5)
    assert _wrong(rows) == {"claim.torque_overshoot_joint2", "claim.lead_all_below"}


@pytest.mark.slow
def test_runs_of_the_reproduction_are_those_of_dop853() -> None:
    runs = paper.arm_runs()
    for name, alpha, ripple, lead in (
        ("full", 1.0, 0.0, None), ("ripple_lead", 1.0, 0.013, (128.0, 628.0)),
        ("ripple_none", 0.0, 0.013, None),
    ):  # fmt: skip
        first = slice(0, 1001)  # one second
        want = Arm(alpha=alpha, ripple=ripple, lead=lead).torques(runs[name].time[first])
        assert np.abs(runs[name].signals["T_s"][first] - want).max() < 3e-5 * 3.0


@pytest.mark.slow
def test_the_leg_and_its_filter() -> None:
    rows = _rows("leg") | _rows("filtered")
    at = {id: row.value for id, row in rows.items()}
    assert at["leg.full.bandwidth_Hz"] == pytest.approx(45.2, abs=0.05)
    assert at["leg.none.bandwidth_Hz"] == pytest.approx(0.712, abs=5e-4)
    assert at["filtered.leg.rightmost_pole_1_s"] < 0.0 < at["filtered.arm.rightmost_pole_1_s"]
    assert at["filtered.arm.stable_cutoff_Hz"] == pytest.approx(221.74357, rel=1e-6)
    assert at["filtered.arm.stable_BL_Nms_rad"] == pytest.approx(0.041735691, rel=1e-6)
    assert _wrong(rows) == {"claim.leg_lead_ripple"}


@pytest.mark.slow
def test_stiction_is_reduced_by_the_lead() -> None:
    rows = _rows("stiction")
    for joint in (1, 2):
        plain, lead = (
            rows[f"stiction.{case}.rms_joint{joint}_Nm"].value
            for case in ("uncompensated", "compensated")
        )
        assert lead < 0.8 * plain
        assert rows[f"stiction.uncompensated.stops_joint{joint}"].value > 10
    assert _wrong(rows) == set()


@pytest.mark.slow
def test_what_a_gap_does_does_not_depend_on_the_step() -> None:
    """Impacts are located: half the step changes peaks by little, though the runs have 40 events.

    With ripple joint 2 flutters in its gap: there only the share of time in it is compared.
    """
    from jaxsim.reproduction.combined import combined_runs, in_gap

    coarse, fine = combined_runs(), combined_runs(0.5 * paper.DT)
    for case in coarse[0]:
        a, b = (np.asarray(runs[0][case].signals["T_s"]) for runs in (coarse, fine))
        early = slice(0, 4000)  # up to the reversal
        assert np.abs(a[early, 0] - b[early, 0]).max() < 1e-3, case
        shares = [in_gap(runs[1][case], 1) for runs in (coarse, fine)]
        assert shares[0] == pytest.approx(shares[1], abs=3.0), case
    rows = _rows("combined")
    assert rows["combined.full_gap.overshoot_pct"].value == pytest.approx(42.1, abs=0.1)
    assert rows["combined.full_no_gap.overshoot_pct"].value == pytest.approx(32.4, abs=0.05)
    assert _wrong(rows) <= KNOWN_DISAGREEMENTS


@pytest.mark.slow
def test_model_errors() -> None:
    rows = _rows("model_error")
    assert rows["model_error.gammas.largest_factor"].value == pytest.approx(1.02684, rel=1e-4)
    assert rows["model_error.gammas_plus20.rightmost_pole_1_s"].value > 0.0
    assert rows["model_error.exact.stable_to_k_o"].value == pytest.approx(12.2104094, rel=1e-6)
    assert _wrong(rows) == {"claim.model_error_stable"}
