"""The commands of studies and runs: what they refuse, what they say, what they leave."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from jaxsim.command import app


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
