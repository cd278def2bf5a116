"""Logs: readers, what is seen in columns, and bad logs with a clear message each."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import identification_logs as logs
import numpy as np
import polars as pl
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

import jaxsim
from jaxsim.command import app
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.errors import InputError
from jaxsim.laws.feedforward import Feedforward
from jaxsim.signals.samples import Samples
from jaxsim.signals.table import Table
from jaxsim.study import from_table
from tuning.identification import inspection
from tuning.identification.mapping import Recorded, experiments
from tuning.identification.spec import read_spec
from tuning.log import read_log

TABLE = {"t": np.arange(5) * 0.01, "q": np.array([0.0, 1.5, np.nan, -2.25, 4.0])}


def _written(path: Path) -> Path:
    match path.suffix:
        case ".csv":
            pl.DataFrame(TABLE).write_csv(path)
        case ".parquet":
            pl.DataFrame(TABLE).write_parquet(path)
        case ".mat":
            savemat(path, TABLE)
        case ".npz":
            np.savez(path, **TABLE)
        case ".txt":
            head = "# made by hand\nt;q\n"
            rows = [f"{t};{q}".replace(".", ",") for t, q in zip(*TABLE.values(), strict=True)]
            path.write_text(head + "\n".join(rows) + "\n", "utf-8")
    return path


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".mat", ".npz", ".txt"])
def test_every_format_gives_the_same_columns(ending: str, tmp_path: Path) -> None:
    """.txt: a comment, semicolons and decimal commas."""
    columns = read_log(_written(tmp_path / f"log{ending}")).columns
    assert set(columns) == {"t", "q"}
    for name, values in TABLE.items():
        np.testing.assert_array_equal(columns[name], values)


def test_records_are_told_by_row_and_columns_of_arrays_by_index(tmp_path: Path) -> None:
    path = tmp_path / "many.npz"
    np.savez(path, q=np.arange(6.0).reshape(2, 3), mass=np.array([1.0, 2.0]))
    assert read_log(path, 1).column("mass").tolist() == [2.0]
    np.testing.assert_array_equal(read_log(path, 1).column("q"), [3.0, 4.0, 5.0])
    np.testing.assert_array_equal(read_log(path).column("q[2]"), [2.0, 5.0])
    with pytest.raises(InputError, match="must be a record"):
        read_log(path, 2)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("gone.csv", None, "must be a file"),
        ("log.xls", "a", "ending"),
        ("log.npz", "no archive", "must be readable"),
        ("log.mat", "no matrix", "must be readable"),
        ("log.csv", "", "must be readable"),
    ],
)
def test_files_that_are_no_logs(name: str, content: str | None, words: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=words):
        read_log(tmp_path / name)


@pytest.mark.parametrize("step", [1.0, 2.0 * np.pi / 4096, 360.0 / 2**20, 0.01])
def test_the_step_of_an_encoder_is_found(step: float) -> None:
    smooth = 40.0 * np.sin(np.linspace(0.0, 7.0, 700)) + 0.3 * np.linspace(0.0, 7.0, 700) ** 2
    found = inspection.quantum(step * np.round(smooth / step))
    assert found == pytest.approx(step, rel=1e-6)
    assert inspection.quantum(smooth) == 0.0


def test_noise_is_told_from_motion() -> None:
    t = np.linspace(0.0, 1.0, 4000)
    noise = 0.02 * np.random.default_rng(0).standard_normal(4000)
    # 4000 samples give a scaled median deviation to some 2 %.
    assert inspection.noise(np.sin(9.0 * t) + noise) == pytest.approx(0.02, rel=0.1)


def test_lone_spikes_are_marked_and_steps_are_not() -> None:
    t = np.linspace(0.0, 1.0, 500)
    values = np.sin(9.0 * t) + (t > 0.5) * 2.0
    values[[100, 300, 301]] = -np.pi
    assert np.flatnonzero(inspection.spikes(values)).tolist() == [100, 300, 301]


def test_a_clock_tells_gaps_jitter_and_what_runs_backwards() -> None:
    stamps = 0.01 * np.arange(200.0)
    stamps[120:] += 0.05
    stamps[50] = stamps[49]
    stamps[80] = stamps[79] - 0.001
    seen = inspection.clock("t", stamps)
    assert seen.gaps.tolist()[-1] == 120
    assert seen.backwards.tolist() == [80]
    assert seen.repeated.tolist() == [50]
    assert seen.step == pytest.approx(0.01)


def test_held_samples_are_a_held_table() -> None:
    """The same run, with the samples on ticks (no breakpoints) and between them."""
    torque = logs.chirp()
    inputs = {
        "table": Table(logs.TIMES, torque, "hold"),
        "on ticks": Samples(torque, logs.PERIOD, "hold", on_ticks=True),
        "breaks": Samples(torque, logs.PERIOD, "hold"),
    }
    ends = {}
    for name, signal in inputs.items():
        asked = jaxsim.Scenario(signal, duration=0.1)
        run = jaxsim.simulate(bench_2018(), Feedforward(), asked, metrics=(), store=100)
        ends[name] = np.array([np.asarray(run.signals[n]) for n in ("theta_L", "omega_M", "T_s")])
    np.testing.assert_allclose(ends["on ticks"], ends["table"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ends["breaks"], ends["table"], rtol=0, atol=1e-12)


def _table(**changes: Any) -> dict[str, Any]:
    table = tomllib.loads(logs.STUDY)
    table["identify"]["experiments"] = [{"log": "a.csv"}]
    table["identify"]["columns"] |= changes
    return table


def _mapped(folder: Path, table: dict[str, Any] | None = None) -> tuple[Recorded, float]:
    study = from_table(table or _table(), folder, "logs")
    found, dt = experiments(study, read_spec(study))
    return found[0], dt


@pytest.fixture
def log(tmp_path: Path) -> dict[str, np.ndarray]:
    """The columns of a healthy log; `_save` writes them."""
    logs.write_csv(tmp_path / "a.csv", logs.chirp())
    return {k: v.copy() for k, v in read_log(tmp_path / "a.csv").columns.items()}


def _save(folder: Path, columns: dict[str, np.ndarray]) -> None:
    pl.DataFrame(columns).write_csv(folder / "a.csv", float_precision=12)


def test_columns_become_signals_in_si_units(log: dict[str, np.ndarray], tmp_path: Path) -> None:
    recorded, dt = _mapped(tmp_path)
    theta_M, theta_L, T_s = recorded.experiment.measurements
    np.testing.assert_allclose(theta_M.values, np.deg2rad(log["motor [deg]"]), atol=1e-15)
    np.testing.assert_allclose(theta_L.values, logs.COUNT * log["load [counts]"], atol=1e-15)
    np.testing.assert_allclose(theta_L.times, logs.TIMES, atol=1e-15)
    assert dt == pytest.approx(2e-4, rel=1e-12)
    # A quantised angle is worth its step over root 12 at best; a torque what the study says.
    assert theta_L.noise >= 0.999 * logs.COUNT / np.sqrt(12.0)
    assert T_s.noise == 0.01
    assert recorded.remarks == ()


def test_a_sign_and_a_factor(log: dict[str, np.ndarray], tmp_path: Path) -> None:
    turned = {"column": "T_s [Nm]", "sign": -1, "factor": 2.0, "unit": "mNm", "noise": "1 mNm"}
    recorded, _ = _mapped(tmp_path, _table(T_s=turned))
    T_s = recorded.experiment.measurements[2]
    np.testing.assert_allclose(T_s.values, -2e-3 * log["T_s [Nm]"], rtol=1e-12)
    assert T_s.noise == pytest.approx(1e-3)


def test_a_column_of_one_recording_and_a_sum_of_two(log: Any, tmp_path: Path) -> None:
    """The load has what the motor reads on top, in degrees, in this recording alone."""
    table = _table()
    plus = {"column": "motor [deg]", "factor": 0.5}
    mine = {"theta_L": {"column": "motor [deg]", "unit": "deg", "plus": plus}}
    table["identify"]["experiments"] = [{"log": "a.csv", "columns": mine}]
    recorded, _ = _mapped(tmp_path, table)
    theta_M, theta_L, _ = recorded.experiment.measurements
    np.testing.assert_allclose(theta_L.values, 1.5 * theta_M.values, rtol=1e-12)
    plain, _ = _mapped(tmp_path)
    assert not np.allclose(plain.experiment.measurements[1].values, theta_L.values)


def test_a_start_is_read_from_the_motor_by_a_parabola(log: Any, tmp_path: Path) -> None:
    """0.1 + 0.7 t + 30 t^2 rad: a line through 20 readings would say 1.27 rad/s."""
    log["motor [deg]"] = np.rad2deg(0.1 + 0.7 * logs.TIMES + 30.0 * logs.TIMES**2)
    _save(tmp_path, log)
    table = _table()
    del table["identify"]["columns"]["theta_L"]
    table["identify"] |= {"start": "readings", "first": 20}
    recorded, _ = _mapped(tmp_path, table)
    start = recorded.experiment.scenario.start[0]
    assert float(start.theta_L) == pytest.approx(0.1, rel=1e-9)
    assert float(start.omega_L) == pytest.approx(0.7, rel=1e-9)


def test_a_missing_column_names_the_nearest(log: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"did you mean .*motor \[deg\]"):
        _mapped(tmp_path, _table(theta_M={"column": "motor [dg]", "unit": "deg"}))


def test_columns_that_are_not_given_are_told_with_a_line_to_write(log: Any, tmp_path: Path) -> None:
    """Out of the header of the log, with its unit: its first column but time is a torque."""
    table = _table()
    table["identify"]["columns"] = {}
    with pytest.raises(InputError) as caught:
        _mapped(tmp_path, table)
    assert caught.value.field == "identify.columns.time"
    assert caught.value.fix == 'e.g. time = { column = "t [ms]", unit = "ms" }'
    table["identify"]["columns"] = {"time": {"column": "t [ms]", "unit": "ms"}}
    with pytest.raises(InputError) as caught:
        _mapped(tmp_path, table)
    assert caught.value.field == "identify.columns"
    assert 'T_s = { column = "torque [Nm]", unit = "Nm" }' in caught.value.fix
    assert "signals: theta_L, " in caught.value.fix


def test_an_unknown_signal_names_the_nearest(log: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"did you mean .*theta_L"):
        _mapped(tmp_path, _table(theta_l={"column": "load [counts]"}))


def test_nan_is_masked_in_a_reading_and_refused_in_an_input(log: Any, tmp_path: Path) -> None:
    log["T_s [Nm]"][[7, 90]] = np.nan
    _save(tmp_path, log)
    recorded, _ = _mapped(tmp_path)
    assert np.flatnonzero(~recorded.experiment.measurements[2].used).tolist() == [7, 90]
    assert "2 readings are no numbers" in recorded.remarks[0]
    log["torque [Nm]"][5] = np.nan
    _save(tmp_path, log)
    with pytest.raises(InputError, match="input must be a number everywhere; got none at sample 5"):
        _mapped(tmp_path)


def test_time_that_runs_backwards_is_refused(log: Any, tmp_path: Path) -> None:
    log["t [ms]"][40] = 12.0
    _save(tmp_path, log)
    with pytest.raises(InputError, match=r"must not run backwards.*at sample 40"):
        _mapped(tmp_path)


def test_an_encoder_in_degrees_that_is_called_rad_is_refused(log: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"theta_M.unit.*360/2\^k.*deg"):
        _mapped(tmp_path, _table(theta_M={"column": "motor [deg]"}))


def test_an_angle_that_contradicts_its_speed_is_refused(log: Any, tmp_path: Path) -> None:
    log["speed"] = np.gradient(log["motor [deg]"], 1e-3)
    _save(tmp_path, log)
    columns = {"theta_M": {"column": "motor [deg]", "unit": "deg"}, "omega_M": {"column": "speed"}}
    with pytest.raises(InputError, match=r"omega_M.unit: must agree.*deg/s beside rad"):
        _mapped(tmp_path, _table(**columns))


def test_seconds_that_are_milliseconds_are_refused(log: Any, tmp_path: Path) -> None:
    table = _table(time={"column": "t [ms]"})
    table["identify"]["dt"] = 2e-5
    with pytest.raises(InputError, match="is `time` in another unit"):
        _mapped(tmp_path, table)


def test_a_constant_input_is_remarked(log: Any, tmp_path: Path) -> None:
    log["torque [Nm]"][:] = 0.2
    _save(tmp_path, log)
    recorded, _ = _mapped(tmp_path)
    assert "input reference is constant" in recorded.remarks[0]


def test_spikes_of_an_angle_are_masked_and_told(log: Any, tmp_path: Path) -> None:
    log["load [counts]"][[30, 200]] = -500_000.0
    _save(tmp_path, log)
    recorded, _ = _mapped(tmp_path)
    assert np.flatnonzero(~recorded.experiment.measurements[1].used).tolist() == [30, 200]
    assert "2 spikes are masked" in recorded.remarks[0]


def test_a_window_starts_the_clock_anew(log: Any, tmp_path: Path) -> None:
    table = _table()
    table["identify"]["experiments"] = [{"log": "a.csv", "begin": "50 ms", "end": 0.2}]
    recorded, _ = _mapped(tmp_path, table)
    m = recorded.experiment.measurements[1]
    assert m.times[0] == 0.0
    assert m.values[0] == pytest.approx(logs.COUNT * log["load [counts]"][50])
    assert recorded.experiment.scenario.duration == pytest.approx(0.15)


def test_what_is_known_of_a_recording_is_set_in_it(log: Any, tmp_path: Path) -> None:
    table = _table()
    known = {"J_L": "9 kg cm^2", "start.theta_L": "1 deg", "T_s.offset": "3 mNm"}
    table["identify"]["experiments"] = [{"log": "a.csv", "set": known}]
    recorded, _ = _mapped(tmp_path, table)
    e = recorded.experiment
    assert float(e.drive.load.J_L) == pytest.approx(9e-4)
    assert float(e.scenario.start[0].theta_L) == pytest.approx(np.deg2rad(1.0))
    assert float(e.measurements[2].sensor.offset) == pytest.approx(3e-3)


def test_inspect_says_what_is_in_a_log(log: Any, tmp_path: Path) -> None:
    log["load [counts]"][[30, 200]] = -500_000.0
    log["T_s [Nm]"][7] = np.nan
    _save(tmp_path, log)
    done = CliRunner().invoke(app, ["inspect", str(tmp_path / "a.csv"), "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "load [counts]: spikes at samples 30, 200" in done.output
    assert "1 of 301 samples are no numbers" in done.output
    assert "seconds, or rather ms" in done.output
    assert (tmp_path / "report.html").stat().st_size > 50_000
