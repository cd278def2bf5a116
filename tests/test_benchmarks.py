"""The comparison of benchmarks, on made-up results."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

COMPARE = Path(__file__).resolve().parent.parent / "benchmarks" / "compare.py"


def _write(folder: Path, **benchmarks: dict[str, float]) -> Path:
    folder.mkdir()
    for name, ratios in benchmarks.items():
        (folder / f"{name}.json").write_text(json.dumps({"ratios": ratios}), "utf-8")
    return folder


def _compared(new: Path, committed: Path) -> tuple[int, list[str]]:
    command = [sys.executable, str(COMPARE), str(new), str(committed)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.stderr
    return done.returncode, done.stdout.splitlines()


def test_what_fell_by_more_than_a_fifth_is_named(tmp_path: Path) -> None:
    committed = _write(
        tmp_path / "committed",
        speed={"of C": 0.50, "of numba": 10.0, "of Heun": 2.0, "gone": 1.0},
        elsewhere={"not run today": 3.0},
    )
    new = _write(
        tmp_path / "new",
        speed={"of C": 0.41, "of numba": 7.9, "of Heun": 2.6},  # by 18 %, by 21 %, risen
        young={"not committed yet": 1.0},
    )
    code, lines = _compared(new, committed)
    assert code == 1
    assert lines == [
        "speed: of numba: 10, now 7.9 (79%)",
        "speed: gone: 1, now missing",
        "2 ratios of speed fell by more than 20%.",
    ]


def test_nothing_that_fell_is_no_error_and_nothing_to_compare_is_one(tmp_path: Path) -> None:
    committed = _write(tmp_path / "committed", speed={"of C": 0.5})
    assert _compared(_write(tmp_path / "new", speed={"of C": 0.4}), committed)[0] == 0
    code, lines = _compared(_write(tmp_path / "other", memory={"flat": 1.0}), committed)
    assert code == 1
    assert "no benchmark in common" in lines[0]
