"""Tuning: the solver against SciPy, the bench against its oracle, and what goes wrong."""

from __future__ import annotations

import contextlib
import copy
import itertools
import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pytest
from scipy.optimize import minimize, minimize_scalar
from typer.testing import CliRunner

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.command import app
from jaxsim.errors import InputError
from jaxsim.objective import Goal, Limit, Objective, reduce
from jaxsim.provenance import write_toml
from jaxsim.study import Study, from_table, load
from tuning import figures, report, solver, space
from tuning.local import RESERVE, Local, Rows, localise
from tuning.problem import Outcome, Problem
from tuning.result import conclude
from tuning.session import Session, noted_interrupts, resume
from tuning.solver import CONVERGED, RUNNING, State
from tuning.spec import read_spec
from tuning.words import sentences

SHORT = 0.1  # s: first impact, braking and the overshoot are over


def study(limits: dict[str, float] | None = None, **tune: Any) -> Study:
    """A short run of the bench with linear damping; K_B and K_P are free.

    All tests that run it use these metrics and this number of drives, so it compiles once.
    """
    table = copy.deepcopy(load("bench_linear_kb").table)
    table["scenario"]["duration"] = SHORT
    table["objective"] = {
        "minimise": {"itae_rad_s2": 1.0},
        "limits": limits or {"largest_torque_Nm": 1.5, "iae_rad_s": 0.02},
    }
    table["tune"] = {
        "starts": 2,
        "free": {"K_B": {"lower": -1.5, "upper": 0.0}, "K_P": {"lower": 3.0, "upper": 30.0}},
        "drives": {"count": 3, "screen": 3, "spread": {"half_gap": "20 %", "J_L": "20 %"}},
        **tune,
    }
    return from_table(table, Path(), "short")


def searched(what: Study, folder: Path, tell: Any = lambda progress: None) -> Session:
    session = Session(what, read_spec(what), folder / "checkpoint.json")
    session.search(tell)
    return session


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return searched(study(), tmp_path_factory.mktemp("finished"))


# --- the solver alone -----------------------------------------------------------------------


def rows(value: Any, slope: Any, factor: float = 1.0) -> Rows:
    value = np.atleast_1d(np.asarray(value, float))
    return Rows(value, np.reshape(slope, (len(value), -1)), factor, np.arange(len(value)))


def banana(z: np.ndarray) -> Local:
    """Rosenbrock's valley, with a disc and a line as limits."""
    x, y = 3.0 * z - 1.0
    cost = (1.0 - x) ** 2 + 10.0 * (y - x**2) ** 2
    slope = [-2.0 * (1.0 - x) - 40.0 * x * (y - x**2), 20.0 * (y - x**2)]
    disc = rows(x**2 + y**2 - 1.0, [6.0 * x, 6.0 * y])
    line = rows(y - 0.7 * x - 0.1, [-2.1, 3.0])
    return Local((rows(cost, np.multiply(3.0, slope)),), (disc, line))


def run(look: Any, starts: Any, most: int = 100) -> list[State]:
    states = [solver.begin(State(np.asarray(z, float)), look(np.array([z]))[0]) for z in starts]
    while any(s.status == RUNNING for s in states):
        states = solver.advance(states, look, 1e-7, most)
    return states


def test_solver_finds_the_constrained_minimum_of_scipy() -> None:
    def values(z: np.ndarray) -> Local:
        return banana(z)

    wanted = minimize(
        lambda z: values(z).cost,
        [0.5, 0.5],
        method="SLSQP",
        bounds=[(0, 1)] * 2,
        constraints={"type": "ineq", "fun": lambda z: -values(z).excess},
        options={"ftol": 1e-14},
    )
    found = run(lambda zs: [banana(z) for z in zs], [[0.5, 0.5], [0.1, 0.9], [0.05, 0.05]])
    for s in found:
        assert s.status == CONVERGED
        np.testing.assert_allclose(s.z, wanted.x, atol=1e-5)


def test_worst_case_goal_is_solved_to_its_kink() -> None:
    # max(|z - a|) over three points: the middle of the outer two.
    points = np.array([0.1, 0.35, 0.8])

    def look(zs: np.ndarray) -> list[Local | str]:
        return [
            Local((rows([*(z[0] - points), *(points - z[0])], [[1.0]] * 3 + [[-1.0]] * 3),), ())
            for z in zs
        ]

    (s,) = run(look, [[0.9]])
    assert s.z[0] == pytest.approx(0.45, abs=1e-6)


def test_multiplier_is_the_price_of_the_bound() -> None:
    # min (z - 0.9)^2 with z <= 0.5: d cost/d bound = 2 (0.5 - 0.9).
    def look(zs: np.ndarray) -> list[Local | str]:
        return [
            Local((rows((z - 0.9) ** 2, 2.0 * (z - 0.9)),), (rows(z - 0.5, [1.0]),)) for z in zs
        ]

    (s,) = run(look, [[0.2]])
    assert s.step is not None
    assert float(s.step.limit_weights[0].sum()) == pytest.approx(0.8, rel=1e-5)


def test_failed_trials_are_rejected_and_leave_the_others_alone() -> None:
    def look(zs: np.ndarray, fails: bool) -> list[Local | str]:
        return ["no run here" if fails and z[0] > 0.55 else banana(z) for z in zs]

    starts = [[0.5, 0.5], [0.1, 0.9]]
    free = run(lambda zs: look(zs, False), starts)
    both = run(lambda zs: look(zs, True), starts)
    assert free[0].z[0] > 0.55
    assert both[0].z[0] <= 0.55  # as near as it gets, by smaller steps
    assert np.isfinite(both[0].z).all()
    alone = run(lambda zs: look(zs, True), starts[1:])
    np.testing.assert_array_equal(both[1].z, alone[0].z)


def test_violated_limits_are_cut_as_far_as_they_go() -> None:
    # z <= 0.2 and z >= 0.6 exclude each other; the sum of the excesses is least between.
    def look(zs: np.ndarray) -> list[Local | str]:
        limits = [(rows(z - 0.2, [1.0]), rows(0.6 - z, [-1.0])) for z in zs]
        return [Local((rows(z, [1.0]),), x) for z, x in zip(zs, limits, strict=True)]

    (s,) = run(look, [[0.9]])
    assert s.best_local is not None
    assert 0.2 <= s.z[0] <= 0.6
    assert s.best_local.violation > 0.1


# --- objective and search space -------------------------------------------------------------


def test_rows_reduce_to_the_numbers_of_the_objective() -> None:
    values = np.random.default_rng(0).normal(size=(9, 1, 2))
    slopes = np.random.default_rng(1).normal(size=(9, 1, 2, 3))
    for over in ("mean", "worst", 0.8):
        objective = Objective((Goal("a", 2.0, over),), (Limit("b", 0.5, over),))
        local = localise(objective, ("a", "b"), values, slopes)
        assert local.cost == pytest.approx(2.0 * float(reduce(values[:, 0, 0], over)), rel=1e-12)
        excess = (float(reduce(values[:, 0, 1], over)) - 0.5) / 0.5 + RESERVE
        assert local.excess[0] == pytest.approx(excess, rel=1e-12)
        moved = localise(objective, ("a", "b"), values + 1e-7 * slopes @ np.ones(3), slopes)
        row = int(np.argmax(local.goals[0].values))
        fall = 2.0 * float(local.goals[0].slopes[row].sum())
        assert (moved.cost - local.cost) / 1e-7 == pytest.approx(fall, rel=1e-5)


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
    drives = space.draw_drives(what.drive, read_spec(what))
    np.testing.assert_array_equal(drives[0], [7.8e-3, 8.78e-4])
    shares = (drives[1:] - [0.8 * 7.8e-3, 5e-4]) / [0.4 * 7.8e-3, 4e-4]
    for column in shares.T:  # one in each of the eight strata
        assert sorted(np.floor(8.0 * column).astype(int)) == list(range(8))
    np.testing.assert_array_equal(drives, space.draw_drives(what.drive, read_spec(what)))
    other = space.draw_drives(what.drive, read_spec(what, seed=1))
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
    assert "largest_torque_Nm and iae_rad_s conflict" in words[0]
    assert any("does NOT hold" in line and "% too much" in line for line in words)


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
    fresh = Problem(what, session.spec._replace(count=51, seed=1))
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


def test_a_mean_is_taken_over_the_sample_and_a_worst_case_over_all() -> None:
    values = np.array([1.0, 3.0, 8.0]).reshape(3, 1, 1)
    slopes = np.array([10.0, 30.0, 80.0]).reshape(3, 1, 1, 1)
    objective = Objective((Goal("a", 1.0, "mean"),), (Limit("a", 2.0, "worst"),))
    local = localise(objective, ("a",), values, slopes, np.array([True, True, False]))
    assert local.goals[0].values == pytest.approx([2.0])
    assert local.goals[0].slopes == pytest.approx(np.array([[20.0]]))
    assert local.limits[0].values.max() == pytest.approx(3.0 + RESERVE)
    assert local.limits[0].source.tolist() == [0, 1, 2]


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


def test_resume_needs_the_checkpoint_of_the_same_problem(finished: Session, tmp_path: Path) -> None:
    what = study()
    with pytest.raises(InputError, match="needs a checkpoint"):
        resume(Session(what, read_spec(what), tmp_path / "none.json"))
    with pytest.raises(InputError, match="must belong to this study"):
        resume(Session(what, read_spec(what, seed=5), finished.file))
    (tmp_path / "half.json").write_text('{"states": [')
    with pytest.raises(InputError, match="whole checkpoint"):
        resume(Session(what, read_spec(what), tmp_path / "half.json"))


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


def test_a_start_that_cannot_be_evaluated_anywhere_is_said_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def never(self: Problem, points: np.ndarray, drives: np.ndarray) -> Outcome:
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
