"""What README and docs tell people to type works."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

import jaxsim
from jaxsim.command import app

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
# CONTRIBUTING shows a law as it stands in the package; here the blocks are run.
PAGES = ("README.md", "CONTRIBUTING.md")


@pytest.mark.parametrize("page", PAGES)
def test_python_blocks_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jaxsim, "configure", lambda: None)  # conftest has done it
    blocks = BLOCK.findall((ROOT / page).read_text("utf-8"))
    assert blocks
    for number, block in enumerate(blocks):
        path = tmp_path / f"block_{number}.py"
        path.write_text(block, "utf-8")
        runpy.run_path(str(path), run_name=path.stem)


def test_commands_exist() -> None:
    from importlib.metadata import entry_points

    known = {point.name for point in entry_points(group="gearlash.commands")}
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    named = {
        name for page in pages for name in re.findall(r"^gearlash (\w+)", page.read_text(), re.M)
    }
    assert named <= known
    assert {"new", "simulate", "certify", "tune", "reproduce"} <= named


# What a newcomer writes over the numbers of the new file; then a budget for a test.
OWN = {
    r"^K = 3.*": 'K = "4.6 Nm/deg"',
    r"^half_gap = 0.*": 'half_gap = "0.4 deg"',
    r"^J_M = .*": 'J_M = "9.2 kg cm^2"',
    r"^J_L = 0.*": "J_L = 8.2e-4",
    r"^starts = .*": "starts = 1",
    r"^iterations = .*": "iterations = 3",
    r"^count = .*": "count = 2",
    r"^screen = .*": "",
    r"^\[tune.free.K_D\]\n.*\n.*\n": "",
    r"^\[tune.free.tau_D\]\n.*\n.*\n": "",
}


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_the_readme_leads_from_a_new_study_to_compiled_firmware(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its commands, word by word, on own K, half gap and inertias; certify and more left out."""
    monkeypatch.chdir(tmp_path)
    readme = (ROOT / "README.md").read_text("utf-8")
    (block,) = re.findall(r"## In ten minutes\n\n```bash\n(.*?)```", readme, re.DOTALL)
    steps = [shlex.split(line, comments=True) for line in block.splitlines()]
    steps = [words for words in steps if words and words[1] in ("new", "tune", "export")]
    assert [words[1] for words in steps] == ["new", "tune", "export"]
    _run(steps[0])
    _put_own_numbers(tmp_path / "my_drive.toml")
    for words in steps[1:]:
        _run(words)
    gains = tomllib.loads((tmp_path / "results/tuned/law.toml").read_text("utf-8"))
    pd = next(part for part in gains["law"]["law"] if part["type"] == "pd")
    header = (tmp_path / "results/firmware/law.h").read_text("utf-8")
    assert f"#define LAW_K_P {pd['K_P']!r} /* Nm/rad" in header
    assert pd["K_P"] != pytest.approx(10.28, abs=0.01), "the gains that the study began with"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-c", "law.c"]
    done = subprocess.run(
        ["gcc", *flags], cwd=tmp_path / "results/firmware", capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def _put_own_numbers(study: Path) -> None:
    text = study.read_text("utf-8")
    for pattern, own in OWN.items():
        text, found = re.subn(pattern, own, text, flags=re.M)
        assert found == 1, pattern
    study.write_text(text, "utf-8")


def _run(words: list[str]) -> None:
    done = CliRunner().invoke(app, words[1:])
    assert done.exit_code == 0, done.output
