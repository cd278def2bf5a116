"""Tuning from start to end: the bench against its oracle, and what goes wrong."""

from __future__ import annotations

import contextlib
import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pytest
from scipy.optimize import minimize, minimize_scalar
from tuning_cases import searched, study
from typer.testing import CliRunner

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.command import app
from jaxsim.errors import InputError
from jaxsim.objective import Limit
from jaxsim.provenance import write_toml
from jaxsim.study import load
from tuning import figures, report, space
from tuning.local import RESERVE
from tuning.problem import Outcome, Problem
from tuning.result import conclude
from tuning.session import Session, noted_interrupts, resume
from tuning.solver import CONVERGED
from tuning.spec import read_spec
from tuning.words import sentences


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return searched(study(), tmp_path_factory.mktemp("finished"))


# --- drives ---------------------------------------------------------------------------------


def test_bench_minimum_is_that_of_the_oracle_from_every_start(tmp_path: Path) -> None:
    def J(k: float) -> float:
        numbers = oracle.solve(oracle.Params(K_B=float(k)), "linear").metrics()
        return numbers["first_impact_peak_Nm"] / 1.394422 + numbers["overshoot_rad"] / 0.0691058

    wanted: Any = minimize_scalar(J, bracket=(-0.5, -0.33, -0.2), tol=1e-9)
    session = searched(load("bench_linear_kb"), tmp_path)
    assert session.states[0].status == CONVERGED
    starts = [row["K_B"] for row in session.history if row["iteration"] == 0]
    assert max(starts) - min(starts) > 0.7
    for s in session.states:
        assert s.status == CONVERGED
        assert space.to_gains(session.spec.free, s.z)[0] == pytest.approx(wanted.x, abs=2e-5)
    assert session.progress().cost == pytest.approx(wanted.fun, rel=1e-5)


def test_values_are_those_of_single_runs_and_slopes_their_differences(finished: Session) -> None:
    problem, spec = finished.problem, finished.spec
    z, h = np.array([0.45, 0.55]), 1e-4
    outcome = problem.evaluate(z[None], np.arange(spec.count))

    def single(point: np.ndarray, index: int) -> np.ndarray:
        law = space.with_gains(finished.study.law, spec.free, space.to_gains(spec.free, point))
        what = finished.study
        numbers = simulate(
            problem.drive(index), law, what.scenario, metrics=problem.metrics, store=None
        ).metrics
        return np.array([float(numbers[name]) for name in problem.metrics])

    for index in range(spec.count):
        np.testing.assert_allclose(outcome.values[0, index, 0], single(z, index), rtol=1e-9)
    for k, move in enumerate(h * np.eye(2)):
        slope = (single(z + move, 1) - single(z - move, 1)) / (2.0 * h)
        np.testing.assert_allclose(outcome.slopes[0, 1, 0, :, k], slope, rtol=1e-3, atol=1e-6)


def test_limits_hold_on_every_drive_by_fresh_runs_at_half_the_step(finished: Session) -> None:
    result = conclude(finished)
    assert finished.best().status == CONVERGED
    assert result.feasible
    objective = finished.spec.objective
    assert result.after.cost(objective) < result.before.cost(objective)
    assert result.after.cost(objective) == pytest.approx(result.searched, rel=1e-6)
    active = [v for v in result.verdicts if v.price > 0.0]
    assert active  # the limits are what stops this search, so they were really needed
    for v in active:
        assert v.limit.bound * (1.0 - 3.0 * RESERVE) <= v.value <= v.limit.bound
    assert "every limit holds on all 3 drives" in sentences(finished, result)[0]


def test_conflicting_limits_are_named_with_the_excess(tmp_path: Path) -> None:
    session = searched(study(limits={"largest_torque_Nm": 0.8, "iae_rad_s": 0.009}), tmp_path)
    result = conclude(session)
    words = sentences(session, result)
    assert not result.feasible
    assert words[0].startswith("NO FEASIBLE LAW")
    assert "onverged" not in words[0]
    for v in (v for v in result.verdicts if not v.holds):
        assert f"{v.limit.words} by {100.0 * v.share:.2g} %" in words[0]
    assert "In conflict: largest_torque_Nm <= 0.8 and iae_rad_s <= 0.009." in words
    # The law that is kept breaks its worst limit least: SciPy's on the same runs.
    share = max(v.share for v in result.verdicts)
    assert share == pytest.approx(least_excess_by_scipy(session), rel=3e-4)
    assert share < min(x.share for x in result.attained)
    assert any("breaks its worst limit least" in line for line in words)
    # Either limit alone is the end of a front: what SciPy makes of it under the other.
    for found, other in zip(result.attained, reversed(result.attained), strict=True):
        wanted = least_by_scipy(session, found.limit.metric, other.limit)
        assert found.others
        assert found.value == pytest.approx(wanted, rel=3e-4)
        assert any(line.startswith(f"{found.limit.words}: ") for line in words)


def least_excess_by_scipy(session: Session) -> float:
    """The least that the worst limit can be exceeded by, as a share of its bound."""
    problem, limits = session.problem, session.spec.objective.limits

    def room(v: np.ndarray) -> np.ndarray:
        values = problem.evaluate(np.clip(v[None, :2], 0.0, 1.0), session.drives).values
        worst = [values[..., problem.metrics.index(x.metric)].max() / x.bound for x in limits]
        return 1.0 + v[2] - np.array(worst)

    inside = (room, lambda v: v[:2], lambda v: 1.0 - v[:2])
    found = minimize(
        lambda v: v[2], np.append(session.best().best, 0.2), method="COBYLA",  # type: ignore[arg-type]
        options={"rhobeg": 0.05, "tol": 1e-6},
        constraints=[{"type": "ineq", "fun": f} for f in inside],
    )  # fmt: skip
    return float(found.fun)


def least_by_scipy(session: Session, metric: str, other: Limit) -> float:
    """The least worst case of a metric under a limit on another one, by values alone."""
    problem, drives = session.problem, session.drives

    def worst(z: np.ndarray, name: str) -> float:
        values = problem.evaluate(np.clip(z, 0.0, 1.0)[None], drives).values
        return float(values[..., problem.metrics.index(name)].max())

    def kept(z: np.ndarray) -> float:
        return 1.0 - worst(z, other.metric) / other.bound

    start = session.best().best
    found = minimize(
        lambda z: worst(z, metric), start, method="COBYLA", options={"rhobeg": 0.05, "tol": 1e-5},
        constraints=[{"type": "ineq", "fun": f} for f in (kept, lambda z: z, lambda z: 1.0 - z)],
    )  # fmt: skip
    return float(found.fun)


def test_an_impossible_drive_is_named_and_the_rest_is_tuned(tmp_path: Path) -> None:
    what = study(
        drives={"count": 3, "screen": 3, "spread": {"half_gap": "20 %", "J_L": [-8e-4, 9e-4]}}
    )
    session = searched(what, tmp_path)
    bad = [i for i in range(3) if session.problem.drives[i, 1] <= 0.0]
    assert bad
    assert len(bad) < 3
    assert sorted(session.excluded) == bad
    assert all("J_L: must be > 0" in why for why in session.excluded.values())
    assert len(session.drives) == 3 - len(bad)
    assert session.best().rank[0] == 0.0  # the limits hold on those that run
    words = sentences(session, conclude(session))
    assert f"{3 - len(bad)} of 3 drives, the others being impossible" in words[0]
    told = f"Left out, {len(bad)} of 3 drives (load.J_L: must be > 0): {', '.join(map(str, bad))};"
    assert any(line.startswith(told) for line in words)


def test_a_working_set_ends_with_limits_that_hold_on_all_drives(tmp_path: Path) -> None:
    spread = {"half_gap": "30 %", "J_L": "30 %"}
    drives = {"count": 64, "screen": 2, "working": 3, "check": 50, "spread": spread}
    what = study(limits={"largest_torque_Nm": 1.6}, drives=drives)
    session = searched(what, tmp_path)
    result = conclude(session)
    # On the three drives of the beginning the limit would have been kept by a law that breaks it.
    assert 3 < len(session.drives) < 64
    assert max(session.drives) >= 3
    assert result.feasible
    assert len(result.drives) == 64
    assert result.after.values["largest_torque_Nm"].max() <= 1.6

    found = result.check
    assert found is not None
    many = study(limits={"largest_torque_Nm": 1.6}, drives=drives | {"count": 51})
    fresh = Problem(many, read_spec(many, seed=1))
    law = space.with_gains(what.law, session.spec.free, result.gains)
    torques = [
        float(simulate(fresh.drive(i), law, what.scenario, store=None).metrics["largest_torque_Nm"])
        for i in range(1, 51)
    ]
    assert found.count == 50
    assert found.broken == {"largest_torque_Nm <= 1.6": sum(t > 1.6 for t in torques)}
    value, where = found.worst["largest_torque_Nm <= 1.6"]
    assert value == pytest.approx(max(torques), rel=1e-6)
    assert where == fresh.label(1 + int(np.argmax(torques)))
    assert any("of 50 fresh drives" in line for line in sentences(session, result))


def test_a_search_that_ran_out_of_iterations_claims_no_conflict(tmp_path: Path) -> None:
    what = study(limits={"largest_torque_Nm": 0.8, "iae_rad_s": 0.009}, iterations=2)
    session = searched(what, tmp_path)
    headline = sentences(session, conclude(session))[0]
    assert headline.startswith("NO FEASIBLE LAW was found yet: the best one breaks")
    assert "spent, 2 iterations; --resume goes on" in headline


def test_drives_that_break_a_limit_join_a_search_that_is_spent(tmp_path: Path) -> None:
    spread = {"half_gap": "30 %", "J_L": "30 %"}
    drives = {"count": 64, "screen": 2, "working": 3, "spread": spread}
    what = study(limits={"largest_torque_Nm": 1.6}, drives=drives, iterations=3)
    session = searched(what, tmp_path)
    assert len(session.drives) > 3
    assert conclude(session).feasible


def test_interrupt_keeps_a_loadable_law_and_resume_ends_where_it_would_have(
    finished: Session, tmp_path: Path
) -> None:
    def stop(progress: Any) -> None:
        if progress.done == 3:
            raise KeyboardInterrupt

    session = searched(study(), tmp_path, stop)
    assert session.interrupted
    result = conclude(session)
    report.write(session, result, tmp_path)
    law = load("bench_linear_kb", law=str(tmp_path / "law.toml")).law
    assert float(tree.get(law, "K_P")) == result.gains[1]
    assert float(tree.get(law, "K_B")) == result.gains[0]

    again = Session(study(), read_spec(study()), tmp_path / "checkpoint.json")
    resume(again)
    again.search(lambda progress: None)
    assert not again.interrupted
    np.testing.assert_allclose(conclude(again).gains, conclude(finished).gains, rtol=1e-5)
    assert len(again.history) == len(finished.history)


def test_a_search_on_a_working_set_is_taken_up_after_drives_have_joined(tmp_path: Path) -> None:
    spread = {"half_gap": "30 %", "J_L": "30 %"}
    drives = {"count": 64, "screen": 2, "working": 3, "spread": spread}
    what = study(limits={"largest_torque_Nm": 1.6}, drives=drives)
    whole, broken, again = (
        Session(what, read_spec(what), tmp_path / name) for name in ("whole", "part", "part")
    )
    whole.search(lambda progress: None)

    def stop(progress: Any) -> None:
        if len(broken.drives) > 3:
            raise KeyboardInterrupt

    broken.search(stop)
    assert broken.interrupted
    assert broken.final
    known = broken.drives.copy()
    resume(again)
    np.testing.assert_array_equal(again.drives, known)
    again.search(lambda progress: None)
    assert not again.interrupted
    np.testing.assert_array_equal(again.drives, whole.drives)
    np.testing.assert_allclose(again.best().best, whole.best().best, atol=1e-6)  # type: ignore[arg-type]
    assert again.progress().cost == pytest.approx(whole.progress().cost, rel=1e-8)
    assert [row["cost"] for row in again.history] == pytest.approx(
        [row["cost"] for row in whole.history], rel=1e-6
    )


def test_resume_needs_the_checkpoint_of_the_same_problem(finished: Session, tmp_path: Path) -> None:
    what = study()
    with pytest.raises(InputError, match="needs a checkpoint"):
        resume(Session(what, read_spec(what), tmp_path / "none.json"))
    with pytest.raises(InputError, match="must belong to this study"):
        resume(Session(what, read_spec(what, seed=5), finished.file))
    (tmp_path / "half.json").write_text('{"states": [')
    with pytest.raises(InputError, match="whole checkpoint"):
        resume(Session(what, read_spec(what), tmp_path / "half.json"))


def test_a_start_that_cannot_be_evaluated_anywhere_is_said_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def never(
        self: Problem, points: np.ndarray, drives: np.ndarray, *, slopes: bool = True
    ) -> Outcome:
        shape = (len(points), len(drives), 1, 3)
        values = np.full(shape, np.inf)
        return Outcome(values, np.zeros((*shape, 2)), np.zeros(shape[:3], int))

    monkeypatch.setattr(Problem, "evaluate", never)
    with pytest.raises(InputError, match="the study's drive: itae_rad_s2 or its slope is not fin"):
        searched(study(), tmp_path)


def test_command_writes_law_tables_and_plots(tmp_path: Path) -> None:
    file, out = tmp_path / "mine.toml", tmp_path / "out"
    write_toml(file, study().table)
    done = CliRunner().invoke(app, ["tune", str(file), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "every limit holds on all 3 drives" in done.output
    names = {*report.FILES, *figures.FILES, "report.html", "checkpoint.json"}
    assert {p.name for p in out.iterdir()} == names
    gains = json.loads((out / "result.json").read_text())["gains"]
    law = load(str(file), law=str(out / "law.toml")).law
    for name in ("K_B", "K_P"):
        assert float(tree.get(law, name)) == gains[name]["after"]

    again = CliRunner().invoke(app, ["tune", str(file), "--out", str(out)])
    assert again.exit_code != 0
    assert "must not hold results already" in again.output
    assert gains == json.loads((out / "result.json").read_text())["gains"]


def test_an_interrupt_that_a_callback_swallows_is_noted() -> None:
    before = signal.getsignal(signal.SIGINT)
    with noted_interrupts() as pressed:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert pressed == [signal.SIGINT]
    assert signal.getsignal(signal.SIGINT) is before
