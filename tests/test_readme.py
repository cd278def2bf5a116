"""What README and docs tell people to type works."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

import jaxsim

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
