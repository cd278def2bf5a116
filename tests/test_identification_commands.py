"""gearlash identify, watch and design-experiment on logs as people have them."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import identification_logs as logs
import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from jaxsim import tree
from jaxsim.command import app
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.errors import InputError
from jaxsim.hybrid import Smoothed
from jaxsim.study import from_table
from tuning.identification.session import identify
from tuning.identification.spec import read_spec
from tuning.log import read_log


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three logs of one bench (a, b, c), and one of another (d)."""
    path = tmp_path_factory.mktemp("logs")
    for seed, (name, to) in enumerate({"a": 40.0, "b": 30.0, "c": 50.0}.items()):
        logs.write_csv(path / f"{name}.csv", logs.chirp(to), seed=seed)
    other = tree.replace(bench_2018(), {"J_L": 1.2 * logs.TRUTH[3]})
    logs.write_csv(path / "d.csv", logs.chirp(30.0), other, seed=7)
    (path / "bench.toml").write_text(logs.STUDY, "utf-8")
    return path


def test_the_command_leaves_a_drive_that_others_read(folder: Path) -> None:
    out = folder / "out"
    text = logs.STUDY.replace("starts = 2", 'starts = 2\nprofile = ["half_gap"]')
    (folder / "profiled.toml").write_text(text, "utf-8")
    done = CliRunner().invoke(app, ["identify", str(folder / "profiled.toml"), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "4 of 4 parameters are determined by 2 logs; 1 more were held out." in done.output
    result = json.loads((out / "result.json").read_text("utf-8"))
    assert any("plain regression of the readings gives" in words for words in result["words"])
    for row, truth in zip(result["parameters"], logs.TRUTH, strict=True):
        assert abs(row["value"] / truth - 1.0) < 1e-3
        assert row["low"] < row["value"] < row["high"]
    (profile,) = result["profiles"]
    gap = result["parameters"][0]
    np.testing.assert_allclose(profile["interval"], [gap["low"], gap["high"]], rtol=2e-5)
    held_out = [row for row in result["experiments"] if row["use"] == "held out"]
    torque = next(row for row in held_out if row["signal"] == "T_s")
    assert torque["rms after"] == pytest.approx(logs.TORQUE_NOISE, rel=0.15)
    table = tomllib.loads((out / "drive.toml").read_text("utf-8"))
    assert table["identified"]["K"]["verdict"] == "determined"
    again = {"drive": {"file": str(out / "drive.toml")}, "law": {"type": "feedforward"}}
    drive = from_table(again, out, "again").drive
    assert float(tree.get(drive, "half_gap")) == pytest.approx(gap["value"], rel=1e-12)
    assert (out / "report.html").stat().st_size > 100_000
    for name in ("fit_a.png", "residuals.png", "profile_half_gap.png", "logs_alone.png"):
        assert (out / name).stat().st_size > 10_000


def _identified(
    folder: Path, recordings: list[dict[str, Any]], drive: Any = None, **section: Any
) -> Any:
    table = tomllib.loads(logs.STUDY)
    table["identify"] |= {"experiments": recordings, **section}
    table["drive"] = drive or table["drive"]
    study = from_table(table, folder, "study")
    return study, identify(study, read_spec(study))


def test_two_machines_are_told_apart(folder: Path) -> None:
    _, outcome = _identified(folder, [{"log": "a.csv"}, {"log": "b.csv"}, {"log": "d.csv"}])
    words = " ".join(outcome.doubts)
    assert "contradict each other about J_L" in words
    assert "Two machines" in words
    alone = next(a for a in outcome.alone if a.name == "J_L")
    # The encoders count for little beside what the compromise leaves of them: torque decides.
    np.testing.assert_allclose(alone.values[:2], logs.TRUTH[3], rtol=1e-2)
    np.testing.assert_allclose(alone.values[2], 1.2 * logs.TRUTH[3], rtol=1e-2)


def test_a_gap_that_is_never_crossed_is_not_visible(folder: Path) -> None:
    """A torque that always presses the same wall."""
    logs.write_csv(folder / "e.csv", 0.5 + 0.1 * logs.chirp(amplitude=1.0))
    _, outcome = _identified(folder, [{"log": "e.csv"}])
    verdict = outcome.verdicts[0]
    assert verdict.kind == "not visible"
    assert "never crosses the play" in verdict.why
    assert "reverse the joint torque" in verdict.advice


def test_only_a_combination_is_determined(folder: Path) -> None:
    """One encoder, pressed joint, slow torque: motor and load move as one body."""
    t = logs.TIMES
    whole = tree.replace(bench_2018(), {"half_gap": 0.0})
    logs.write_csv(folder / "f.csv", 0.4 + 0.3 * np.sin(2.0 * np.pi * 6.0 * t), whole)
    noisy = dict(read_log(folder / "f.csv").columns)
    noise = 2e-3 * np.random.default_rng(0).standard_normal(t.size)
    noisy["load [counts]"] = noisy["load [counts]"] + noise / logs.COUNT
    pl.DataFrame(noisy).write_csv(folder / "f.csv")
    columns = tomllib.loads(logs.STUDY)["identify"]["columns"]
    del columns["theta_M"], columns["T_s"]
    columns["theta_L"]["noise"] = "2 mrad"
    free = {
        "J_M": {"lower": 1e-4, "upper": 1e-2},
        "J_L": {"lower": 1e-4, "upper": 1e-2},
    }
    _, outcome = _identified(
        folder, [{"log": "f.csv"}], {"preset": "bench_2018", "half_gap": 0.0},
        columns=columns, free=free,
    )  # fmt: skip
    assert [v.kind for v in outcome.verdicts] == ["combination", "combination"]
    assert "leave no trace" in outcome.verdicts[0].why
    total = outcome.values.sum()
    assert total == pytest.approx(2.0 * 8.78e-4, rel=0.05)


def test_a_profile_of_an_unknown_name_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="did you mean half_gap"):
        _identified(folder, [{"log": "a.csv"}], profile=["half_gp"])


@pytest.mark.slow
def test_watch_raises_the_alarm_when_the_gap_grows(folder: Path) -> None:
    for i in range(4):
        worn = tree.replace(bench_2018(), {"half_gap": logs.TRUTH[0] * (1.0 + 0.04 * i)})
        logs.write_csv(folder / f"w{i}.csv", logs.chirp(), worn, seed=i)
    head = logs.STUDY.partition("[[identify.experiments]]")[0]
    section = '[identify.watch]\nhalf_gap = "8.6 mrad"\n[[identify.experiments]]\nlog = "w*.csv"\n'
    (folder / "watch.toml").write_text(head + section, "utf-8")
    out = folder / "watched"
    done = CliRunner().invoke(app, ["watch", str(folder / "watch.toml"), "--out", str(out)])
    assert done.exit_code == 1, done.output
    gap, *others = json.loads((out / "result.json").read_text("utf-8"))["trends"]
    np.testing.assert_allclose(
        gap["values"], logs.TRUTH[0] * (1.0 + 0.04 * np.arange(4)), rtol=1e-3
    )
    assert "is above" in gap["alarm"]
    assert "ALARM: half_gap" in (out / "report.html").read_text("utf-8")
    assert [t["alarm"] for t in others] == ["", "", ""]


@pytest.mark.slow
def test_a_designed_experiment_keeps_the_limit_and_beats_the_others(folder: Path) -> None:
    text = logs.STUDY.replace('unit = "deg"', 'unit = "deg", noise = "2 urad"')
    text = text.replace("counts = 1048576", 'counts = 1048576, noise = "2 urad"')
    text += (
        '[identify.design]\nlimit = 1.5\nduration = "0.3 s"\nperiod = "1 ms"\njoint_torque = 1.5\n'
    )
    (folder / "design.toml").write_text(text, "utf-8")
    out = folder / "designed"
    done = CliRunner().invoke(
        app, ["design-experiment", str(folder / "design.toml"), "--out", str(out)]
    )
    assert done.exit_code == 0, done.output
    table = pl.read_csv(out / "candidates.csv")
    best = table.row(0, named=True)
    assert best["peak [Nm]"] <= 1.5
    assert best["crosses"]
    kept = table.filter(pl.col("why").fill_null("") == "")
    assert best["worst"] == kept["worst"].min()
    assert "joint torque above 1.5 Nm" in table["why"].to_list()
    excitation = read_log(out / "excitation.csv").columns
    assert np.abs(excitation["command [Nm]"]).max() <= 1.5
    assert best["excitation"] in (out / "report.html").read_text("utf-8")


def test_a_smoothed_beginning_ends_on_the_exact_model(folder: Path) -> None:
    """Half-widths of the smoothed contact first; the same optimum to a thousandth of an error."""
    recordings = [{"log": "a.csv"}]
    _, plain = _identified(folder, recordings, starts=1)
    study, smoothed = _identified(folder, recordings, starts=1, smoothing=["4 mrad", 1e-3])
    stages = read_spec(study).search.stages
    assert [s.deadzone for s in stages[:2]] == [Smoothed(width=4e-3), Smoothed(width=1e-3)]
    assert all(s.deadzone is None for s in stages[2:])
    assert smoothed.fits.iterations[0] > plain.fits.iterations[0]
    apart = np.abs(smoothed.values - plain.values) / plain.seen.deviation
    assert apart.max() < 1e-2
    with pytest.raises(InputError, match="width"):
        _identified(folder, recordings, smoothing=[0.0])
