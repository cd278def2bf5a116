"""Tuning for several scenarios at once, and how a study file names them."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_tuning import searched, study
from typer.testing import CliRunner

from jaxsim._simulate import simulate
from jaxsim.command import app
from jaxsim.commands.new import commented
from jaxsim.errors import InputError
from jaxsim.objective import Goal, Limit, Objective
from jaxsim.provenance import write_toml
from jaxsim.study import Study, from_table, load
from tuning import space
from tuning.local import RESERVE, localise
from tuning.problem import Outcome, Problem
from tuning.scoring import Scores, score
from tuning.spec import read_spec


def several(**tune: Any) -> Study:
    """The short study in three scenarios, the last one shorter; the first is that of `study`."""
    table = copy.deepcopy(study(**tune).table)
    step = {"type": "step", "at": 0.01}
    table["scenarios"] = {
        "large": {},
        "small": {"reference": {**step, "size": 0.1}, "start": {"theta_B": 7e-3}},
        "brief": {"reference": {**step, "size": 0.2}, "duration": 0.06},
    }
    return from_table(table, Path(), "several")


def test_scenarios_are_those_of_single_runs_and_count_in_limits() -> None:
    what = several()
    problem = Problem(what, read_spec(what))
    z = np.array([[0.45, 0.55], [0.6, 0.2]])
    outcome = problem.evaluate(z, np.array([0, 2]))
    assert outcome.values.shape == (2, 2, 3, 3)
    assert outcome.status.shape == (2, 2, 3)
    law = space.with_gains(what.law, problem.spec.free, space.to_gains(problem.spec.free, z[1]))
    for c, scenario in enumerate(what.scenarios.values()):
        run = simulate(problem.drive(2), law, scenario, metrics=problem.metrics, store=None)
        wanted = [float(run.metrics[name]) for name in problem.metrics]
        np.testing.assert_allclose(outcome.values[1, 1, c], wanted, rtol=1e-9)

    torque = outcome.values[1, ..., problem.metrics.index("largest_torque_Nm")]
    place = np.unravel_index(int(np.argmax(torque)), torque.shape)
    (scores,) = score(
        problem, [space.to_gains(problem.spec.free, z[1])], np.array([0, 2]), 2e-4, None
    )
    found = scores.worst("largest_torque_Nm", problem.spec.objective)
    assert found[1:] == place
    assert found[0] == pytest.approx(torque.max(), rel=1e-9)
    assert problem.label(2, int(place[1])).endswith("in large")
    local = localise(problem.spec.objective, problem.metrics, *(a[1] for a in outcome[:2]))
    excess = dict(zip((x.metric for x in problem.spec.objective.limits), local.excess, strict=True))
    assert excess["largest_torque_Nm"] == pytest.approx(torque.max() / 1.5 - 1.0 + RESERVE)


def test_a_failure_is_named_with_its_scenario(monkeypatch: Any, tmp_path: Path) -> None:
    def fails(
        self: Problem, points: np.ndarray, drives: np.ndarray, *, slopes: bool = True
    ) -> Outcome:
        shape = (len(points), len(drives), 3)
        values = np.ones((*shape, 3))
        values[:, 1, 2, 0] = np.inf
        return Outcome(values, np.ones((*shape, 3, 2)), np.zeros(shape, int))

    monkeypatch.setattr(Problem, "evaluate", fails)
    with pytest.raises(InputError, match=r"drive 1 \(.*\) in brief: itae_rad_s2 or its slope"):
        searched(several(), tmp_path)


@pytest.mark.parametrize(
    ("scenarios", "message"),
    [
        ({}, "scenarios: must be tables"),
        ({"a": 3}, r"scenarios\.a: must be a table"),
        ({"a": {}, "b": {"durations": 1.0}}, r"scenarios\.b\.durations: .*did you mean duration"),
        ({"a": {"duration": "1 rad"}}, r"scenarios\.a\.duration"),
        ({"a": {"duration": 0.10005}}, "must divide the duration"),
    ],
)
def test_mistakes_in_scenarios_are_one_clear_message(scenarios: Any, message: str) -> None:
    table = study().table | {"scenarios": scenarios}
    with pytest.raises(InputError, match=message):
        from_table(table, Path(), "several")


def test_one_scenario_is_simulated_and_all_are_written_anew(tmp_path: Path) -> None:
    what = several()
    assert list(what.scenarios) == ["large", "small", "brief"]
    assert what.scenario is what.scenarios["large"]
    assert what.in_scenario("brief").scenario.duration == 0.06
    with pytest.raises(InputError, match="did you mean small"):
        what.in_scenario("smal")

    file = tmp_path / "several.toml"
    file.write_text(commented(what, "several"), "utf-8")
    again = load(str(file))
    assert again.scenarios == what.scenarios
    write_toml(file, what.table)
    done = CliRunner().invoke(app, ["simulate", str(file), "--scenario", "bri"])
    assert "did you mean brief" in done.output


def test_the_worst_of_what_must_be_large_is_its_smallest_value() -> None:
    objective = Objective(
        (Goal("a", 1.0, "mean"),), (Limit("b", 6.0, "worst", least=True), Limit("a", 9.0, "worst"))
    )
    values = np.array([[[1.0, -7.0], [2.0, 3.0]], [[4.0, 5.0], [-9.0, 0.5]]])
    scores = Scores(dict.fromkeys(("a", "b", "c"), values), np.zeros((2, 2), int))
    assert scores.worst("a", objective) == (5.0, 1, 0)
    assert scores.worst("b", objective) == (-9.0, 1, 1)
    assert scores.worst("c", objective) == (-9.0, 1, 1)  # no direction is known: by size
    assert scores.of_case("a", 0, 0, objective) == 1.0
    assert scores.of_case("b", 0, 1, objective) == 2.0
