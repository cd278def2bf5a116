"""The doctor names what is not in force, and nothing that is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from jaxsim import doctor
from jaxsim._configure import core_count

_BARE = """
from jaxsim import doctor
import jaxsim, jax
jax.numpy.zeros(1).block_until_ready()
jaxsim.configure(x64=False, cache=False, fast=False)
for one in (doctor._options(), *doctor._cores(), doctor._precision(), doctor._cache()):
    print(f"{one.what}|{bool(one.todo)}")
"""


def test_nothing_is_amiss_where_the_commands_run() -> None:
    found = [doctor._options(), *doctor._cores(), doctor._precision(), doctor._cache()]
    assert [one.what for one in found if one.todo] == []


def test_an_unconfigured_process_is_told_what_to_do() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _BARE],
        capture_output=True,
        text=True,
        check=True,
        env={"PATH": "", "JAX_PLATFORMS": "cpu"},
        cwd=Path(__file__).parents[1],
    )
    assert done.stdout.split() == [
        "compiler", "options|True", "cores|False", "precision|True", "compiled", "programs|True"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "limited"),
    [("max 100000", False), ("50000 100000", True), (f"{core_count()}00000 100000", False)],
)
def test_a_container_s_limit_is_named(
    text: str, limited: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    group = tmp_path / "cpu.max"
    group.write_text(text + "\n", "ascii")
    monkeypatch.setattr(doctor, "_GROUP", group)
    assert bool(doctor._quota().todo) is limited
