"""Gain maps: runs against single runs, poles against Routh's table and the paper's bound."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from test_tuning import study
from typer.testing import CliRunner

from jaxsim._simulate import simulate
from jaxsim.analysis import linearisable
from jaxsim.command import app
from jaxsim.errors import InputError
from jaxsim.linear.linearise import linearise
from jaxsim.provenance import write_toml
from jaxsim.study import load, with_values
from tuning.gain_map import FINER, axis_of, poles, survey


def routh_stable(A: np.ndarray) -> bool:
    """Whether the first column of Routh's table of det(sI - A) has one sign.

    The polynomial by Faddeev and LeVerrier: no eigenvalue is computed. Time is scaled first.
    """
    A = A / np.abs(np.trace(A))
    n, M = len(A), np.eye(len(A))
    coefficients = [1.0]
    for k in range(1, n + 1):
        c = -np.trace(A @ M) / k
        coefficients.append(float(c))
        M = A @ M + c * np.eye(n)
    rows = [np.array(coefficients[0::2]), np.array(coefficients[1::2])]
    rows = [np.pad(r, (0, n // 2 + 2 - len(r))) for r in rows]
    for _ in range(n - 1):
        above, last = rows[-2:]
        rows.append(np.append(above[1:] - above[0] / last[0] * last[1:], 0.0))
    return bool(all(r[0] > 0.0 for r in rows[: n + 1]))


def test_runs_are_those_of_single_laws() -> None:
    what = study()
    x = axis_of(what, "--x", "K_P", None, 3)
    y = axis_of(what, "--y", "K_B", (-1.0, 0.5), 4)
    assert (x.low, x.high, x.log) == (3.0, 30.0, True)  # its bounds in [tune.free]
    found = survey(what, x, y, ("itae_rad_s2", "largest_torque_Nm"))
    for row, column in ((0, 0), (1, 2), (3, 1)):
        gains = {"K_P": x.values[column], "K_B": y.values[row]}
        changed = with_values(what, gains)
        run = simulate(changed.drive, changed.law, what.scenario, store=None, throw=False)
        assert found.status[row, column] == int(run.status)
        if int(run.status) == 0:
            for name, values in found.metrics.items():
                assert values[row, column] == pytest.approx(float(run.metrics[name]), rel=1e-9)


def test_contact_is_stable_where_the_table_of_routh_says_so() -> None:
    what = load("bench_switched")
    x = axis_of(what, "--x", "K_P", (1.0, 60.0), 3)
    y = axis_of(what, "--y", "K_B", (-4.0, 1.0), 3)
    modes, _, _ = poles(what, x, y)
    assert len(modes) == 4  # both contacts are alike, and the law has two settings
    contact = next(m for m in modes if m.name == "contact+ omega_B+ omega_L+")
    own = {"omega_B": 1.0, "omega_L": 1.0}
    for row, K_B in enumerate(y.fine):
        for column, K_P in enumerate(x.fine):
            loop, _ = linearisable(with_values(what, {"K_P": K_P, "K_B": K_B}))
            A = linearise(loop, 0.3, contact=1, modes=own).system.A
            assert (contact.rightmost[row, column] < 0.0) == routh_stable(A)
    assert 0.1 < float((contact.rightmost < 0.0).mean()) < 0.9  # both happen here
    np.testing.assert_allclose(x.fine[::FINER], x.values, rtol=1e-12)


def test_gap_is_unstable_where_damping_of_the_motor_is_more_than_used_up() -> None:
    # Without contact omega_M' = ((K_B - D_M) omega_M + ...)/J_M: the load is not felt.
    what = load("bench_switched")
    x = axis_of(what, "--x", "K_P", (5.0, 10.0), 2)
    y = axis_of(what, "--y", "K_B", (-0.4, 0.6), 3)
    modes, _, _ = poles(what, x, y)
    gap = next(m for m in modes if m.name == "gap omega_B+ omega_L+").rightmost
    motor = (y.fine - 9.30e-2) / 8.78e-4
    np.testing.assert_allclose(gap[motor > 0.0, 0], motor[motor > 0.0], rtol=1e-6)
    assert (gap[motor < 0.0] < 0.0).all()


def test_torque_loop_is_stable_inside_the_bound_of_the_paper() -> None:
    what = load("arm_torque")
    x = axis_of(what, "--x", "laws[0].laws[0].K_p", (0.5, 12.0), 5)
    y = axis_of(what, "--y", "laws[0].laws[0].K_i", (5.0, 500.0), 5)
    (mode,), (edge,), _ = poles(what, x, y)
    bound = np.interp(x.fine, edge.K_p, edge.K_i, left=np.nan, right=0.0)
    inside = y.fine[:, None] < bound
    apart = np.abs(np.log(y.fine[:, None] / np.maximum(bound, 1e-9))) > 0.02
    stable = mode.rightmost < 0.0
    np.testing.assert_array_equal(stable[apart], inside[apart])
    assert inside.any()
    assert not inside.all()


def test_mistakes_are_one_clear_message() -> None:
    what = study()
    with pytest.raises(InputError, match="K_P"):
        axis_of(what, "--x", "K_Pe", None, 3)
    with pytest.raises(InputError, match="lower < upper"):
        axis_of(what, "--x", "K_P", (3.0, 1.0), 3)
    with pytest.raises(InputError, match="--y-range: must be given"):
        axis_of(with_values(what, {"K_D": 0.0}), "--y", "K_D", None, 3)


def test_command_writes_the_plane_and_what_it_shows(tmp_path: Path) -> None:
    file, out = tmp_path / "mine.toml", tmp_path / "out"
    write_toml(file, study().table)
    options = ["--x", "K_P", "--y", "K_B", "--y-range", "-1", "0.5", "--points", "4"]
    metrics = ["--metric", "itae_rad_s2", "--metric", "largest_torque_Nm"]
    done = CliRunner().invoke(app, ["map", str(file), *options, *metrics, "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert {p.name for p in out.iterdir()} == {"map.csv", "map.json", "map.png", "report.html"}
    with (out / "map.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert len(rows) == 16
    least = min(float(r["itae_rad_s2"]) for r in rows if r["status"] == "0")
    assert f"Least itae_rad_s2: {least:.3g} rad s²" in " ".join(done.output.split())
