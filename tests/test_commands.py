"""The commands of studies and runs: what they refuse, what they say, what they leave."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from jaxsim import certificate_report
from jaxsim._certify import STEPS, Row
from jaxsim.command import app
from jaxsim.study import load


def _gearlash(*words: str) -> tuple[int, str]:
    """Exit code and all that was said, in one line."""
    done = CliRunner().invoke(app, list(words))
    assert isinstance(done.exception, SystemExit | None), done.exception
    return done.exit_code, " ".join(done.output.split())


RESULTS = {
    "simulate": ("bench_switched", "metrics.json"),
    "certify": ("bench_switched", "certificate.json"),
    "analyse": ("bench_switched", "analysis.json"),
    "map": ("bench_switched --x K_P --y K_B", "map.json"),
    "pareto": ("bench_switched --between itae_rad_s2 --and overshoot_pct", "front.json"),
    "tune": ("bench_switched", "result.json"),
    "identify": ("simple_pendulum", "result.json"),
    "watch": ("simple_pendulum", "result.json"),
    "montecarlo": ("bench_switched", "chunks/plan.json"),
    "export": ("c bench_sampled", "law.c"),
    "train": ("backlash_position", "state.json"),
}


@pytest.mark.parametrize("command", RESULTS)
def test_no_command_overwrites_results(command: str, tmp_path: Path) -> None:
    arguments, name = RESULTS[command]
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("mine", "utf-8")
    code, said = _gearlash(command, *arguments.split(), "--out", str(tmp_path))
    assert code == 2
    assert "--out: must not hold results already" in said
    assert "name another place" in said
    assert file.read_text("utf-8") == "mine"
    assert [p.name for p in tmp_path.iterdir()] == [Path(name).parts[0]]


def test_a_run_is_told_with_units_and_whether_the_limits_hold(tmp_path: Path) -> None:
    """On twice the gap of the study's reserve; the numbers are those of metrics.json."""
    code, said = _gearlash(
        "simulate", "bench_switched", "--set", "half_gap=0.01", "--out", *_in(tmp_path)
    )
    assert code == 0
    numbers = json.loads((tmp_path / "out" / "metrics.json").read_text("utf-8"))["metrics"]
    assert numbers["largest_torque_Nm"] > 1.4
    assert numbers["overshoot_pct"] > 3.0
    told = f"largest_torque_Nm = {numbers['largest_torque_Nm']:.6g} Nm is not <= 1.4"
    assert f"Limits of the study are broken: {told}; overshoot_pct" in said
    assert f"{numbers['itae_rad_s2']:.6g} rad s²" in said
    assert "0 Hz no limit cycle" in said
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert told in page.replace("&lt;", "<")
    assert page.count("<img") == 1
    code, said = _gearlash("simulate", "bench_switched")
    assert (code, "All limits of the study (2) hold in this run." in said) == (0, True)


def test_an_analysis_has_a_page_with_its_figures(tmp_path: Path) -> None:
    code, said = _gearlash("analyse", "bench_switched", "--out", *_in(tmp_path))
    assert code == 0, said
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    figures = json.loads((tmp_path / "out" / "analysis.json").read_text("utf-8"))["figures"]
    assert page.count("<img") == len(figures) == 3
    assert "Stable in contact; in the gap nothing holds the load" in page


def test_a_certificate_has_a_page_with_its_verdict(tmp_path: Path) -> None:
    """d x^2/dx at 2 is 4; one gradient that is wrong, and one of a metric that jumps."""
    rough = tuple(4.0 + h * h for h in STEPS)
    right = Row("a_Nm", "law.K_B", "Nm s/rad", 2.0, 2.0, 4.0, 4.0, rough, 1e-8, "right")
    wrong = right._replace(parameter="law.K_P", forward=5.0, verdict="wrong")
    jumps = right._replace(metric="b_s", verdict="jumps")
    certificate_report.write(tmp_path, load("bench_switched"), [right, wrong, jumps])
    assert {p.name for p in tmp_path.iterdir()} == set(certificate_report.FILES)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert page.count("<img") == 1
    for told in ("1 of 3 gradients are wrong.", "a_Nm is wrong for K_P.", "b_s jumps with K_B."):
        assert told in page
    assert certificate_report.summary([right]).mood == "good"


def _in(folder: Path) -> tuple[str]:
    return (str(folder / "out"),)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["simulate", "bench_switched", "--law", "bench_swiched"], "--law: must be a known name"),
        (["simulate", "bench_switched", "--law", "no.toml"], "--law: must be a file"),
        (["simulate", "bench_switched", "--scenario", "x"], "--scenario: must be a known name"),
        (["simulate", "bench_switched", "--set", "K_C=1"], "--set K_C: must be a known name"),
        (["simulate", "bench_switched", "--set", "K=nan"], "--set K: must be a number, not nan"),
        (["simulate", "bench_switched", "--set", "K=-1"], "--set K: must be > 0; got -1.0"),
        (["certify", "bench_switched", "--metric", "itae"], "--metric: must be a known name"),
        (["certify", "bench_switched", "--parameter", "K_C"], "--parameter: must be a known name"),
        (["map", "bench_switched", "--x", "K_C", "--y", "K_P", "--out", "m"], "--x: must be"),
        (["train", "backlash_positon", "--out", "t"], "task: must be a known name"),
    ],
)
def test_a_mistake_is_told_under_the_option_that_was_typed(words: list[str], message: str) -> None:
    code, said = _gearlash(*words)
    assert code == 2
    assert message in said
