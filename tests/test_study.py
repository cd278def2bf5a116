"""Study files: what they describe, what they refuse, and that what is written is read back."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from jaxsim import tree
from jaxsim.commands.new import commented
from jaxsim.components import build, dump
from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.errors import InputError
from jaxsim.law import Law
from jaxsim.provenance import make_folder, write_json, write_toml
from jaxsim.quantity import to_si
from jaxsim.study import Study, load, locate, names, owner_of, shipped, with_values

TEXT = """
name = "test"

[drive]
preset = "bench_2018"

[law]
type = "prefilter"
law = [
    { type = "pd", K_P = 10.0, K_D = 0.05, tau_D = "6 ms" },
    { type = "switched_damping", K_B = -0.80 },
]

[scenario]
duration = 0.3
reference = { type = "step", size = "0.3 rad", at = 0.010 }

[objective.minimise]
itae_rad_s2 = 1.0

[objective.limits]
largest_torque_Nm = 1.4
"""


def _load(folder: Path, text: str = TEXT) -> Study:
    path = folder / "test.toml"
    path.write_text(text)
    return load(str(path))


def _same(a: Any, b: Any) -> bool:
    leaves = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    structures = jax.tree.structure(a) == jax.tree.structure(b)
    return structures and all(np.array_equal(x, y) for x, y in leaves)


@pytest.mark.parametrize("name", shipped())
def test_shipped_studies_load(name: str) -> None:
    assert load(name).name == name


@pytest.mark.parametrize("name", shipped())
def test_a_new_study_is_the_same_study(name: str, tmp_path: Path) -> None:
    study = load(name)
    path = tmp_path / "copy.toml"
    path.write_text(commented(study, "copy"))
    copy = load(str(path))
    assert _same(copy.drive, study.drive)
    assert _same(copy.law, study.law)
    assert _same(copy.scenario, study.scenario)
    assert copy.run == study.run
    assert copy.objective == study.objective


def test_paper_gains_come_out_of_the_design() -> None:
    law = load("bench_switched").law
    errata = {"K_P": 10.28129662037006, "K_D": 0.05470907749696041, "tau_D": 5.82812354062619e-3}
    assert {k: float(tree.get(law, k)) for k in errata} == pytest.approx(errata, rel=1e-13)


def test_law_and_drive_survive_a_file(tmp_path: Path) -> None:
    study = _load(tmp_path)
    sampled = {"type": "sampled", "period": "400 us", "sensors": {"type": "encoders"}}
    law = build(Law, {**sampled, "law": dump(study.law)}, "law")
    assert law.period == 4e-4
    write_toml(tmp_path / "out.toml", {"law": dump(law), "drive": dump(study.drive)}, "a comment")
    table = tomllib.loads((tmp_path / "out.toml").read_text())
    assert _same(build(Law, table["law"], "law"), law)
    assert _same(build(Drive, table["drive"], "drive"), study.drive)


def test_law_from_another_file_and_values_by_name(tmp_path: Path) -> None:
    (tmp_path / "law.toml").write_text(TEXT.replace("-0.80", "-0.55"))
    study = _load(tmp_path, TEXT.split("[law]")[0] + '[law]\nfile = "law.toml"\nK_P = 9.0\n')
    assert float(tree.get(study.law, "K_B")) == -0.55
    assert float(tree.get(study.law, "K_P")) == 9.0
    other = load("bench_switched", law=str(tmp_path / "law.toml"))
    assert float(tree.get(other.law, "K_B")) == -0.55
    changed = with_values(other, {"K_B": -0.2, "half_gap": "26 arcmin"})
    assert float(tree.get(changed.law, "K_B")) == -0.2
    assert float(tree.get(changed.drive, "half_gap")) == pytest.approx(26 / 60 * np.pi / 180)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"bench_2018"', '"bench_2017"', ["drive.preset", "did you mean bench_2018"]),
        ('"bench_2018"', '"bench_2018"\nJ_M = -1e-4', ["J_M", "must be > 0", "-0.0001"]),
        ('"bench_2018"', '"bench_2018"\nJ_L = 0.0', ["J_L", "must be > 0"]),
        ('"bench_2018"', '"bench_2018"\nhalf_gap = -0.01', ["half_gap", ">= 0", "-0.01"]),
        ('"bench_2018"', '"bench_2018"\nhalf_gap = 7.8', ["half_gap", "0.35 rad", "7.8"]),
        ('"bench_2018"', '"bench_2018"\nhalf_gap = "1 Nm"', ["half_gap", "convertible to rad"]),
        ('"bench_2018"', '"bench_2018"\nhalf_ga = 0.01', ["half_ga", "did you mean half_gap"]),
        ('"bench_2018"', '"bench_2018"\nK = nan', ["K", "must be a number, not nan"]),
        ("K_B =", "K_C =", ["law.law[1].K_C", "did you mean K_B"]),
        ("K_P =", "Kp =", ["law.law[0].Kp", "did you mean K_P"]),
        ('"switched_damping"', '"switched_dampin"', ["did you mean switched_damping"]),
        ('type = "pd", K_P = 10.0,', 'type = "pd",', ["law.law[0]", "K_P"]),
        ('"6 ms"', '"6"', ["tau_D", "leave out the quotes"]),
        ('"6 ms"', '"6 Hz"', ["tau_D", "6 Hz"]),
        ("at = 0.010", "when = 0.010", ["scenario.reference.when", "at"]),
        ("duration = 0.3", "duration = 0.0", ["duration", "must be > 0 s"]),
        ("duration = 0.3", 'duration = "0.3 m"', ["scenario.duration", "convertible to s"]),
        ("itae_rad_s2", "itae", ["itae", "did you mean itae_rad_s2"]),
        ("itae_rad_s2 = 1.0", "itae_rad_s2 = -1.0", ["itae_rad_s2.weight", "greater than 0"]),
        ("largest_torque_Nm = 1.4", 'largest_torque_Nm = "x"', ["largest_torque_Nm.most"]),
        ("[scenario]", "[run]\ndt = 0.0\n[scenario]", ["dt", "must be > 0 s"]),
        ("[scenario]", "[run]\ndt = 7e-5\n[scenario]", ["dt", "divide the duration"]),
        ("[scenario]", '[run]\ndeadzone = "exat"\n[scenario]', ["run.deadzone", "'exact'"]),
        ("[scenario]", "[run]\nprecision = 16\n[scenario]", ["run.precision", "32 or 64"]),
        ("[scenario]", "[senario]", ["senario", "did you mean scenario"]),
        ("[scenario]", "[scenario", ["must be TOML", "line"]),
        ("[drive]", "[drives]", ["drives", "did you mean drive"]),
    ],
)
def test_what_a_file_may_not_say(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in TEXT
    with pytest.raises(InputError) as caught:
        _load(tmp_path, TEXT.replace(old, new))
    assert all(word in str(caught.value) for word in ["test.toml", *words]), str(caught.value)


def test_period_that_the_step_does_not_divide(tmp_path: Path) -> None:
    text = TEXT.replace('type = "prefilter"\nlaw = [', 'type = "sampled"\nperiod = 5e-4\nlaw = [')
    with pytest.raises(InputError, match=r"Sampled.period: must be a multiple of dt = 0.0002 s"):
        _load(tmp_path, text)


@pytest.mark.parametrize("name", shipped())
def test_every_name_that_is_listed_can_be_set(name: str) -> None:
    study = load(name)
    for known in names(study):
        owner, path = owner_of(study, known)
        value = float(tree.get(getattr(study, owner), path))
        assert _same(with_values(study, {known: value}).drive, study.drive), known


def test_an_unknown_value_is_told_with_what_can_be_set() -> None:
    with pytest.raises(InputError) as caught:
        with_values(load("bench_switched"), {"qqdampingqq": 1.0})
    assert caught.value.field == "qqdampingqq"
    assert caught.value.fix.startswith("known: D_M, ")
    assert {"K_B", "half_gap", "tau_D"} <= set(caught.value.fix[7:].split(", "))
    assert "law." not in caught.value.fix


def test_no_such_study_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean bench_switched"):
        load("bench_swiched")
    with pytest.raises(InputError, match="must be a file"):
        load("nowhere.toml")


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("0.45 deg", "rad", 0.45 * np.pi / 180),
        ("8.78 kg cm^2", "kg m^2", 8.78e-4),
        ("100 mNm s/rad", "Nm s/rad", 0.1),
        ("3000 rpm", "rad/s", 100 * np.pi),
        ("400 us", "s", 4e-4),
        ("20 %", "1", 0.2),
        (["1 ms", 0.5], "s", [1e-3, 0.5]),
    ],
)
def test_units(text: Any, unit: str, value: Any) -> None:
    assert to_si(text, unit, "x") == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "unit"), [("18 Hz", "rad/s"), ("3 rad/s", "Hz"), ("1 kg", "s"), (True, "s"), ("", "s")]
)
def test_units_that_do_not_fit(text: Any, unit: str) -> None:
    with pytest.raises(InputError, match="x: must be"):
        to_si(text, unit, "x")


def test_results_are_whole_or_absent(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_json(path, {"a": np.float64("nan"), "b": np.arange(2), "c": jax.numpy.ones(())})
    assert path.read_text() == '{\n "a": null,\n "b": [\n  0,\n  1\n ],\n "c": 1.0\n}\n'
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert path.read_text().startswith('{\n "a": null')


def test_bench_preset_is_table_two() -> None:
    drive = bench_2018()
    table = {"J_M": 8.78e-4, "D_M": 9.30e-2, "K": 3.00e2, "D_B": 1.00e-1, "half_gap": 7.80e-3}
    table |= {"J_L": 8.78e-4, "D_L": 3.60e-2}
    assert {name: float(tree.get(drive, name)) for name in table} == table


@pytest.mark.parametrize(
    ("gains", "words"),
    [
        ('K_p = "15 V/Nm", K_i = "12.5 1/s"', r"axis 0: K_p = 15 V/Nm .* K_p < 14\.1128; \(21\)"),
        ('K_p = "2 V/Nm", K_i = "170 1/s"', r"axis 0: K_i = 170 1/s .* K_i < 166\.303 there"),
    ],
)
def test_torque_gains_outside_the_stable_region_are_named(
    gains: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "arm.toml"
    text = locate("arm_torque").read_text("utf-8")
    path.write_text(text.replace('K_p = "2 V/Nm", K_i = "12.5 1/s"', gains))
    with pytest.warns(UserWarning, match=words):
        load(str(path))


def test_a_byte_order_mark_is_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.replace("\n", "\r\n").encode())
    assert load(str(path)).name == "test"


def test_an_output_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="--out: must lie in a folder that can be made"):
        make_folder("--out", tmp_path / "file")
