"""Gains of a real drive's sheet: its names, its units, its separators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jaxsim import tree
from jaxsim.commands.import_gains import command
from jaxsim.errors import InputError
from jaxsim.gain_sheet import import_gains
from jaxsim.study import load

LAW = load("bench_switched").law
NAMES = {"P-0-0107": "K_P", "Tv": "tau_D"}


def _write(folder: Path, text: str, name: str = "sheet.csv") -> Path:
    (folder / name).write_text(text, "utf-8")
    return folder / name


@pytest.mark.parametrize(
    "text",
    [
        "name,value,unit\nP-0-0107,180,mNm/deg\nTv,5.5,ms\nK_D,0.06,Nm s/rad\nS-0-0001,2,ms\n",
        "Unit;Name;Value;Note\nmNm/deg;P-0-0107;180,0;a\nms;Tv;5,5;\n"
        "Nm s/rad;K_D;0,06;\nms;S-0-0001;2;\n",
    ],
)
def test_a_sheet_is_read_in_its_own_units(text: str, tmp_path: Path) -> None:
    found = import_gains(LAW, _write(tmp_path, text), NAMES)
    assert tree.get(found.law, "K_P") == pytest.approx(0.18 * 180.0 / np.pi, rel=1e-14)
    assert tree.get(found.law, "tau_D") == 5.5e-3
    assert tree.get(found.law, "K_D") == 0.06
    assert tree.get(found.law, "K_B") == tree.get(LAW, "K_B")
    assert found.ignored == ["S-0-0001"]
    assert any(path.endswith("K_B") for path in found.kept)


def test_the_law_is_the_baseline_of_other_commands(tmp_path: Path) -> None:
    sheet = _write(tmp_path, 'K_P = "8.5 Nm/rad"\nK_B = "-0.5 Nm s/rad"\n', "sheet.toml")
    command(sheet, "bench_switched", tmp_path / "law.toml", None)
    law = load("bench_worst_case", law=str(tmp_path / "law.toml")).law
    assert (tree.get(law, "K_P"), tree.get(law, "K_B")) == (8.5, -0.5)
    assert tree.get(law, "K_D") == tree.get(LAW, "K_D")


@pytest.mark.parametrize(
    ("text", "names", "message"),
    [
        ("name,value,unit\nK_P,8,\n", {}, "sheet.csv: K_P: must have a unit"),
        ("name,value,unit\nK_P,8,s\n", {}, "must be convertible to Nm/rad"),
        ("name,value,unit\nK_P,eight,Nm/rad\n", {}, "line 2: K_P: must be a number"),
        ("name,value\nK_P,8\n", {}, "must have the columns name, value, unit"),
        ("name,value,unit\nKp,8,Nm/rad\n", {}, "must hold a gain of the law"),
        ("name,value,unit\nKp,8,Nm/rad\n", {"Kpp": "K_P"}, "did you mean Kp"),
        ("name,value,unit\nKp,8,Nm/rad\nK_P,8,Nm/rad\n", {"Kp": "K_P"}, "must be given once"),
        ("name,value,unit\nK_P,-8,Nm/rad\n", {}, "must be >= 0"),
    ],
)
def test_what_is_wrong_in_a_sheet_is_named(
    text: str, names: dict[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        import_gains(LAW, _write(tmp_path, text), names)
