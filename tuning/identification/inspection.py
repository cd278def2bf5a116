"""What is in a log: rates, gaps, quantisation, noise, spikes, and what looks wrong."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from tuning.log import Log

# A lone sample this many times farther from its neighbours' median than such distances usually
# are (scaled median of them) is a spike, if it also stands out by three steps of the quantisation.
_SPIKE = 12.0
_WINDOW = 3  # neighbours on either side
_GAP = 1.75  # a time step this many times the median is a gap
_JITTER = 0.02  # shown from this share of the step on
# Changes of quantised values are whole multiples of a step, to this share of it; the step is the
# common divisor of so many of the smallest ones. Fewer changes in all tell nothing.
_WHOLE = 0.05
_FEW, _MANY = 12, 20
_TIME_NAMES = ("t", "time", "timestamp", "stamp", "zeit", "seconds")


class Clock(NamedTuple):
    """A column of time stamps, in its own unit.

    step: median distance; jitter: scaled median deviation of it; gaps: samples before which stamps
    are missing; backwards, repeated: samples at which the time runs backwards or stands.
    """

    name: str
    count: int
    duration: float
    step: float
    jitter: float
    gaps: np.ndarray
    backwards: np.ndarray
    repeated: np.ndarray


class Facts(NamedTuple):
    """One column.

    quantum: step of the quantisation (0: none seen); noise: standard deviation of what changes
    from sample to sample (third differences); spikes: (n,) lone samples far off.
    """

    name: str
    count: int
    missing: int
    low: float
    high: float
    constant: bool
    quantum: float
    noise: float
    spikes: np.ndarray


def find_time(log: Log) -> str | None:
    """The column that looks like time: by its name, else the first that never falls."""
    for name in log.columns:
        bare = re.split(r"[\s\[(_]", name.strip().lower())[0]
        if bare in _TIME_NAMES:
            return name
    for name, values in log.columns.items():
        if values.size > 2 and np.all(np.diff(values) > 0.0):
            return name
    return None


def clock(name: str, stamps: np.ndarray) -> Clock:
    """The facts of a column of time stamps."""
    finite = stamps[np.isfinite(stamps)]
    steps = np.diff(stamps)
    forward = steps[np.isfinite(steps) & (steps > 0.0)]
    step = float(np.median(forward)) if forward.size else float("nan")
    jitter = 1.4826 * float(np.median(np.abs(forward - step))) if forward.size else float("nan")
    return Clock(
        name=name,
        count=stamps.size,
        duration=float(np.ptp(finite)) if finite.size else 0.0,
        step=step,
        jitter=jitter,
        gaps=np.flatnonzero(steps > _GAP * step) + 1,
        backwards=np.flatnonzero(steps < 0.0) + 1,
        repeated=np.flatnonzero(steps == 0.0) + 1,
    )


def facts(name: str, values: np.ndarray) -> Facts:
    """The facts of a column of readings."""
    finite = np.isfinite(values)
    kept = values[finite]
    if kept.size == 0:
        nothing = np.zeros(values.size, bool)
        nan = float("nan")
        return Facts(name, values.size, values.size, nan, nan, True, 0.0, 0.0, nothing)
    return Facts(
        name=name,
        count=values.size,
        missing=int(values.size - kept.size),
        low=float(kept.min()),
        high=float(kept.max()),
        constant=bool(np.ptp(kept) == 0.0),
        quantum=quantum(kept),
        noise=noise(kept),
        spikes=spikes(values),
    )


def quantum(values: np.ndarray) -> float:
    """The step of the quantisation: all changes are whole multiples of it; 0 where none is seen."""
    changes = np.abs(np.diff(values))
    largest = float(np.abs(values).max())
    # Rounding of float64 (or of many printed digits), then of float32, whose numbers all lie on a
    # grid of their own.
    whole = np.array_equal(values, np.round(values))
    single = np.array_equal(values, values.astype(np.float32)) and not whole
    for rounding in (6e-8 * largest,) if single else (1e-11 * largest, 6e-8 * largest):
        moved = changes[changes > 10.0 * rounding]
        if moved.size < _MANY:
            continue
        moved = np.unique(moved)
        step = _common_divisor(moved[:_FEW], rounding)
        whole = np.round(moved / step)
        near = np.abs(moved / step - whole) < _WHOLE
        if step > 50.0 * rounding and near.mean() > 0.98:
            return float(moved[near].sum() / whole[near].sum())
    return 0.0


def _common_divisor(lengths: np.ndarray, rounding: float) -> float:
    """Euclid's algorithm on numbers that are known to `rounding`."""
    divisor = float(lengths[0])
    for length in lengths[1:]:
        a, b = float(length), divisor
        while b > 10.0 * rounding:
            rest = a % b
            a, b = b, min(rest, b - rest)
        divisor = a
    return divisor


def noise(values: np.ndarray) -> float:
    """Standard deviation of white noise on a smooth signal, from its third differences."""
    if values.size < 8:
        return 0.0
    third = np.diff(values, 3)
    return 1.4826 * float(np.median(np.abs(third - np.median(third)))) / 20.0**0.5


def spikes(values: np.ndarray, distance: float | None = None) -> np.ndarray:
    """(n,) whether a sample, or some in a row, stand far off their neighbours on both sides.

    distance: from the median of seven, in the unit of the values; None judges by the others.
    """
    finite = np.isfinite(values)
    if finite.sum() < 4 * _WINDOW:
        return np.zeros(values.size, bool)
    filled = np.interp(np.arange(values.size), np.flatnonzero(finite), values[finite])
    padded = np.pad(filled, _WINDOW, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _WINDOW + 1)
    away = np.abs(filled - np.median(windows, axis=1))
    if distance is not None:
        return finite & (away > distance)
    usual = 1.4826 * np.median(away[away > 0.0]) if np.any(away > 0.0) else 0.0
    changes = np.abs(np.diff(filled))
    step = np.median(changes[changes > 0.0]) if np.any(changes > 0.0) else 0.0
    return finite & (away > _SPIKE * max(usual, step)) & (away > 3.0 * quantum(filled[finite]))


def tables(log: Log, time: str | None) -> list[tuple[str, tuple[str, ...], list[tuple]]]:
    """(caption, head, rows): the sampling and the columns of a log."""
    found = []
    if time is not None:
        c = clock(time, log.columns[time])
        rate = 1.0 / c.step if c.step > 0.0 else float("nan")
        row = (c.name, c.count, c.duration, c.step, rate, c.jitter, c.gaps.size)
        head = ("column", "samples", "duration", "median step", "rate", "jitter", "gaps")
        found.append(("Time, in the unit of its column", head, [row]))
    rows = []
    for name, values in log.columns.items():
        if name != time:
            f = facts(name, values)
            rows.append(
                (name, f.count, f.missing, f.low, f.high, f.quantum, f.noise, int(f.spikes.sum()))
            )
    head = ("column", "samples", "missing", "low", "high", "step", "noise", "spikes")
    found.append(("Columns, in their own units; step: of the quantisation", head, rows))
    return found


def remarks(log: Log, time: str | None) -> list[str]:
    """What looks wrong in a log, or needs a decision, in sentences."""
    found = []
    if time is None:
        found.append("No column looks like time: name one with --time.")
    else:
        found += _of_time(clock(time, log.columns[time]))
    for name, values in log.columns.items():
        if name != time:
            found += _of_column(facts(name, values))
    return found + _of_pairs(log, time)


def _of_time(c: Clock) -> list[str]:
    found = []
    for hits, words in ((c.backwards, "runs backwards"), (c.repeated, "stands still")):
        if hits.size:
            found.append(f"{c.name}: time {words} at {_places(hits)}.")
    if c.gaps.size:
        found.append(f"{c.name}: stamps are missing before {_places(c.gaps)}.")
    if c.jitter > _JITTER * c.step:
        share = 100.0 * c.jitter / c.step
        found.append(f"{c.name}: steps jitter by {share:.2g} % of {c.step:.4g}.")
    if c.step > 0.05 and c.count > 50:
        found.append(f"{c.name}: the median step is {c.step:.4g}: seconds, or rather ms or us?")
    return found


def _of_column(f: Facts) -> list[str]:
    found = []
    if f.missing:
        found.append(f"{f.name}: {f.missing} of {f.count} samples are no numbers.")
    if f.constant:
        found.append(f"{f.name}: constant ({f.low:.4g}): as an input it excites nothing.")
    if f.spikes.any():
        places = _places(np.flatnonzero(f.spikes))
        found.append(f"{f.name}: spikes at {places}: faults, or impacts?")
    return found


def _of_pairs(log: Log, time: str | None) -> list[str]:
    """Columns that are rates of others, and by which factor: units tell themselves."""
    if time is None:
        return []
    stamps, found = log.columns[time], []
    names = [n for n in log.columns if n != time]
    for angle in names:
        for speed in names:
            factor = rate_factor(stamps, log.columns[angle], log.columns[speed])
            if angle != speed and factor is not None and abs(factor - 1.0) > 0.1:
                why = unit_words(factor)
                words = f"{speed} is {factor:.4g} times the rate of {angle}"
                found.append(f"{words}: {why}?" if why else f"{words}.")
    return found


_FACTORS = {
    180.0 / np.pi: "deg/s beside rad, or time in other units",
    np.pi / 180.0: "rad/s beside deg",
    30.0 / np.pi: "rpm beside rad",
    1.0 / 6.0: "rpm beside deg",
    1.0 / (2.0 * np.pi): "revolutions per second beside rad",
    1e-3: "time in ms",
    1e-6: "time in us",
    -1.0: "opposite signs",
}


def unit_words(factor: float) -> str:
    """Which mistake would explain a factor between a speed and the rate of its angle, or ""."""
    near = (words for known, words in _FACTORS.items() if abs(factor / known - 1.0) < 0.1)
    return next(near, "")


def rate_factor(stamps: np.ndarray, angle: np.ndarray, speed: np.ndarray) -> float | None:
    """c where speed is c times the rate of angle over time; None where it is not its rate."""
    good = np.isfinite(stamps) & np.isfinite(angle) & np.isfinite(speed) & ~spikes(angle)
    t, a, w = stamps[good], angle[good], speed[good]
    if t.size < 50 or np.any(np.diff(t) <= 0.0) or np.ptp(a) == 0.0 or np.ptp(w) == 0.0:
        return None
    # Differences over several samples: quantised angles stand still from one to the next.
    k = max(1, t.size // 200)
    rate, mean = (a[k:] - a[:-k]) / (t[k:] - t[:-k]), 0.5 * (w[k:] + w[:-k])
    if np.std(rate) == 0.0 or np.std(mean) == 0.0:
        return None
    if abs(float(np.corrcoef(rate, mean)[0, 1])) < 0.95:
        return None
    return float(np.sum(rate * mean) / np.sum(rate * rate))


def _places(hits: np.ndarray) -> str:
    shown = ", ".join(str(int(i)) for i in hits[:5])
    more = f" and {hits.size - 5} more" if hits.size > 5 else ""
    return f"sample{'s' if hits.size > 1 else ''} {shown}{more}"
