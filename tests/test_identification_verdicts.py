"""Verdicts that are taken back: logs whose model is wrong in a known way."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import identification_logs as logs
import numpy as np
import pytest
from scipy.stats import kstest
from test_identification_intervals import NOISE, offset_problem
from typer.testing import CliRunner

from jaxsim import tree
from jaxsim.command import app
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.study import from_table
from tuning.identification import uncertainty
from tuning.identification.estimator import fit
from tuning.identification.parts import Pulled, pulled
from tuning.identification.report import exit_code, sentences
from tuning.identification.robust import Squares
from tuning.identification.session import Outcome, identify
from tuning.identification.spec import read_spec


def _identified(folder: Path, made_by: dict[str, float], **section: Any) -> Outcome:
    """The study's four unknowns on a log of a bench that differs from it in something else."""
    logs.write_csv(folder / "log.csv", logs.chirp(), tree.replace(bench_2018(), made_by))
    table = tomllib.loads(logs.STUDY)
    table["identify"] |= {"experiments": [{"log": "log.csv"}], **section}
    study = from_table(table, folder, "study")
    return identify(study, read_spec(study))


def test_a_wrong_inertia_contradicts_what_comes_out_with_small_errors(tmp_path: Path) -> None:
    """J_M 10 % off and held: the half gap comes out 10 % wrong, with an error of 0.2 %."""
    outcome = _identified(tmp_path, {"J_M": 1.1 * 8.78e-4})
    off = np.abs(outcome.values / logs.TRUTH - 1.0)
    assert off[0] > 5.0 * outcome.seen.deviation[0] / outcome.values[0]  # the interval is wrong
    assert [v.kind for v in outcome.verdicts] == ["contradicted"] * 4
    assert exit_code(outcome) == 1
    words = sentences(outcome)
    assert words[0].startswith("0 of 4 parameters are determined by 1 log. 4 CONTRADICTED")
    assert "Of T_s 2." in words[1]  # T_s noise is given, and 2.3 times of it are left
    assert "J_L" in next(p.name for p in outcome.parts if p.p < 1e-6)


def test_a_log_that_the_model_cannot_follow_ends_with_1(tmp_path: Path) -> None:
    """Half the friction of the load that is there: half the scatter of the angles is left."""
    logs.write_csv(tmp_path / "a.csv", logs.chirp(), tree.replace(bench_2018(), {"D_L": 0.072}))
    text = logs.STUDY.partition("[[identify.experiments]]")[0]
    (tmp_path / "s.toml").write_text(f'{text}[[identify.experiments]]\nlog = "a.csv"\n', "utf-8")
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["identify", str(tmp_path / "s.toml"), "--out", str(out)])
    assert done.exit_code == 1, done.output
    result = json.loads((out / "result.json").read_text("utf-8"))
    assert {p["verdict"] for p in result["parameters"]} <= {"contradicted", "not visible"}
    assert "in a pattern" in " ".join(result["doubts"])
    table = tomllib.loads((out / "drive.toml").read_text("utf-8"))
    kinds = [row["verdict"] for row in table["identified"].values()]
    assert kinds == [p["verdict"] for p in result["parameters"]]
    assert "contradicted" in kinds


def test_what_is_not_visible_ends_with_3_and_a_bound_with_1(tmp_path: Path) -> None:
    free = {"K": {"lower": 60, "upper": 1500}, "D_B": {"lower": 0.02, "upper": 0.5}}
    seen = _identified(tmp_path, {"half_gap": 1e-6}, free=free)
    assert exit_code(seen) == 1  # the play that the study assumes is not there
    drive = {"preset": "bench_2018", "half_gap": "7.8 mrad"}
    table = tomllib.loads(logs.STUDY) | {"drive": drive}
    logs.write_csv(tmp_path / "log.csv", 0.5 + 0.1 * logs.chirp(amplitude=1.0))
    half_gap = {"half_gap": {"lower": "2 mrad", "upper": "40 mrad"}}
    table["identify"] |= {"experiments": [{"log": "log.csv"}], "free": half_gap | free}
    study = from_table(table, tmp_path, "study")
    outcome = identify(study, read_spec(study))
    assert outcome.verdicts[0].kind == "not visible"
    assert exit_code(outcome) == 3
    stiff = {"K": {"lower": 310, "upper": 1500}, "D_B": {"lower": 0.02, "upper": 0.5}}
    table["identify"] |= {"free": stiff}
    bound = from_table(table, tmp_path, "study")
    verdict = identify(bound, read_spec(bound)).verdicts[0]
    assert verdict.kind == "contradicted"
    assert "lies on its bound" in verdict.why


def _parts(noise: np.ndarray) -> list[Pulled]:
    """What the thirds of each log say about an offset, each log fitted alone."""
    found = []
    problem = offset_problem(noise)
    who = np.arange(len(noise))[:, None]
    values = fit(problem, np.zeros((len(noise), 1)), who=who).values
    seen = problem.evaluate(values, who=who)
    for i, own in enumerate(who):
        known = uncertainty.covariance(problem, seen, values[i], Squares(), row=i, who=own)
        mine = type(seen)(*(v[i : i + 1] for v in seen))
        found += pulled(problem, mine, values[i], known, Squares(), own)
    return found


def test_thirds_of_a_log_pull_as_chance_has_it_and_no_more() -> None:
    """White noise: the chance is a chance, spread evenly; a step in the last third is told."""
    noise = NOISE * np.random.default_rng(4).standard_normal((128, logs.SAMPLES))
    assert kstest([p.p for p in _parts(noise)], "uniform").pvalue > 0.01
    noise[:, 200:] += NOISE
    stepped = _parts(noise)
    # The step makes the residuals coloured, and so the errors larger: it is told all the same.
    assert np.median([p.p for p in stepped]) < 0.2
    last = [f"the last third of theta_L of {i}" for i in range(128)]
    assert np.mean([p.furthest == name for p, name in zip(stepped, last, strict=True)]) > 0.9
    for part, name, own in zip(stepped, last, noise, strict=True):
        if part.furthest == name:
            assert part.to == pytest.approx(own[200:].mean(), abs=1e-7)
