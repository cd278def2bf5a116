"""The solver alone, against SciPy and closed forms, and the objective that it is given."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import mstats

from jaxsim.objective import Goal, Limit, Objective
from tuning.local import RESERVE, Local, Rows, localise
from tuning.solver import CONVERGED, RUNNING, SOLVERS, Solver, State
from tuning.solvers.cma import Cma
from tuning.solvers.sqp import Sqp


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


def begun(solver: Solver, look: Any, starts: Any) -> list[State]:
    return [solver.begin(State(np.asarray(z, float)), look(np.array([z]))[0]) for z in starts]


def run(look: Any, starts: Any, most: int = 100, solver: Solver | None = None) -> list[State]:
    solver = solver or Sqp()
    states = begun(solver, look, starts)
    while any(s.status == RUNNING for s in states):
        states = solver.advance(states, lambda points, _: look(points), 1e-7, most)
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
    step = Sqp().multipliers(s, look(s.best[None])[0])  # type: ignore[index, arg-type]
    assert step is not None
    assert float(step.limit_weights[0].sum()) == pytest.approx(0.8, rel=1e-5)


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


def fold(z: np.ndarray) -> Local:
    """A valley with a sharp bottom along a parabola, and a limit: one gradient sees one side."""
    x, y = 2.0 * z - 0.5
    side = 1.0 if y > x**2 else -1.0
    cost = 10.0 * side * (y - x**2) + (x - 0.8) ** 2
    slope = np.array([-20.0 * side * x + 2.0 * (x - 0.8), 10.0 * side])
    return Local((rows(cost, 2.0 * slope),), (rows(x + y - 0.9, [2.0, 2.0]),))


# On the fold y = x^2 and the limit x + y = 0.9: x = (sqrt(4.6) - 1)/2.
FOLDED = (np.sqrt(4.6) - 1.0) / 2.0


def test_the_bottom_of_a_fold_is_followed_to_its_end() -> None:
    for s in run(lambda zs: [fold(z) for z in zs], [[0.1, 0.9], [0.3, 0.2], [0.45, 0.35]]):
        assert s.best_local is not None
        assert s.best_local.violation == 0.0
        assert s.best_local.cost == pytest.approx((FOLDED - 0.8) ** 2, abs=1e-6)


def test_evolution_finds_the_end_of_the_fold_without_slopes() -> None:
    def look(zs: np.ndarray) -> list[Local | str]:
        flat = [fold(z) for z in zs]
        return [
            Local(*(tuple(r._replace(slopes=r.slopes[:, :0]) for r in terms) for terms in x))
            if z[0] < 0.95
            else "no run here"
            for x, z in zip(flat, zs, strict=True)
        ]

    before = np.random.get_state(legacy=False)["state"]["key"].copy()
    (s,) = run(look, [[0.1, 0.9]], 300, Cma())
    assert s.status == CONVERGED
    assert s.best_local is not None
    assert s.best_local.violation == 0.0
    assert s.best_local.cost == pytest.approx((FOLDED - 0.8) ** 2, abs=1e-5)
    np.testing.assert_array_equal(np.random.get_state(legacy=False)["state"]["key"], before)


@pytest.mark.parametrize("name", SOLVERS.names())
def test_one_gain_and_a_limit(name: str) -> None:
    def look(zs: np.ndarray) -> list[Local | str]:
        return [
            Local((rows((z - 0.9) ** 2, 2.0 * (z - 0.9)),), (rows(z - 0.5, [1.0]),)) for z in zs
        ]

    (s,) = run(look, [[0.2]], 200, SOLVERS.find(name)())
    assert s.best is not None
    assert s.best_local is not None
    assert s.best_local.violation == 0.0
    assert s.best[0] == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("name", SOLVERS.names())
def test_a_solver_written_down_goes_on_as_if_it_had_not_stopped(name: str) -> None:
    def look(points: np.ndarray, _: Any) -> list[Local | str]:
        return [fold(z) for z in points]

    whole, first = SOLVERS.find(name)(), SOLVERS.find(name)()
    starts = [[0.1, 0.9], [0.3, 0.2]]
    states = begun(whole, lambda zs: look(zs, None), starts)
    halves = begun(first, lambda zs: look(zs, None), starts)
    for k in range(12):
        if k == 6:
            second = SOLVERS.find(name)()
            halves = [
                dataclasses.replace(s, memory=second.restore(plain(first.dump(s.memory))))
                for s in halves
            ]
            first = second
        states = whole.advance(states, look, 1e-7, 99)
        halves = first.advance(halves, look, 1e-7, 99)
    for s, other in zip(states, halves, strict=True):
        np.testing.assert_array_equal(s.z, other.z)
        assert s.rank == other.rank


def plain(table: Any) -> Any:
    """As it comes back from a file."""
    return json.loads(json.dumps(table, default=lambda a: a.tolist()))


def test_violated_limits_are_cut_as_far_as_they_go() -> None:
    # z <= 0.2 and z >= 0.6 exclude each other; the sum of the excesses is least between.
    def look(zs: np.ndarray) -> list[Local | str]:
        limits = [(rows(z - 0.2, [1.0]), rows(0.6 - z, [-1.0])) for z in zs]
        return [Local((rows(z, [1.0]),), x) for z, x in zip(zs, limits, strict=True)]

    (s,) = run(look, [[0.9]])
    assert s.best_local is not None
    assert 0.2 <= s.z[0] <= 0.6
    assert s.best_local.violation > 0.1


# --- the objective as rows ------------------------------------------------------------------


def test_rows_reduce_to_the_numbers_of_the_objective() -> None:
    values = np.random.default_rng(0).normal(size=(9, 1, 2))
    slopes = np.random.default_rng(1).normal(size=(9, 1, 2, 3))
    for over in ("mean", "worst", 0.8):
        objective = Objective((Goal("a", 2.0, over),), (Limit("b", 0.5, over),))
        local = localise(objective, ("a", "b"), values, slopes)
        (goal,), (limit,) = objective
        assert local.cost == pytest.approx(2.0 * goal.reduce(values[:, 0, 0]), rel=1e-12)
        excess = (limit.reduce(values[:, 0, 1]) - 0.5) / 0.5 + RESERVE
        assert local.excess[0] == pytest.approx(excess, rel=1e-12)
        moved = localise(objective, ("a", "b"), values + 1e-7 * slopes @ np.ones(3), slopes)
        row = int(np.argmax(local.goals[0].values))
        fall = 2.0 * float(local.goals[0].slopes[row].sum())
        assert (moved.cost - local.cost) / 1e-7 == pytest.approx(fall, rel=1e-5)


@pytest.mark.parametrize("q", [0.5, 0.9])
def test_a_quantile_to_be_minimised_is_that_of_harrell_and_davis(q: float) -> None:
    values = np.random.default_rng(2).gamma(2.0, size=40)
    wanted = float(mstats.hdquantiles(values, [q])[0])
    assert Goal("a", 1.0, q).reduce(values) == pytest.approx(wanted, rel=1e-9)
    # As many values as one likes: the quantile itself; gamma(2) has 1 - (1 + x) exp(-x) below x.
    many = np.random.default_rng(3).gamma(2.0, size=200_000)
    x = Goal("a", 1.0, q).reduce(many)
    assert 1.0 - (1.0 + x) * np.exp(-x) == pytest.approx(q, abs=3e-3)


def test_a_quantile_to_be_minimised_has_no_jump_where_runs_change_places() -> None:
    """|z - a| over 21 drives: the slope of the counted quantile jumps by 2 at every change."""
    a = np.linspace(0.0, 1.0, 21)
    goal = Objective((Goal("m", 1.0, 0.9),), ())
    counted = Objective((), (Limit("m", 1.0, 0.9),))

    def slopes(objective: Objective) -> np.ndarray:
        found = []
        for z in np.linspace(0.3, 0.7, 101):
            values, rates = np.abs(z - a), np.sign(z - a)
            local = localise(objective, ("m",), values[:, None, None], rates[:, None, None, None])
            found.append(float((*local.goals, *local.limits)[0].slopes[0, 0]))
        return np.array(found)

    jump = np.abs(np.diff(slopes(counted))).max()
    assert jump == pytest.approx(2.0)
    assert np.abs(np.diff(slopes(goal))).max() < 0.25 * jump


def test_a_quantile_of_a_limit_is_counted() -> None:
    values = np.array([5.0, 1.0, 4.0, 2.0, 3.0])
    assert Limit("a", 4.0, 0.75).reduce(values) == 4.0
    assert Limit("a", 2.0, 0.75, least=True).reduce(values) == 2.0


def test_what_is_never_reached_by_a_few_leaves_the_median_alone() -> None:
    values = np.concatenate([np.linspace(1.0, 2.0, 99), [np.inf]])
    assert 1.4 < Goal("a", 1.0, 0.5).reduce(values) < 1.6


def test_a_mean_is_taken_over_the_sample_and_a_worst_case_over_all() -> None:
    values = np.array([1.0, 3.0, 8.0]).reshape(3, 1, 1)
    slopes = np.array([10.0, 30.0, 80.0]).reshape(3, 1, 1, 1)
    objective = Objective((Goal("a", 1.0, "mean"),), (Limit("a", 2.0, "worst"),))
    local = localise(objective, ("a",), values, slopes, np.array([True, True, False]))
    assert local.goals[0].values == pytest.approx([2.0])
    assert local.goals[0].slopes == pytest.approx(np.array([[20.0]]))
    assert local.limits[0].values.max() == pytest.approx(3.0 + RESERVE)
    assert local.limits[0].source.tolist() == [0, 1, 2]
