"""Which excitation shows most: candidates ranked by the information that they would give."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from jaxsim.errors import InputError
from jaxsim.loop import UNITS
from jaxsim.quantity import to_si
from jaxsim.scenario import Scenario
from jaxsim.signals.samples import Samples
from jaxsim.status import Status
from jaxsim.study import Study
from jaxsim.validation import check
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.residuals import Problem
from tuning.identification.spec import Spec, is_measured, read_free
from tuning.identification.verdict import crosses

_LEVELS = (0.3, 0.6, 1.0)  # shares of the command's limit
_BANDS = 5  # lowest frequencies of the candidates, log-spaced
_LINES = 8  # of a multisine
# A torque that only limits the choice is looked at, but weighs nothing.
_WEIGHTLESS = 1e9


class Design(BaseModel):
    """The [identify.design] section: what the machine may be asked to do."""

    model_config = ConfigDict(extra="forbid")
    limit: float | str
    duration: float | str
    period: float | str
    joint_torque: float | str | None = None
    lowest: float | str | None = None
    highest: float | str | None = None
    shown: int = Field(ge=1, default=8)


class Candidate(NamedTuple):
    """One excitation: what it is, and its samples (the command or reference, SI)."""

    name: str
    samples: np.ndarray


class Ranked(NamedTuple):
    """One candidate judged.

    deviation: (P,) expected standard errors in SI units, inf where the log would not show an
    unknown; worst: the largest of them as a share of its unknown's size; peak: largest joint
    torque, Nm; crosses: whether both walls of the play are touched.
    """

    candidate: Candidate
    deviation: np.ndarray
    worst: float
    peak: float
    crosses: bool
    reason: str


def design(study: Study, spec: Spec) -> tuple[list[Ranked], Problem, np.ndarray]:
    """Candidates by the largest relative error expected, those that break a limit last; times, s.

    Errors are those of (sum over readings of J^T J / noise^2)^-1 at the values of the study,
    relative to an unknown's value (to half the width of its bounds for those of either sign).
    Rejected: the determinant of that matrix. A run that grazes a wall is so sensitive in ONE
    direction that it wins, with every single error five times larger.

    Raises: InputError where [identify.design] or the noise of a measured signal is missing.
    """
    given = study.section("identify").get("design")
    if given is None:
        fix = 'e.g. [identify.design] limit = 1.5, duration = "0.3 s", period = "1 ms"'
        raise InputError("identify.design", "must be given", "nothing", fix)
    wanted = check(Design, given, "identify.design")
    unit = study.law.reference_unit or study.drive.command_unit
    limit = float(to_si(wanted.limit, unit, "identify.design.limit"))
    period, duration = (
        float(to_si(getattr(wanted, k), "s", f"identify.design.{k}"))
        for k in ("period", "duration")
    )
    times = period * np.arange(round(duration / period) + 1)
    lowest = _frequency(wanted.lowest, 1.0 / duration, "lowest")
    highest = _frequency(wanted.highest, 0.05 / period, "highest")
    found = list(candidates(times, limit, lowest, highest))
    dt = period / np.ceil(period / study.run.dt - 1e-9)
    experiments = [_experiment(study, spec, c, times, period) for c in found]
    problem = Problem(experiments, read_free(spec, experiments[0]), dt=float(dt))
    most = wanted.joint_torque
    allowed = np.inf if most is None else float(to_si(most, "Nm", "identify.design.joint_torque"))
    return _ranked(problem, found, allowed), problem, times


def _frequency(given: float | str | None, otherwise: float, name: str) -> float:
    return otherwise if given is None else float(to_si(given, "Hz", f"identify.design.{name}"))


def candidates(
    times: np.ndarray, limit: float, lowest: float, highest: float
) -> Iterator[Candidate]:
    """Chirps, multisines (Schroeder's phases), sines and square waves at shares of the limit.

    Raises: InputError unless 0 < lowest < highest.
    """
    if not 0.0 < lowest < highest:
        got, fix = [lowest, highest], "give lowest < highest in Hz"
        raise InputError("identify.design", "must leave a band of frequencies", got, fix)
    starts = np.geomspace(lowest, highest, _BANDS + 1)[:-1]
    for level in _LEVELS:
        size = level * limit
        told = f"{100 * level:.0f} %"
        for f in starts:
            angle = 2.0 * np.pi * f * times
            yield Candidate(f"sine {f:.3g} Hz, {told}", size * np.sin(angle))
            yield Candidate(f"square {f:.3g} Hz, {told}", size * np.where(np.sin(angle) < 0, -1, 1))
            rate = (highest - f) / times[-1]
            swept = size * np.sin(angle + np.pi * rate * times**2)
            yield Candidate(f"chirp {f:.3g}-{highest:.3g} Hz, {told}", swept)
            mixed = _multisine(times, np.geomspace(f, highest, _LINES))
            name = f"multisine {f:.3g}-{highest:.3g} Hz, {told}"
            yield Candidate(name, size * mixed / np.abs(mixed).max())


def _multisine(times: np.ndarray, lines: np.ndarray) -> np.ndarray:
    k = np.arange(len(lines))
    phases = -np.pi * k * (k + 1) / len(lines)  # Schroeder (1970): a low crest factor
    return np.sin(2.0 * np.pi * np.outer(times, lines) + phases).sum(axis=1)


def _experiment(
    study: Study, spec: Spec, candidate: Candidate, times: np.ndarray, period: float
) -> Experiment:
    asked = Samples(candidate.samples, period, "hold", on_ticks=True)  # pyright: ignore
    scenario = Scenario(
        (asked, *study.scenario.reference[1:]), study.scenario.load_torque, study.scenario.start,
        duration=float(times[-1]),
    )  # fmt: skip
    zero = np.zeros(len(times) - 1)
    measured = []
    for key, column in spec.columns.items():
        if not is_measured(key):
            continue
        where = f"identify.columns.{key}.noise"
        if column.noise is None:
            rule = "must be given to design an experiment"
            raise InputError(where, rule, "nothing", "e.g. the sensor's rms")
        noise = float(to_si(column.noise, UNITS[key.partition("[")[0]], where))
        measured.append(measurement(key, times[1:], zero, noise))
    if "T_s" not in spec.columns:
        measured.append(measurement("T_s", times[1:], zero, _WEIGHTLESS))
    return Experiment(candidate.name, study.drive, study.law, scenario, tuple(measured))


def _ranked(problem: Problem, found: list[Candidate], allowed: float) -> list[Ranked]:
    values = problem.initial()
    frees = [problem.unknowns.free[i] for i in problem.unknowns.of]
    if any(f.own for f in frees):
        fix = 'free only what all logs share (each = "fit")'
        raise InputError("identify.free", "must be shared to design an experiment", "own", fix)
    half = np.array([0.5 * (f.upper - f.lower) for f in frees])
    signed = np.array([f.lower < 0.0 < f.upper for f in frees])
    sizes = np.where(signed, half, np.abs(values))
    who = np.arange(len(found))[:, None]
    rows = np.tile(values, (len(found), 1))
    seen = problem.evaluate(rows, np.tile(sizes, (len(found), 1)), who=who)
    torque = problem.signals.index("T_s")
    ranked = []
    for i, candidate in enumerate(found):
        J = seen.jacobian[i, 0].reshape(-1, len(values))
        noise = problem.readings.noise[i, torque]
        peak = float(np.abs(seen.residuals[i, 0, torque]).max() * noise)
        reason = "" if peak <= allowed else f"joint torque above {allowed:.3g} Nm"
        if seen.status[i, 0] != Status.OK.value:
            reason = Status(int(seen.status[i, 0])).words
        both = bool(crosses(seen.contact[i, 0]))
        ranked.append(Ranked(candidate, *_worth(J, sizes), peak, both, reason))
    return sorted(ranked, key=lambda r: (r.reason != "", r.worst))


def _worth(J: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, float]:
    """Expected standard errors in SI units, and the largest relative one; J by relative changes."""
    lost = np.full(len(sizes), np.inf), np.inf
    if not np.isfinite(J).all():
        return lost
    information = J.T @ J
    if np.linalg.cond(information) > 1e14:
        return lost
    relative = np.sqrt(np.diag(np.linalg.inv(information)))
    return sizes * relative, float(relative.max())
