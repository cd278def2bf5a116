"""Start values by plain regression, where the readings allow it: no simulation, no search.

Linear problems in smoothed readings and their rates, all on the load side, for what is free:

    load    J_L alpha_L + D_L omega_L = T_s
    motor   N^2 (J_M alpha_M + D_M omega_M) + N Fc sign(omega_M) = N T_M - T_s
    joint   K dz(theta_B; half_gap) + D_B omega_B [contact] = T_s, over a grid of half gaps

Without a torque sensor T_s is what a known motor leaves of its torque. Where one side only is read,
a drive is one inertia; without play and with the motor's side read, two, by its frequency response.
The values only have to come near: the fit decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.signal import savgol_filter

from jaxsim import tree
from jaxsim.errors import InputError
from jaxsim.law import Decentral
from jaxsim.laws.feedforward import Feedforward
from jaxsim.loads.inertia import Inertia
from jaxsim.motors.geared import Geared
from jaxsim.motors.ideal import Ideal
from jaxsim.transmissions.backlash import Backlash
from jaxsim.transmissions.elastic import Elastic
from tuning.identification.experiment import Experiment, Measurement
from tuning.identification.residuals import Problem
from tuning.identification.two_mass import two_masses

_NAMES = ("J_M", "D_M", "Fc", "half_gap", "K", "D_B", "J_L", "D_L")
_WINDOW, _DEGREE = 9, 4  # of the smoothing, in readings
_GRID = 100  # half gaps that are tried
_STILL = 0.02  # share of the largest speed below which its sign says nothing

Columns = Mapping[str, np.ndarray]


class _Seen(NamedTuple):
    """One experiment on the load side; None for what was not read.

    motor, load: (3, n) angle, speed, acceleration. torque: (n,) N T_M, joint: (n,) T_s; Nm.
    period: s.
    """

    motor: np.ndarray | None
    load: np.ndarray | None
    joint: np.ndarray | None
    torque: np.ndarray
    period: float


def regressed(problem: Problem, train: np.ndarray) -> dict[str, float]:
    """Values of shared free parameters by name, in SI units; only those that the logs give.

    For drives of one axis with an ideal or geared motor, backlash or elastic transmission and a
    plain inertia, read at equal steps, of which the commanded torque is known.

    train: the experiments to look at.
    """
    chosen = [problem.experiments[int(e)] for e in train]
    if not all(_plain(e) for e in chosen):
        return {}
    known = {n: _value(chosen[0], n) for n in _NAMES}
    frees = {f.paths[0].rpartition(".")[2]: f for f in problem.unknowns.free if not f.own}
    frees = {n: f for n, f in frees.items() if n in _NAMES}
    seen = [s for s in (_seen(e) for e in chosen) if s is not None]
    if not seen or not frees:
        return {}
    found = _found(seen, known, frees, _value(chosen[0], "N"))
    return {
        frees[n].name: v
        for n, v in found.items()
        if np.isfinite(v) and frees[n].lower < v < frees[n].upper
    }


def _plain(e: Experiment) -> bool:
    drive = e.drive
    law = e.law.laws[0] if isinstance(e.law, Decentral) else e.law
    return (
        drive.axes == 1
        and isinstance(law, Feedforward)
        and isinstance(drive.motor[0], Ideal | Geared)
        and isinstance(drive.transmission[0], Backlash | Elastic)
        and isinstance(drive.load, Inertia)
    )


def _value(e: Experiment, name: str) -> float:
    """A parameter of the drive; 0 of one that it does not have."""
    try:
        return float(tree.get(e.drive, name))
    except InputError:
        return 0.0


def _seen(e: Experiment) -> _Seen | None:
    """The readings as regressors; None where they are not at equal steps, or too few."""
    read = {m.signal: m for m in e.measurements}
    first = e.measurements[0].times
    period = float(np.median(np.diff(first)))
    alike = all(np.array_equal(m.times, first) for m in e.measurements)
    if not alike or first.size < 5 * _WINDOW or np.ptp(np.diff(first)) > 0.01 * period:
        return None
    N = _value(e, "N")
    load = _rates(read, "theta_L", "omega_L", period, 1.0)
    motor = _rates(read, "theta_M", "omega_M", period, 1.0 / N)
    deflection = _rates(read, "theta_B", "omega_B", period, 1.0)
    if deflection is not None and load is not None and motor is None:
        motor = load + deflection
    torque = N * _commanded(e, first, period)
    joint = _smooth(_filled(read["T_s"]), period)[0] if "T_s" in read else None
    return _Seen(motor, load, joint, _smooth(torque, period)[0], period)


def _commanded(e: Experiment, times: np.ndarray, period: float) -> np.ndarray:
    """The command at the readings; of a held one the mean of before and after."""
    value = jax.vmap(e.scenario.reference[0].value)
    apart = 1e-3 * period
    return np.mean([np.asarray(value(times, times + a)) for a in (-apart, apart)], axis=0)


def _rates(
    read: Mapping[str, Measurement], angle: str, speed: str, period: float, share: float
) -> np.ndarray | None:
    """Angle (from 0 where only the speed was read), speed and acceleration, times `share`."""
    if angle in read:
        return share * np.stack(_smooth(_filled(read[angle]), period))
    if speed not in read:
        return None
    omega, alpha, _ = _smooth(_filled(read[speed]), period)
    return share * np.stack([np.cumsum(omega) * period, omega, alpha])


def _filled(m: Measurement) -> np.ndarray:
    """Readings less the sensor's offset and scale, joined by straight lines where masked."""
    values = np.interp(m.times, m.times[m.used], m.values[m.used])
    return (values - float(m.sensor.offset)) / float(m.sensor.scale)


def _smooth(values: np.ndarray, period: float) -> list[np.ndarray]:
    """Value and two rates by local polynomials: the same smoothing for all that is compared."""
    return [
        np.asarray(savgol_filter(values, _WINDOW, _DEGREE, deriv=k, delta=period, mode="interp"))
        for k in range(3)
    ]


def _found(
    seen: Sequence[_Seen], known: dict[str, float], free: Mapping[str, Any], N: float
) -> dict[str, float]:
    motor, load, joint = (_joined([getattr(s, k) for s in seen]) for k in _Seen._fields[:3])
    torque = np.concatenate([s.torque for s in seen])
    unknown = set(free)
    if motor is not None and joint is None and load is not None and not {"J_M", "D_M"} & unknown:
        left = [known[n] * v for n, v in _motor(motor, N).items()]
        joint = torque - np.sum(left, axis=0)
    if joint is None:
        return _one_side(seen, motor if load is None else load, torque, known, free, N)
    found: dict[str, float] = {}
    if load is not None:
        found |= _solved({"J_L": load[2], "D_L": load[1]}, joint, known, unknown)
    if motor is not None:
        found |= _solved(_motor(motor, N), torque - joint, known, unknown)
    if motor is not None and load is not None:
        found |= _joint(motor - load, joint, known, free)
    return found


def _joined(parts: Sequence[np.ndarray | None]) -> np.ndarray | None:
    """All experiments behind each other; None unless every one of them was read."""
    read = [p for p in parts if p is not None]
    return np.concatenate(read, axis=-1) if len(read) == len(parts) else None


def _motor(motor: np.ndarray, N: float) -> dict[str, np.ndarray]:
    still = np.abs(motor[1]) < _STILL * np.abs(motor[1]).max()
    side = np.where(still, 0.0, np.sign(motor[1]))
    return {"J_M": N**2 * motor[2], "D_M": N**2 * motor[1], "Fc": N * side}


def _joint(
    deflection: np.ndarray, torque: np.ndarray, known: dict[str, float], free: Mapping[str, Any]
) -> dict[str, float]:
    """Stiffness and damping by least squares for each of many half gaps; the best of them."""
    gaps = [known["half_gap"]]
    if "half_gap" in free:
        top = min(free["half_gap"].upper, float(np.abs(deflection[0]).max()))
        gaps = list(np.linspace(free["half_gap"].lower, top, _GRID)) if top > 0.0 else gaps
    tried = []
    for gap in gaps:
        over = np.sign(deflection[0]) * np.maximum(np.abs(deflection[0]) - gap, 0.0)
        columns = {"K": over, "D_B": np.where(over != 0.0, deflection[1], 0.0)}
        found = _solved(columns, torque, known, set(free))
        values = {**known, **found}
        left = torque - np.sum([values[n] * v for n, v in columns.items()], axis=0)
        more = {"half_gap": float(gap)} if "half_gap" in free else {}
        tried.append((float(left @ left), found | more))
    return min(tried, key=lambda t: t[0])[1]


def _one_side(
    seen: Sequence[_Seen], moved: np.ndarray | None, torque: np.ndarray,
    known: dict[str, float], free: Mapping[str, Any], N: float,
) -> dict[str, float]:  # fmt: skip
    """Two inertias by the frequency response of the motor; else one inertia of both sides."""
    if moved is None:
        return {}
    if "K" in free and "half_gap" not in free and known["half_gap"] == 0.0 and len(seen) == 1:
        only = seen[0]
        if only.motor is None:
            return {}
        found = two_masses(only.torque, only.motor[1], only.period)
        share = {"J_M": N**2, "D_M": N**2}
        return {n: v / share.get(n, 1.0) for n, v in found.items() if n in free}
    columns = {**_motor(moved, N), "J_L": moved[2], "D_L": moved[1]}
    both = [set(pair) <= set(free) for pair in (("J_M", "J_L"), ("D_M", "D_L"))]
    return {} if any(both) else _solved(columns, torque, known, set(free))


def _solved(
    columns: Columns, right: np.ndarray, known: Mapping[str, float], unknown: set[str]
) -> dict[str, float]:
    """Least squares for the unknown columns, the known ones taken to the right."""
    names = [n for n in columns if n in unknown and np.any(columns[n])]
    if not names:
        return {}
    for n, v in columns.items():
        right = right if n in unknown else right - known[n] * v
    A = np.stack([columns[n] for n in names], axis=1)
    size = np.linalg.norm(A, axis=0)
    found = np.linalg.lstsq(A / size, right, rcond=1e-6)[0] / size
    return dict(zip(names, found.tolist(), strict=True))


__all__ = ["regressed"]
