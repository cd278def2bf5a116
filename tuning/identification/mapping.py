"""From the columns of logs to experiments: units, signs, times, masks; and what is refused."""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxsim.errors import InputError
from jaxsim.loop import UNITS, ClosedLoop
from jaxsim.quantity import to_si
from jaxsim.scenario import Scenario, Start
from jaxsim.signal import Signal
from jaxsim.signals.delayed import Delayed
from jaxsim.signals.samples import Samples
from jaxsim.signals.table import Table
from jaxsim.study import Study
from tuning.identification import inspection, records
from tuning.identification.experiment import Experiment, Measurement, measurement
from tuning.identification.residuals import signal_name
from tuning.identification.spec import INPUTS, Column, Recording, Spec, is_measured
from tuning.log import File, Log, log_of, read_file

# Stamps this close to equal steps, as a share of a step, are equal steps.
_EQUAL = 1e-5
_MOST_TICKS = 5_000_000  # more is a time column in another unit
# So many readings at the start show that its speed changes, too.
_BEND = 8
_ANGLES = ("theta_L", "theta_M", "theta_B")
_SPEED_OF = {"theta_L": "omega_L", "theta_M": "omega_M", "theta_B": "omega_B"}


class Recorded(NamedTuple):
    """An experiment with what it is for and what was noticed on the way, in sentences."""

    experiment: Experiment
    use: str
    remarks: tuple[str, ...]


class Series(NamedTuple):
    """A column in SI units with its time stamps, s from the start of the experiment."""

    times: np.ndarray
    values: np.ndarray
    quantum: float
    noise: float
    spikes: np.ndarray


def experiments(study: Study, spec: Spec) -> tuple[list[Recorded], float]:
    """All recordings of a study as experiments, and the integration step in s.

    Raises: InputError for logs and columns that are missing, times that run backwards, inputs with
    holes, and units that contradict each other.
    """
    read = functools.cache(read_file)
    opened = [
        (r, row, _open(spec, read(path), row))
        for r in spec.recordings
        for path in records.files(spec.folder, r.log)
        for row in records.rows(r, read(path))
    ]
    dt = _step(study, spec, opened[0][2]) if spec.dt is None else spec.dt
    names: dict[str, int] = {}
    found = []
    for recording, row, log in opened:
        name = log.name if row is None else f"{log.name}[{row}]"
        names[name] = names.get(name, 0) + 1
        name = name if names[name] == 1 else f"{name}#{names[name]}"
        found.append(_recorded(study, spec, recording, log, name, dt))
    return found, dt


def _open(spec: Spec, file: File, row: int | None) -> Log:
    log = log_of(file, row)
    if "time" not in spec.columns:
        guess = inspection.find_time(log)
        fix = f"e.g. {_example(['time'], guess)}" if guess else "name the column of time stamps"
        raise InputError("identify.columns.time", "must be given", "nothing", fix)
    if not any(is_measured(name) for name in spec.columns):
        taken = {column.column for column in spec.columns.values()}
        column = next((name for name in log.columns if name not in taken), "...")
        signals = [name for name in UNITS if name not in INPUTS]
        fix = f"e.g. {_example(signals, column)}; signals: {', '.join(signals)}"
        raise InputError("identify.columns", "must name a measured signal", "none", fix)
    return log


def _example(signals: list[str], column: str) -> str:
    """A line of [identify.columns], for the first signal that has a unit in the column's name."""
    found = re.search(r"\[(.+)\]", column)
    unit = found[1] if found else None
    for signal in signals if unit else ():
        with contextlib.suppress(InputError):
            to_si(f"1 {unit}", UNITS.get(signal, "s"), column)
            return f'{signal} = {{ column = "{column}", unit = "{unit}" }}'
    return f'{signals[0]} = {{ column = "{column}" }}'


def _step(study: Study, spec: Spec, log: Log) -> float:
    """The largest step not above the study's that divides the sampling: readings lie on ticks."""
    stamps = _stamps(spec, log, None)
    period = float(np.median(np.diff(stamps)))
    return float(f"{period / math.ceil(period / study.run.dt - 1e-9):.12g}")


def _recorded(
    study: Study, spec: Spec, recording: Recording, log: Log, name: str, dt: float
) -> Recorded:
    remarks: list[str] = []
    spec = spec._replace(columns=recording.mapped(spec.columns))
    raw = {
        key: _series(study, spec, key, column, log, recording, remarks)
        for key, column in spec.columns.items()
        if key != "time"
    }
    _contradictions(study, spec, raw)
    duration = _duration(raw, dt, log)
    scenario = _scenario(study, spec, raw, duration, dt, remarks, log.path.name)
    if spec.start != "study":
        scenario = _started(study, spec, scenario, raw)
    measured = tuple(
        _measured(study, key, spec.columns[key], series, duration, remarks, log.path.name)
        for key, series in raw.items()
        if is_measured(key)
    )
    made = Experiment(name, study.drive, study.law, scenario, measured, spec.start == "rest")
    made = records.known(made, recording, log, _stamps(spec, log, None))
    return Recorded(made, recording.use, tuple(f"{name}: {r}" for r in remarks))


def _stamps(spec: Spec, log: Log, column: Column | None) -> np.ndarray:
    """Time stamps in s; `column` may have some of its own."""
    own = spec.columns["time"]
    name = column.time if column is not None and column.time else own.column
    stamps = log.column(name) * _factor(own, "s", "identify.columns.time")
    where = f"{log.path.name}: {name}"
    if not np.all(np.isfinite(stamps)):
        at = int(np.flatnonzero(~np.isfinite(stamps))[0])
        raise InputError(where, "must be numbers", f"none at sample {at}", "repair the time stamps")
    steps = np.diff(stamps)
    if np.any(steps < 0.0):
        at = int(np.flatnonzero(steps < 0.0)[0]) + 1
        got = f"{stamps[at]:.6g} s after {stamps[at - 1]:.6g} s at sample {at}"
        fix = "cut the log there (`begin`, `end`), or sort it if only its lines are mixed up"
        raise InputError(where, "time must not run backwards", got, fix)
    return stamps


def _read(log: Log, name: str, where: str) -> np.ndarray:
    if name not in log.columns:
        raise InputError.unknown(f"{where}.column, in {log.path.name}", name, log.columns)
    return log.columns[name]


def _factor(column: Column, si: str, where: str) -> float:
    """SI units per unit of a column, with sign."""
    if column.unit in ("counts", "count"):
        if column.counts is None:
            fix = "e.g. counts = 4096"
            raise InputError(f"{where}.counts", "must be given per revolution", "nothing", fix)
        unit = 2.0 * np.pi / column.counts
    elif column.unit is None:
        unit = 1.0
    else:
        unit = float(to_si(f"1 {column.unit}", si, f"{where}.unit"))
    return unit * column.sign * column.factor


def _series(
    study: Study, spec: Spec, key: str, column: Column, log: Log, recording: Recording,
    remarks: list[str],
) -> Series:  # fmt: skip
    """A column in SI units, cut to the recording's window, without repeated stamps."""
    where = f"identify.columns.{key}"
    stamps, raw = _stamps(spec, log, column), _read(log, column.column, where)
    if column.plus:
        raw = raw + column.plus.factor * log.column(column.plus.column)
    if raw.shape != stamps.shape:
        got = f"{raw.size} readings, {stamps.size} time stamps"
        raise InputError(where, "must be as long as its time", got, "name its own `time` column")
    origin = _stamps(spec, log, None)[0]
    times = stamps - origin
    begin, end = (
        None if v is None else float(to_si(v, "s", f"identify.experiments.{k}"))
        for k, v in (("begin", recording.begin), ("end", recording.end))
    )
    kept = np.concatenate([[True], np.diff(times) > 0.0])
    if not kept.all():
        remarks.append(
            f"{key}: {int((~kept).sum())} readings repeat a time stamp and are left out."
        )
    low = 0.0 if begin is None else begin
    kept &= (times >= low) & (times <= (np.inf if end is None else end))
    if kept.sum() < 2:
        got = f"{int(kept.sum())} readings"
        raise InputError(where, "must hold readings in the window", got, "check begin and end")
    facts = inspection.facts(key, raw[kept])
    factor = _factor(column, _unit(study, key), where)
    size = abs(factor)
    return Series(
        times[kept] - low, factor * raw[kept], size * facts.quantum, size * facts.noise,
        facts.spikes,
    )  # fmt: skip


def _unit(study: Study, key: str) -> str:
    """The SI unit of a signal or an input of a study."""
    if key == "reference":
        return study.law.reference_unit or study.drive.command_unit
    if key == "load_torque":
        return "Nm"
    base, _ = signal_name(key)
    if base not in UNITS:
        raise InputError.unknown(f"identify.columns.{key}", base, [*UNITS, "time", *INPUTS])
    return study.drive.command_unit if base == "command" else UNITS[base]


def _duration(raw: dict[str, Series], dt: float, log: Log) -> float:
    last = max(s.times[-1] for s in raw.values())
    ticks = max(1, math.ceil(last / dt - 1e-6))
    if ticks > _MOST_TICKS:
        got = f"{last:.6g} s in steps of {dt:.3g} s"
        fix = 'is `time` in another unit? e.g. unit = "ms"'
        raise InputError(
            f"{log.path.name}: time", "must span a run that can be simulated", got, fix
        )
    return ticks * dt


def _scenario(
    study: Study, spec: Spec, raw: dict[str, Series], duration: float, dt: float,
    remarks: list[str], file: str,
) -> Scenario:  # fmt: skip
    parts = {name: list(getattr(study.scenario, name)) for name in INPUTS}
    for name in INPUTS:
        if name in raw:
            column = spec.columns[name]
            series, asked = _anew(raw[name], column, name), parts[name][column.axis]
            made = _input(series, column.between, dt, f"{file}: {name}")
            # What the study delays, it delays of the log, too.
            late = isinstance(asked, Delayed)
            parts[name][column.axis] = Delayed(made, asked.delay) if late else made
            if np.ptp(raw[name].values) == 0.0:
                remarks.append(f"the input {name} is constant: it excites nothing.")
    return Scenario(
        tuple(parts["reference"]), tuple(parts["load_torque"]), study.scenario.start,
        duration=duration,
    )  # fmt: skip


def _anew(series: Series, column: Column, name: str) -> Series:
    """An input read anew at equal steps, if its column asks for them."""
    if column.every is None:
        return series
    period = float(to_si(column.every, "s", f"identify.columns.{name}.every"))
    grid = period * np.arange(math.ceil(series.times[-1] / period) + 1)
    values = np.interp(grid, series.times, series.values)
    if column.between == "hold":
        at = np.searchsorted(series.times, grid * (1.0 + _EQUAL), "right") - 1
        values = series.values[np.maximum(at, 0)]
    return series._replace(times=grid, values=values)


def _input(series: Series, between: str, dt: float, where: str) -> Signal:
    bad = np.flatnonzero(~np.isfinite(series.values))
    if bad.size:
        fix = "cut the log with begin and end, or repair the column"
        got = f"none at sample {bad[0]}" + (f" and {bad.size - 1} more" if bad.size > 1 else "")
        raise InputError(where, "an input must be a number everywhere", got, fix)
    period = (series.times[-1] - series.times[0]) / (len(series.times) - 1)
    grid = period * np.arange(len(series.times))
    if np.abs(series.times - grid).max() > _EQUAL * period:
        return Table(series.times, series.values, between)  # pyright: ignore
    ticks = round(period / dt)
    on_ticks = bool(ticks >= 1 and abs(ticks * dt - period) * len(grid) < _EQUAL * period)
    period = ticks * dt if on_ticks else period
    return Samples(series.values, period, between, on_ticks)  # pyright: ignore


def _measured(
    study: Study, key: str, column: Column, series: Series, duration: float, remarks: list[str],
    log: str,
) -> Measurement:  # fmt: skip
    used = np.isfinite(series.values)
    if not used.all():
        remarks.append(f"{key}: {int((~used).sum())} readings are no numbers and are masked.")
    spikes = _spikes(study, key, column, series)
    count = int(spikes.sum())
    if count:
        used &= ~spikes
        at = ", ".join(f"{t:.4g}" for t in series.times[spikes][:5])
        remarks.append(
            f"{key}: {count} spikes are masked (at {at}{' ...' if count > 5 else ''} s)."
        )
    if not used.any():
        got = f"no number in {column.column!r} of {log}"
        raise InputError(f"identify.columns.{key}", "must hold numbers", got, "check the column")
    rounding = series.quantum / 12.0**0.5
    noise = max(series.noise, rounding)  # the differences of readings show both
    if column.noise is not None:
        given = float(to_si(column.noise, _unit(study, key), f"identify.columns.{key}.noise"))
        noise = math.hypot(given, rounding)
    spread = float(np.ptp(series.values[used]))
    # A reading that never changes still has a weight; which one does not matter.
    noise = noise if noise > 0.0 else max(1e-6 * spread, 1e-12)
    inside = series.times <= duration
    return measurement(key, series.times[inside], series.values[inside], noise, used=used[inside])


def _spikes(study: Study, key: str, column: Column, series: Series) -> np.ndarray:
    """What is masked as a spike: `mask`, `keep`, or a distance from the median of seven."""
    given = column.spikes or ("mask" if signal_name(key)[0] in _ANGLES else "keep")
    if given == "mask":
        return series.spikes
    if given == "keep":
        return np.zeros_like(series.spikes)
    distance = float(to_si(given, _unit(study, key), f"identify.columns.{key}.spikes"))
    return inspection.spikes(series.values, distance)


def _started(study: Study, spec: Spec, scenario: Scenario, raw: dict[str, Series]) -> Scenario:
    """Angle and speed of the load at the start, by a line or parabola through the first readings.

    At rest it is where the first reading is. Where only the motor is read, the load is where the
    motor is: the gear unwound, in mid-gap.
    """
    seen = next((n for n in ("theta_L", "theta_M") if n in raw), None)
    if seen is None:
        return scenario
    series, first = raw[seen], 1 if spec.start == "rest" else spec.first
    good = np.isfinite(series.values) & ~_spikes(study, seen, spec.columns[seen], series)
    good = np.flatnonzero(good)[:first]
    times, degree = series.times[good], 0 if first == 1 else 2 if first >= _BEND else 1
    angle, slope, *_ = *np.polynomial.polynomial.polyfit(times, series.values[good], degree), 0.0
    # Less than one step of the encoder over these readings is rest.
    still = abs(slope) * np.ptp(times) <= max(series.quantum, 3.0 * series.noise)
    ratio = float(study.drive.transmission[0].ratio) if seen == "theta_M" else 1.0
    start = Start(theta_L=angle / ratio, omega_L=0.0 if still else slope / ratio)
    return Scenario(
        scenario.reference, scenario.load_torque, (start, *scenario.start[1:]),
        duration=scenario.duration,
    )  # fmt: skip


def _contradictions(study: Study, spec: Spec, raw: dict[str, Series]) -> None:
    """Refuse units that the readings themselves contradict.

    Two witnesses: a speed that is not the rate of its angle but 57.3 times it, or 1/57.3; and the
    step of an encoder, which is 2 pi/2^k in rad and 360/2^k in deg.
    """
    for angle, speed in _SPEED_OF.items():
        if angle in raw and speed in raw and raw[angle].times.shape == raw[speed].times.shape:
            factor = inspection.rate_factor(raw[angle].times, raw[angle].values, raw[speed].values)
            words = "" if factor is None else inspection.unit_words(factor)
            if words:
                got = f"{speed} that is {factor:.4g} times the rate of {angle} ({words})"
                where = f"identify.columns.{angle}.unit and {speed}.unit"
                raise InputError(where, "must agree", got, "correct the units, or sign and factor")
    for key in set(_ANGLES) & set(raw):
        if spec.columns[key].unit in (None, "rad") and _is_degrees(raw[key]):
            step = raw[key].quantum
            got = f'"rad", but the encoder\'s step {step:.6g} is 360/2^k, not 2 pi/2^k'
            fix = 'try unit = "deg"'
            raise InputError(f"identify.columns.{key}.unit", "must be that of the log", got, fix)


def _is_degrees(series: Series) -> bool:
    if series.quantum == 0.0:
        return False
    degrees, radians = (math.log2(turn / series.quantum) for turn in (360.0, 2.0 * math.pi))
    return abs(degrees - round(degrees)) < 2e-3 < abs(radians - round(radians))


def check_loops(recorded: Sequence[Recorded], dt: float) -> None:
    """Do the parts of every experiment fit together?"""
    from jaxsim.hybrid import Exact

    for item in recorded:
        e = item.experiment
        ClosedLoop(e.drive, e.law, e.scenario, Exact(), dt)
