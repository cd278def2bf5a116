"""Every report in a real browser at two widths: nothing sticks out, nothing goes wrong."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import identification_logs as logs
import pytest
from typer.testing import CliRunner

from jaxsim.command import app
from jaxsim.html import Section, Summary, Table, Text, write_html

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium"),
]
# A frame has the width that it is given; a window of a browser may have a least one.
FRAME = """<!doctype html><iframe id="frame" width="{width}" height="900" srcdoc="{page}"></iframe>
<script>
const frame = document.getElementById("frame");
frame.onload = () => {{
  const seen = frame.contentDocument;
  document.title = JSON.stringify([seen.defaultView.innerWidth, seen.scrollingElement.scrollWidth]);
}};
</script>"""
STUDY = """
name = "tiny"
drive.preset = "bench_2018"
law.file = "bench_switched"
scenario.duration = 0.1
scenario.reference = { type = "step", size = 0.30, at = 0.010 }
objective.minimise.itae_rad_s2 = 1.0
objective.limits.largest_torque_Nm = 1.6
[tune]
starts = 1
iterations = 2
free.K_B = { lower = -3.0, upper = 0.0 }
free.K_P = { lower = 1.0, upper = 40.0 }
drives = { count = 2, spread = { half_gap = "20 %" } }
"""
COMMANDS = {
    "tune": "tiny.toml",
    "pareto": "tiny.toml --between itae_rad_s2 --and largest_torque_Nm --points 3",
    "map": "tiny.toml --x K_P --y K_B --points 3",
    "montecarlo": "tiny.toml --drives 16",
    "inspect": "a.csv",
    "identify": "logs.toml --starts 1",
}


def _seen(report: Path, width: int, folder: Path) -> tuple[int, int, list[str]]:
    """Width of the window and of the page in it, and what the console says."""
    page = folder / "frame.html"
    inside = html.escape(report.read_text("utf-8"), quote=True)
    page.write_text(FRAME.format(width=width, page=inside), "utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=3000", "--dump-dom"]
    done = subprocess.run(
        [str(CHROMIUM), *options, page.as_uri()],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    title = re.search(r"<title>(\[.*?\])</title>", done.stdout)
    assert title is not None, done.stderr
    window, content = json.loads(title[1])
    return window, content, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reports")
    (folder / "tiny.toml").write_text(STUDY, "utf-8")
    for seed, name in enumerate("abc"):
        logs.write_csv(folder / f"{name}.csv", logs.chirp(), seed=seed)
    (folder / "logs.toml").write_text(logs.STUDY, "utf-8")
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_a_report_fits_and_is_quiet(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(app, [command, *COMMANDS[command].split(), "--out", command])
    assert isinstance(done.exception, SystemExit | None), done.exception
    assert done.exit_code in (0, 1), done.output  # 1: a limit does not hold, which is a report, too
    for width in (1280, 390):
        window, content, said = _seen(folder / command / "report.html", width, folder)
        assert (window, content, said) == (width, width, [])


@pytest.mark.parametrize(
    ("part", "wide", "said"),
    [
        (Table("t", ["a name as long as this one"] * 12, [[1.23456e-7] * 12]), False, 0),
        (Text(["w" * 300]), False, 0),
        (Text(["REPLACE"]), True, 1),
    ],
)
def test_what_does_not_fit_would_be_seen(part: Any, wide: bool, said: int, tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    write_html(report, "T", Summary("v"), [Section("S", [part])], {})
    bad = '<div style="width: 600px">x</div><script>throw new Error("bad")</script>'
    report.write_text(report.read_text("utf-8").replace("REPLACE", bad), "utf-8")
    window, content, errors = _seen(report, 390, tmp_path)
    assert (window, content > window, len(errors)) == (390, wide, said)
