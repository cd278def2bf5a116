"""Fronts: a closed form, dominance and limits on the bench, and what the command writes."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tuning_cases import study
from typer.testing import CliRunner

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.command import app
from jaxsim.errors import InputError
from jaxsim.objective import Goal, Limit, Objective
from jaxsim.provenance import write_toml
from jaxsim.study import load
from tuning import front_checkpoint, space
from tuning.front import conclude
from tuning.pareto import Tracer, pair_of, tracer_of
from tuning.problem import Outcome
from tuning.spec import read_spec

A, B = np.array([0.2, 0.3]), np.array([0.8, 0.7])
PAIR = (Goal("a", 1.0, "mean"), Goal("b", 1.0, "worst"))


class Bowls:
    """Two goals |z - A|^2 and |z - B|^2: on their front sqrt(a) + sqrt(b) = |A - B|.

    With `concave`, |.|^2 becomes 1 - exp(-|.|^2/0.1): the same laws, a concave front.
    """

    metrics = ("a", "b")
    scenarios = ("one",)

    def __init__(self, concave: bool = False, limits: tuple[Limit, ...] = ()) -> None:
        self.concave = concave
        self.drives = np.zeros((1, 0))
        self.calls = 0
        self.study = study()
        self.spec = read_spec(self.study)._replace(
            spreads=(), drives=np.zeros((1, 0)), screen=1, iterations=60, tolerance=1e-7,
            objective=Objective(PAIR, limits),
        )  # fmt: skip

    def evaluate(self, points: np.ndarray, drives: np.ndarray, *, slopes: bool = True) -> Outcome:
        self.calls += 1
        apart = np.stack([points - A, points - B], axis=1)
        values, rates = (apart**2).sum(axis=-1), 2.0 * apart
        if self.concave:
            fall = np.exp(-values / 0.1)
            values, rates = 1.0 - fall, rates * fall[..., None] / 0.1
        shape = (len(points), 1, 1, 2)
        return Outcome(
            values.reshape(shape), rates.reshape(*shape, 2), np.zeros((len(points), 1, 1), int)
        )


def traced(problem: Any, points: int = 9) -> np.ndarray:
    tracer = Tracer(problem, PAIR, lambda progress: None)
    starts = np.array([[0.5, 0.5], [0.1, 0.9], [0.9, 0.2]])
    return np.array(tracer.trace(starts, points))


@pytest.mark.parametrize("concave", [False, True])
def test_front_is_the_segment_between_both_minima(concave: bool) -> None:
    laws = traced(Bowls(concave))
    to_A, to_B = (np.linalg.norm(laws - c, axis=-1) for c in (A, B))
    best = np.maximum(np.linalg.norm(A - B) - to_B, 0.0)  # the nearest to A at this distance from B

    def first(distance: np.ndarray) -> np.ndarray:
        return 1.0 - np.exp(-(distance**2) / 0.1) if concave else distance**2

    # The ends weigh the other goal by 1e-3; the reserve of a limit is 1e-4.
    np.testing.assert_allclose(first(to_A), first(best), atol=1e-3)
    along = np.sort((laws - A) @ (B - A) / float((B - A) @ (B - A)))
    assert along[0] < 2e-3
    assert along[-1] > 1.0 - 2e-3
    assert len(laws) == 9
    assert np.diff(along).max() < 0.3  # no wide gap is left, in the concave part either


def test_limits_of_the_study_cut_the_front() -> None:
    most = 0.25
    laws = traced(Bowls(limits=(Limit("b", most, "worst"),)))
    second = ((laws - B) ** 2).sum(axis=-1)
    assert second.max() <= most
    assert second.max() == pytest.approx(most, rel=1e-3)


def test_an_interrupt_keeps_the_front_known_by_then() -> None:
    def stop(progress: Any) -> None:
        if progress.what != "ends" and progress.iteration == 2:
            raise KeyboardInterrupt

    tracer = Tracer(Bowls(), PAIR, stop)  # type: ignore[arg-type]
    laws = np.array(tracer.trace(np.array([[0.5, 0.5], [0.1, 0.9]]), 9))
    assert tracer.interrupted
    assert len(laws) > 2
    values = np.stack([((laws - c) ** 2).sum(axis=-1) for c in (A, B)], axis=-1)
    for v in values:
        assert not (values < v).all(axis=-1).any()


def test_a_front_that_is_resumed_repeats_no_search_and_ends_as_it_would_have(
    tmp_path: Path,
) -> None:
    file, told = tmp_path / "checkpoint.json", []
    starts = np.array([[0.5, 0.5], [0.1, 0.9]])

    def stop(progress: Any) -> None:
        if progress.what == "points in the gaps" and progress.iteration == 2:
            raise KeyboardInterrupt

    broken = Tracer(Bowls(), PAIR, stop, file)  # type: ignore[arg-type]
    broken.trace(starts, 9)
    assert broken.interrupted
    again = Tracer(Bowls(), PAIR, lambda p: told.append(p.what), file)  # type: ignore[arg-type]
    front_checkpoint.read(again, 9, file)
    known = len(again.seen)
    assert known == len(broken.seen)
    laws = np.array(again.trace(starts, 9))
    assert list(dict.fromkeys(told)) == ["points in the gaps", "all points again"]
    assert not again.interrupted
    assert len(again.seen) > known
    to_A, to_B = (np.linalg.norm(laws - c, axis=-1) for c in (A, B))
    np.testing.assert_allclose(to_A + to_B, np.linalg.norm(A - B), atol=2e-3)
    with pytest.raises(InputError, match="must belong to this front"):
        front_checkpoint.read(again, 8, file)
    with pytest.raises(InputError, match="needs a checkpoint"):
        front_checkpoint.read(again, 9, tmp_path / "none.json")


def test_goals_are_reduced_as_the_objective_does() -> None:
    objective = read_spec(study()).objective
    first, second = pair_of(objective, ("command_rms", "largest_torque_Nm"))
    assert (first.over, second.over) == ("mean", "worst")
    with pytest.raises(InputError, match="did you mean itae_rad_s2"):
        pair_of(objective, ("itae_rads2", "command_rms"))
    with pytest.raises(InputError, match="another metric"):
        pair_of(objective, ("command_rms", "command_rms"))


def test_command_writes_laws_that_none_beats_and_that_keep_the_limits(tmp_path: Path) -> None:
    what = study(limits={"largest_torque_Nm": 1.5}, iterations=15)
    file, out = tmp_path / "mine.toml", tmp_path / "out"
    write_toml(file, what.table)
    goals = ["--between", "itae_rad_s2", "--and", "largest_torque_Nm"]
    options = ["--points", "5", "--out", str(out)]
    done = CliRunner().invoke(app, ["pareto", str(file), *goals, *options])
    assert done.exit_code == 0, done.output
    with (out / "front.csv").open() as table:
        rows = list(csv.DictReader(table))
    points = [r for r in rows if r["law"] != "study"]
    assert len(points) >= 4
    both = np.array([[float(v) for v in list(r.values())[1:3]] for r in points])
    assert (np.diff(both[:, 0]) < 0.0).all()
    assert (np.diff(both[:, 1]) > 0.0).all()
    assert both[:, 1].max() <= 1.5
    assert {p.name for p in out.iterdir()} == {
        "front.csv", "front.json", "laws", "pareto.png", "report.html", "checkpoint.json",
    }  # fmt: skip

    # A law of the front, run singly on every drive: its number in the table.
    law = load(str(file), law=str(out / "laws" / "02.toml")).law
    assert float(tree.get(law, "K_P")) == pytest.approx(float(points[2]["K_P"]), rel=1e-12)
    problem = tracer_of(what, read_spec(what), PAIR_OF_BENCH, lambda p: None).problem
    torques = [
        float(
            simulate(
                problem.drive(i), law, what.scenario, metrics=("largest_torque_Nm",), store=None
            ).metrics["largest_torque_Nm"]
        )
        for i in range(3)
    ]
    assert max(torques) == pytest.approx(both[2, 1], rel=1e-9)
    assert space.gains_of(law, problem.spec.free)[0] <= 0.0


def test_a_front_on_a_working_set_is_that_on_all_drives() -> None:
    spread = {"half_gap": "30 %", "J_L": "30 %"}
    drives = {"count": 48, "screen": 2, "spread": spread}
    few, every = (
        study(limits={"iae_rad_s": 0.009}, drives=drives | {"working": w}, iterations=20)
        for w in (3, 48)
    )
    fronts = []
    for what in (few, every):
        tracer = tracer_of(what, read_spec(what), WORST_OF_BENCH, lambda p: None)
        laws = tracer.trace(space.starting_points(what.law, read_spec(what)), 5)
        fronts.append(conclude(tracer, laws, {}))
        assert (len(tracer.drives) < 48) == (what is few)
        assert len(fronts[-1].drives) == 48
    found, wanted = (np.array([p.goals for p in f.points]) for f in fronts)
    assert len(found) >= 4
    assert all(p.scores.values["iae_rad_s"].max() <= 0.009 for p in fronts[0].points)
    for k in (0, -1):  # the ends
        np.testing.assert_allclose(found[k], wanted[k], rtol=2e-3)
    between = np.interp(found[:, 1], wanted[:, 1], wanted[:, 0])
    assert (found[:, 0] <= between * (1.0 + 2e-3)).all()  # chords lie above a convex front


PAIR_OF_BENCH = (Goal("itae_rad_s2", 1.0, "mean"), Goal("largest_torque_Nm", 1.0, "worst"))
WORST_OF_BENCH = (Goal("itae_rad_s2", 1.0, "worst"), Goal("largest_torque_Nm", 1.0, "worst"))
