"""What a tuning run says of its law: the certificate, the price of limits, sensitivities."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_tuning import searched, study
from typer.testing import CliRunner

from jaxsim._simulate import simulate
from jaxsim.command import app
from jaxsim.hybrid import Plain
from jaxsim.metric import unit_of
from jaxsim.objective import Limit
from jaxsim.provenance import write_toml
from jaxsim.study import from_table
from tuning import figures, page, report, space
from tuning.phase import SCREEN
from tuning.problem import Outcome
from tuning.result import Result, conclude, prices
from tuning.session import Session, resume
from tuning.spec import read_spec
from tuning.words import price, quantity, sentences


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return searched(study(), tmp_path_factory.mktemp("finished"))


@pytest.fixture(scope="module")
def result(finished: Session) -> Result:
    return conclude(finished)


def test_certificate_covers_every_gain_of_the_objective_in_both_cases(
    finished: Session, result: Result
) -> None:
    found = result.certificate.components
    assert {(c.metric, c.gain, c.case) for c in found} == {
        (m, f.name, case)
        for m in finished.problem.metrics
        for f in finished.spec.free
        for case in result.cases
    }
    assert result.certificate.counts == {"right": len(found)}
    torques = result.after.values["largest_torque_Nm"][:, 0, 0]
    pressing = [v.limit.metric for v in result.verdicts if v.price > 0.0]
    if pressing == ["largest_torque_Nm"]:
        assert result.worst.drive == int(np.argmax(torques))


def test_differences_and_sensitivities_are_those_of_single_runs(
    finished: Session, result: Result
) -> None:
    case, k, h = result.worst, 1, 1e-4

    def value(gain: float, metric: str) -> float:
        gains = result.gains.copy()
        gains[k] = gain
        law = space.with_gains(finished.study.law, finished.spec.free, gains)
        scenario = finished.study.scenario
        run = simulate(finished.problem.drive(case.drive), law, scenario, store=None)
        return float(run.metrics[metric])

    p = float(result.gains[k])
    for metric in ("itae_rad_s2", "command_rms"):
        pair = value(p * (1.0 + h), metric), value(p * (1.0 - h), metric)
        slope = (pair[0] - pair[1]) / (2.0 * h * p)
        share = [
            x.share
            for x in result.certificate.sensitivities
            if (x.metric, x.gain, x.case) == (metric, finished.spec.free[k].name, case)
        ]
        assert share == [pytest.approx(slope * p / value(p, metric), rel=1e-3)]
        for c in result.certificate.components:
            if (c.metric, c.gain, c.case) == (metric, finished.spec.free[k].name, case):
                assert c.differences[2] == pytest.approx(slope, rel=1e-6)


def test_plain_gradients_are_called_wrong(tmp_path: Path) -> None:
    table = study().table | {"run": {"deadzone": "plain"}}
    session = searched(from_table(table, Path(), "short"), tmp_path)
    assert isinstance(session.study.run.deadzone, Plain)
    counts = conclude(session).certificate.counts
    assert counts.get("wrong", 0) + counts.get("jumps", 0) > 0


def test_price_is_what_another_bound_buys_also_after_resume(
    finished: Session, result: Result, tmp_path: Path
) -> None:
    more = 0.01
    active = [v for v in result.verdicts if v.price > 0.0]
    assert active
    for v in active:
        limits = {x.limit.metric: x.limit.bound for x in result.verdicts}
        limits[v.limit.metric] *= 1.0 + more
        other = searched(study(limits=limits), tmp_path / v.limit.metric)
        saved = result.searched - other.progress().cost
        assert saved == pytest.approx(v.price * more * v.limit.bound, rel=0.1)

    again = Session(study(), read_spec(study()), finished.file)
    resume(again)
    told = [prices(s, s.best(), on_all_drives(s)) for s in (again, finished)]
    assert told[0] == pytest.approx(told[1], rel=1e-6)


def on_all_drives(session: Session) -> Outcome:
    best = session.best().best
    assert best is not None
    return session.problem.evaluate(best[None], np.arange(session.spec.count))


def test_price_is_told_in_the_units_of_goal_and_limit(finished: Session, result: Result) -> None:
    v = next(v for v in result.verdicts if v.price > 0.0)
    told = v._replace(limit=Limit("largest_torque_Nm", 1.5, "worst"), price=3e-4)
    assert price(finished, result, told).startswith(
        "0.1 Nm more would buy 3e-05 rad s² of itae_rad_s2"
    )
    assert quantity(0.003, "settle_2pct_s") == "3 ms"
    assert unit_of("entry_speed_rad_s") == "rad/s"
    assert unit_of("command_peak") == ""
    assert unit_of("command_peak", "V") == "V"


@pytest.mark.slow
def test_stability_criteria_count_among_the_evidence(tmp_path: Path) -> None:
    # They are no metrics of a run: a run that is asked for everything leaves them out.
    session = searched(study(limits={"rightmost_pole_per_s": -20.0}, iterations=2), tmp_path)
    result = conclude(session)
    assert result.verdicts[0].value <= -20.0
    assert "rightmost_pole_per_s" in result.after.values
    assert "command_rms" in result.after.values
    assert any("rightmost_pole_per_s <= -20 holds" in line for line in sentences(session, result))


def test_an_interrupted_search_does_not_call_its_limits_impossible(
    finished: Session, result: Result
) -> None:
    v = result.verdicts[0]
    broken = v._replace(value=v.limit.bound + 1.0)
    early = result._replace(status="interrupted", verdicts=(broken, *result.verdicts[1:]))
    assert sentences(finished, early)[0] == (
        "No feasible law was found yet: largest_torque_Nm beyond the limit. "
        "The search ended early: interrupted."
    )
    ended = early._replace(status="converged")
    assert sentences(finished, ended)[0].startswith("NO FEASIBLE LAW was found")


def test_an_interrupted_screen_ends_in_nothing_worse_than_the_given_law(tmp_path: Path) -> None:
    def stop(progress: Any) -> None:
        raise KeyboardInterrupt

    what = study(
        limits={"largest_torque_Nm": 5.0, "iae_rad_s": 1.0},
        drives={"count": 3, "screen": 1, "spread": {"half_gap": "20 %", "J_L": "20 %"}},
    )
    session = searched(what, tmp_path, stop)
    assert session.phase.stage == SCREEN
    # The start from elsewhere, as if it had looked best on the few drives of the screen.
    best = min(session.states[1:], key=lambda s: s.rank)
    worse = dataclasses.replace(best, best=np.array([1.0, 0.0]))
    session.states = [worse]
    result = conclude(session)
    objective = session.spec.objective
    assert result.after.cost(objective) == pytest.approx(result.before.cost(objective), rel=1e-9)


def test_folder_holds_the_evidence_and_one_html_page(
    finished: Session, result: Result, tmp_path: Path
) -> None:
    report.write(finished, result, tmp_path)
    content = json.loads((tmp_path / "result.json").read_text())
    assert content["certificate"]["verdicts"] == result.certificate.counts
    assert content["certificate"]["components"][0]["case"]["parameters"]["half_gap"] == 7.8e-3
    assert content["seed"] == finished.spec.seed
    assert content["versions"]["jax"]
    with (tmp_path / "sensitivity.csv").open() as file:
        rows = {(row["case"], row["metric"]): row for row in csv.DictReader(file)}
    nominal = rows["the study's drive", "itae_rad_s2"]
    assert {"K_B", "K_P"} < set(nominal)

    page.write(finished, result, tmp_path)
    bare = (tmp_path / "report.html").read_text("utf-8")
    assert "<img" not in bare  # nothing is told of pictures that were not drawn
    figures.draw(finished, result, tmp_path)
    page.write(finished, result, tmp_path)
    whole = (tmp_path / "report.html").read_text("utf-8")
    assert whole.count("<img") == len(figures.FILES)
    first = sentences(finished, result)[0]
    assert first in whole
    assert "http" not in whole.split("</style>")[1].split("<h2")[0]


def test_mistakes_in_what_is_asked_for_beside_are_told_before_the_search(tmp_path: Path) -> None:
    file, out = tmp_path / "mine.toml", tmp_path / "out"
    write_toml(file, study().table)
    for option, pair, message in (
        ("--front", ("itae_rads2", "command_rms"), "did you mean itae_rad_s2"),
        ("--map", ("K_P", "K_Bee"), "did you mean"),
    ):
        done = CliRunner().invoke(app, ["tune", str(file), option, *pair, "--out", str(out)])
        assert done.exit_code != 0
        assert message in " ".join(done.output.split())
    assert not out.exists()


@pytest.mark.slow
def test_front_and_map_asked_for_beside_are_on_the_page(tmp_path: Path) -> None:
    file, out = tmp_path / "mine.toml", tmp_path / "out"
    write_toml(file, study(iterations=10).table)
    front = ["--front", "itae_rad_s2", "largest_torque_Nm"]
    options = [*front, "--map", "K_P", "K_B", "--out", str(out)]
    done = CliRunner().invoke(app, ["tune", str(file), *options])
    assert done.exit_code == 0, done.output
    page = (out / "report.html").read_text("utf-8")
    assert page.count("<img") == len(figures.FILES) + 2
    assert "Front between itae_rad_s2 and largest_torque_Nm" in page
    assert "Map of K_P and K_B" in page
    assert (out / "front" / "laws" / "00.toml").exists()
    assert (out / "map" / "map.csv").exists()
