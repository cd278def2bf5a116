"""An event-accurate solution of the two-inertia bench of the 2018 paper, without JAX.

The closed loop has six states s = [omega_L, omega_B, theta_L, theta_B, z, r] (z: derivative
filter, r: filtered reference) and is affine in every mode: contact (gap, +, -), released by
`no_pull` or not, damping on or off. So each mode is solved by its own exponential series, and
only the instants at which the mode changes are searched for, to rounding.

Modes are carried, never read off the signs of a state that has just landed on a surface: there
the sign is that of a rounding error.

This file shares no code with the package that it judges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.optimize import brentq

Law = Literal["none", "linear", "switched"]
Array = np.ndarray
Metrics = dict[str, float]
Surface = tuple[str, int]  # name and side of a guard

OMEGA_L, OMEGA_B, THETA_L, THETA_B, Z, R, ONE = range(7)  # ONE carries the affine term

# Series of exp(M h): with |pole| h <= REACH the first term left out is below 0.2^17/17! = 4e-27
# of the state, so that even badly scaled matrices stay at rounding. A short reach also makes a
# guard so smooth within an interval that it dips below zero at most once there.
DEGREE = 16
REACH = 0.2
BLOCK = 32  # intervals looked at together; events are seldom farther apart than this
MAX_EVENTS = 100_000  # a run that chatters without end stops here instead of hanging

BAND = 0.02  # settling band, share of the step
GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(DEGREE + 2)  # exact for a squared series


@dataclass(frozen=True)
class Params:
    """Table II, the PD design of the errata, and K_B of the paper (the law 'none' ignores it)."""

    J_M: float = 8.78e-4  # kg m2
    D_M: float = 9.30e-2  # Nm s/rad
    K: float = 3.00e2  # Nm/rad
    D_B: float = 1.00e-1  # Nm s/rad
    J_L: float = 8.78e-4  # kg m2
    D_L: float = 3.60e-2  # Nm s/rad
    half_gap: float = 7.80e-3  # rad
    K_P: float = 10.28129662037006  # Nm/rad
    K_D: float = 0.05470907749696041  # Nm s/rad
    tau_D: float = 5.82812354062619e-3  # s
    K_B: float = -0.80  # Nm s/rad
    f_ref: float = 20.0  # Hz


@dataclass(frozen=True)
class Event:
    """A change of mode.

    surface: 'contact' | 'separation' | 'release' | 'press' (the last two: no_pull) with `side`
    the side of the gap, +1 or -1; or 'omega_L' | 'omega_B' with `side` the new sign.
    """

    time: float
    surface: str
    side: int
    omega_B: float


class Mode(NamedTuple):
    """The discrete state.

    A sign 0 is a speed that is identically zero; it counts as equality in
    omega_B * omega_L >= 0, so the damping is on.
    """

    contact: int  # side of the gap that touches, or 0
    released: bool  # touching, but T_s = 0 because it would pull
    sign_B: int
    sign_L: int


class Guard(NamedTuple):
    """The mode holds while row @ state >= 0; then `follower` takes over."""

    surface: str
    side: int
    row: Array
    follower: Mode


class Flow(NamedTuple):
    """What is constant within an interval."""

    h: float  # longest interval of the series
    series: Array  # (DEGREE + 1, 7, 7): (M h)^j / j!
    torque: Array  # rows: T_s, T_M and the damping torque of the contact
    motor_torque: Array
    contact_damping: Array


@dataclass(frozen=True)
class Task:
    """The arguments of `solve`."""

    params: Params
    law: Law
    step: float
    t_step: float
    duration: float
    start: tuple[float, float, float, float]
    loads: tuple[tuple[float, float], ...]
    position_loop: bool
    no_pull: bool


# ---------------------------------------------------------------------------------------------
# The plant and its modes


def _unit(component: int, size: float = 1.0) -> Array:
    row = np.zeros(7)
    row[component] = size
    return row


class _Modes:
    """Affine flows and guards of one task."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self._flows: dict[tuple[int, float, float, float], Flow] = {}

    def flow(self, mode: Mode, reference: float, load: float) -> Flow:
        side = 0 if mode.released else mode.contact
        key = (side, self._damping_gain(mode), reference, load)
        if key not in self._flows:
            self._flows[key] = self._build(*key)
        return self._flows[key]

    def _damping_gain(self, mode: Mode) -> float:
        law = self.task.law
        off = law == "none" or (law == "switched" and mode.sign_B * mode.sign_L < 0)
        return 0.0 if off else self.task.params.K_B

    def raw_torque(self, side: int) -> Array:
        """(5), without regard to pulling."""
        p = self.task.params
        play = _unit(ONE, -side * p.K * p.half_gap)
        return _unit(OMEGA_B, p.D_B) + _unit(THETA_B, p.K) + play

    def _motor_torque(self, gain: float) -> Array:
        """(20)-(22); without position loop only the damping acts."""
        p = self.task.params
        damping = _unit(OMEGA_B, gain)
        if not self.task.position_loop:
            return damping
        error = _unit(R) - _unit(THETA_L)
        return p.K_P * error + p.K_D * (error - _unit(Z)) / p.tau_D + damping

    def _build(self, side: int, gain: float, reference: float, load: float) -> Flow:
        p = self.task.params
        torque = self.raw_torque(side) if side else np.zeros(7)
        motor_torque = self._motor_torque(gain)
        speed_M = _unit(OMEGA_L) + _unit(OMEGA_B)
        M = np.zeros((7, 7))
        M[OMEGA_L] = (torque - _unit(OMEGA_L, p.D_L) + _unit(ONE, load)) / p.J_L
        M[OMEGA_B] = (motor_torque - p.D_M * speed_M - torque) / p.J_M - M[OMEGA_L]
        M[THETA_L, OMEGA_L] = 1.0
        M[THETA_B, OMEGA_B] = 1.0
        M[Z] = (_unit(R) - _unit(THETA_L) - _unit(Z)) / p.tau_D
        M[R] = 2.0 * np.pi * p.f_ref * (_unit(ONE, reference) - _unit(R))
        h = REACH / np.abs(np.linalg.eigvals(M)).max()
        contact_damping = _unit(OMEGA_B, p.D_B if side else 0.0)
        return Flow(h, _exponential_series(M * h), torque, motor_torque, contact_damping)

    def guards(self, mode: Mode) -> list[Guard]:
        return [*self._contact_guards(mode), *self._speed_guards(mode)]

    def _contact_guards(self, mode: Mode) -> Iterator[Guard]:
        half_gap, side = self.task.params.half_gap, mode.contact
        if not side:
            for wall in (1, -1):
                inside = _unit(ONE, half_gap) - _unit(THETA_B, wall)
                yield Guard("contact", wall, inside, mode._replace(contact=wall))
            return
        beyond = _unit(THETA_B, side) - _unit(ONE, half_gap)
        yield Guard("separation", side, beyond, mode._replace(contact=0, released=False))
        if self.task.no_pull:
            push = side * self.raw_torque(side)
            surface, row = ("press", -push) if mode.released else ("release", push)
            yield Guard(surface, side, row, mode._replace(released=not mode.released))

    def _speed_guards(self, mode: Mode) -> Iterator[Guard]:
        if self.task.law != "switched":
            return
        if mode.sign_B:
            row, flipped = _unit(OMEGA_B, mode.sign_B), mode._replace(sign_B=-mode.sign_B)
            yield Guard("omega_B", -mode.sign_B, row, flipped)
        if mode.sign_L:
            row, flipped = _unit(OMEGA_L, mode.sign_L), mode._replace(sign_L=-mode.sign_L)
            yield Guard("omega_L", -mode.sign_L, row, flipped)

    def first(self, state: Array) -> Mode:
        """The mode of a start: here the state is exact, and contact includes the boundary."""
        theta_B, half_gap = state[THETA_B], self.task.params.half_gap
        side = int(np.sign(theta_B)) if theta_B and abs(theta_B) >= half_gap else 0
        pulls = bool(side) and side * (self.raw_torque(side) @ state) < 0.0
        return Mode(side, self.task.no_pull and pulls, 0, 0)


def _exponential_series(M: Array) -> Array:
    terms = [np.eye(7)]
    for j in range(1, DEGREE + 1):
        terms.append(terms[-1] @ M / j)
    return np.array(terms)


# ---------------------------------------------------------------------------------------------
# Polynomials in x = (t - t0) / length on [0, 1], coefficients in rising order


def _value(poly: Sequence[float], x: float) -> float:
    total = 0.0
    for c in reversed(poly):
        total = total * x + c
    return total


def _slope(poly: Sequence[float]) -> list[float]:
    return [j * c for j, c in enumerate(poly)][1:]


def _root(poly: Sequence[float], a: float, b: float) -> float:
    at_a, at_b = _value(poly, a), _value(poly, b)
    if at_a * at_b > 0.0:  # callers add up the series in another order: an end is the root
        return a if abs(at_a) < abs(at_b) else b
    return brentq(lambda x: _value(poly, x), a, b, xtol=1e-16, rtol=4 * np.finfo(float).eps)


def _turning_point(poly: Sequence[float]) -> float | None:
    """Where the slope changes sign between 0 and 1."""
    slope = _slope(poly)
    return _root(slope, 0.0, 1.0) if slope and slope[0] * sum(slope) < 0.0 else None


def _sign_changes(poly: Sequence[float]) -> list[float]:
    """Where a polynomial with at most one turning point changes sign."""
    turn = _turning_point(poly)
    knots = [0.0, 1.0] if turn is None else [0.0, turn, 1.0]
    values = [_value(poly, x) for x in knots]
    return [
        _root(poly, knots[k], knots[k + 1])
        for k in range(len(knots) - 1)
        if (values[k] < 0.0) != (values[k + 1] < 0.0)
    ]


def _end_slopes(poly: Array) -> tuple[Array, Array]:
    """Slopes at x = 0 and 1, of coefficients along axis 1."""
    return poly[:, 1], np.tensordot(poly, np.arange(poly.shape[1]), axes=([1], [0]))


def _restrict(poly: Array, x: float) -> Array:
    """Coefficients (DEGREE + 1, ...) of the part up to x, over [0, 1] again."""
    return poly * (x ** np.arange(len(poly)))[:, None]


def _leading_sign(poly: Array) -> int:
    """The sign just after x = 0; 0 if identically zero."""
    return int(np.sign(next(iter(poly[poly != 0.0]), 0.0)))


def _exit(poly: list[float]) -> float | None:
    """Where a guard that holds at 0 first becomes negative.

    An exactly zero leading coefficient is a guard that was just landed on, or a body at rest:
    divided by x as often as needed, the rest tells which way it leaves.
    """
    while poly and poly[0] == 0.0:
        poly = poly[1:]
    if not poly:
        return None
    if poly[0] < 0.0:
        return 0.0
    return next(iter(_sign_changes(poly)), None)


# ---------------------------------------------------------------------------------------------
# The solver


class _Segment(NamedTuple):
    """Consecutive intervals in one mode."""

    mode: Mode
    flow: Flow
    t0: Array  # (n,)
    length: Array  # (n,)
    poly: Array  # (n, DEGREE + 1, 7)


class _Solver:
    def __init__(self, task: Task) -> None:
        self.task = task
        self.modes = _Modes(task)
        self.t = 0.0
        self.state = np.array([*task.start, 0.0, 0.0, 1.0])
        self.mode = self.modes.first(self.state)
        self.landed: Surface | None = None  # what the state lies on, to rounding
        self.segments: list[_Segment] = []
        self.events: list[Event] = []

    def run(self) -> None:
        changes = {self.task.t_step, *(t for t, _ in self.task.loads)}
        inner = sorted(t for t in changes if 0.0 < t < self.task.duration)
        for until in (*inner, self.task.duration):
            reference, load = self._inputs()
            while self.t < until:
                self._advance(until, reference, load)
                if len(self.events) > MAX_EVENTS:
                    raise RuntimeError(f"more than {MAX_EVENTS} events before t = {self.t} s")

    def _inputs(self) -> tuple[float, float]:
        """Reference and load torque from now to the next change."""
        reference = self.task.step if self.t >= self.task.t_step else 0.0
        return reference, sum(torque for t, torque in self.task.loads if t <= self.t)

    def _advance(self, until: float, reference: float, load: float) -> None:
        """Up to the next event, or through one block of intervals."""
        flow = self.modes.flow(self.mode, reference, load)
        if self.task.law == "switched" and not (self.mode.sign_B and self.mode.sign_L):
            self._find_signs(flow)
            flow = self.modes.flow(self.mode, reference, load)
        t0, length, poly = self._block(flow, until)
        found = self._first_exit(poly, self.modes.guards(self.mode))
        if found is None:
            self._accept(flow, t0, length, poly)
            self.landed = None
            return
        i, x, guard = found
        length[i], poly[i] = x * length[i], _restrict(poly[i], x)
        last = i if x == 0.0 else i + 1  # no interval without length
        self._accept(flow, t0[:last], length[:last], poly[:last])
        self._land(guard)

    def _find_signs(self, flow: Flow) -> None:
        """Signs of speeds that were identically zero so far, from their first derivative != 0.

        It is the same with damping on and off: K_B * omega_B cannot be what first moves omega_B.
        """
        poly = flow.series @ self.state
        sign_B = self.mode.sign_B or _leading_sign(poly[:, OMEGA_B])
        sign_L = self.mode.sign_L or _leading_sign(poly[:, OMEGA_L])
        self.mode = self.mode._replace(sign_B=sign_B, sign_L=sign_L)

    def _block(self, flow: Flow, until: float) -> tuple[Array, Array, Array]:
        steps = max(1, int(np.ceil((until - self.t) / flow.h)))
        n = min(BLOCK, steps)
        t0 = self.t + flow.h * np.arange(n)
        length = np.full(n, flow.h)
        propagator = flow.series.sum(axis=0)
        states = np.empty((n, 7))
        states[0] = self.state
        for k in range(1, n):
            states[k] = propagator @ states[k - 1]
        poly = np.einsum("jab,nb->nja", flow.series, states)
        if n == steps:
            length[-1] = until - t0[-1]
            poly[-1] = _restrict(poly[-1], length[-1] / flow.h)
        return t0, length, poly

    def _first_exit(self, poly: Array, guards: list[Guard]) -> tuple[int, float, Guard] | None:
        values = poly @ np.array([g.row for g in guards]).T  # (n, DEGREE + 1, guards)
        for k, guard in enumerate(guards):
            if guard[:2] == self.landed:
                values[0, 0, k] = 0.0
        before, after = _end_slopes(values)
        suspect = (values.sum(axis=1) < 0.0) | ((before < 0.0) & (after > 0.0))
        suspect[0] = True  # a fresh landing or start may leave at once
        for i in np.flatnonzero(suspect.any(axis=1)):
            exits = [(_exit(values[i, :, k].tolist()), g) for k, g in enumerate(guards)]
            exits = [(x, g) for x, g in exits if x is not None]
            if exits:
                x, guard = min(exits, key=lambda item: item[0])
                return int(i), x, guard
        return None

    def _accept(self, flow: Flow, t0: Array, length: Array, poly: Array) -> None:
        if len(t0):
            self.segments.append(_Segment(self.mode, flow, t0, length, poly))
            self.state = poly[-1].sum(axis=0)
            self.state[ONE] = 1.0
            self.t = float(t0[-1] + length[-1])

    def _land(self, guard: Guard) -> None:
        self.events.append(Event(self.t, guard.surface, guard.side, float(self.state[OMEGA_B])))
        self.mode = guard.follower
        self.landed = _seen_from_behind(guard)


def _seen_from_behind(guard: Guard) -> Surface:
    """What the guard of the same surface is called in the mode that follows."""
    names = {"contact": "separation", "release": "press"}
    names |= {after: before for before, after in names.items()}
    if guard.surface in names:
        return names[guard.surface], guard.side
    return guard.surface, -guard.side  # a sign changes back


# ---------------------------------------------------------------------------------------------
# The solution and its metrics


class Extreme(NamedTuple):
    value: float
    time: float


@dataclass(frozen=True)
class Solution:
    """A solved run: series of the state on intervals that never straddle an event or an input.

    t0, length (n,) s: where the intervals lie;
    poly (n, DEGREE + 1, 7): state = sum_j poly[:, j] x^j with x = (t - t0) / length;
    contact (n,): side of the gap that touches (also while released by no_pull), or 0;
    torque_rows, motor_rows, damping_rows (n, 7): T_s, T_M and the damping part of T_s are
    row @ state;
    breakpoints (m,) s: where the mode or an input changes, with the start and the end.
    """

    task: Task
    events: tuple[Event, ...]
    breakpoints: Array
    t0: Array
    length: Array
    poly: Array
    contact: Array
    torque_rows: Array
    motor_rows: Array
    damping_rows: Array

    def state(self, t: Any) -> Array:
        """(..., 6): omega_L, omega_B, theta_L, theta_B, z, r at the times t."""
        return self._sample(t)[1][..., :ONE]

    def torque(self, t: Any) -> Array:
        """T_s at the times t; at an event the value after it."""
        i, states = self._sample(t)
        return np.sum(self.torque_rows[i] * states, axis=-1)

    def motor_torque(self, t: Any) -> Array:
        """T_M at the times t; at an event the value after it."""
        i, states = self._sample(t)
        return np.sum(self.motor_rows[i] * states, axis=-1)

    def _sample(self, t: Any) -> tuple[Array, Array]:
        i = np.searchsorted(self.t0, np.asarray(t, float), side="right") - 1
        x = (np.asarray(t, float) - self.t0[i]) / self.length[i]
        powers = x[..., None] ** np.arange(DEGREE + 1)
        return i, np.einsum("...j,...ja->...a", powers, self.poly[i])

    def metrics(self) -> Metrics:
        """All metrics by name; see the functions that make them up."""
        return {
            **self._impacts(),
            **self._response(),
            **self._tracking(),
            **self._effort(),
        }

    # Series of the quantities that the metrics look at, (n, DEGREE + 1).

    @cached_property
    def _torque_poly(self) -> Array:
        return np.einsum("nja,na->nj", self.poly, self.torque_rows)

    @cached_property
    def _motor_poly(self) -> Array:
        return np.einsum("nja,na->nj", self.poly, self.motor_rows)

    @cached_property
    def _after_step(self) -> Array:
        # Interval ends hit t_step to rounding only; the middle tells on which side they lie.
        return np.flatnonzero(self.t0 + 0.5 * self.length >= self.task.t_step)

    # Metrics.

    def _impacts(self) -> Metrics:
        """First contact interval, and the first on the other side; nan where there is none.

        A run that starts in contact has its first contact at 0. The entry speed has its sign; a
        peak is the largest T_s in the direction of the contact, with the sign of T_s. Contact is
        |theta_B| >= half_gap, also while no_pull has released it.
        """
        runs = self._contact_runs()
        first = runs[:1]
        braking = [run for run in runs if self.contact[run[0]] != self.contact[runs[0][0]]][:1]
        peak, braking_peak = self._impact_peak(first), self._impact_peak(braking)
        return {
            "first_contact_s": self._start(first),
            "first_entry_wB_rad_s": self.poly[first[0][0], 0, OMEGA_B] if first else np.nan,
            "first_impact_peak_Nm": peak.value,
            "first_impact_peak_time_s": peak.time,
            "first_separation_s": self._separation(first),
            "braking_contact_s": self._start(braking),
            "braking_peak_Nm": braking_peak.value,
            "braking_peak_time_s": braking_peak.time,
        }

    def _contact_runs(self) -> list[range]:
        """Intervals of each contact, in order."""
        edges = np.flatnonzero(np.diff(self.contact)) + 1
        bounds = [0, *edges.tolist(), len(self.contact)]
        runs = [range(a, b) for a, b in pairwise(bounds)]
        return [run for run in runs if self.contact[run[0]]]

    def _start(self, runs: list[range]) -> float:
        return self.t0[runs[0][0]] if runs else np.nan

    def _separation(self, runs: list[range]) -> float:
        over = runs and runs[0].stop < len(self.t0)
        return self.t0[runs[0].stop] if over else np.nan

    def _impact_peak(self, runs: list[range]) -> Extreme:
        if not runs:
            return Extreme(np.nan, np.nan)
        side = float(self.contact[runs[0][0]])
        top = self._maximum(side * self._torque_poly, np.array(runs[0]))
        return Extreme(side * top.value, top.time)

    def _response(self) -> Metrics:
        """The step response of theta_L: nan without a step, inf for what never happens.

        t50 is an absolute time; settle_2pct counts from the step to the last entry into the band.
        """
        top = self._maximum(self.poly[:, :, THETA_L], np.arange(len(self.t0)))
        result = {"theta_max_rad": top.value, "theta_max_time_s": top.time}
        step = self.task.step
        if step == 0.0:
            names = ("overshoot_rad", "overshoot_pct", "rise_10_90_s", "t50_s", "settle_2pct_s")
            return result | dict.fromkeys(names, np.nan)
        share = self.poly[:, :, THETA_L] / step
        over = max(self._maximum(share, self._after_step).value - 1.0, 0.0)
        ten, fifty, ninety = (self._first_passage(share, x) for x in (0.1, 0.5, 0.9))
        return result | {
            "overshoot_rad": over * abs(step),
            "overshoot_pct": 100.0 * over,
            "rise_10_90_s": ninety - ten if np.isfinite(ninety) else np.inf,
            "t50_s": fifty,
            "settle_2pct_s": self._settling_time(share),
        }

    def _first_passage(self, share: Array, level: float) -> float:
        times = self._passages(share, level)
        return times[0] if len(times) else np.inf

    def _settling_time(self, share: Array) -> float:
        if abs(share[-1].sum() - 1.0) > BAND:
            return np.inf
        edges = (self._passages(share, 1.0 + sign * BAND) for sign in (1, -1))
        last = [float(times[-1]) for times in edges if len(times)]
        return max(last, default=self.task.t_step) - self.task.t_step

    def _tracking(self) -> Metrics:
        """Integrals of |step - theta_L| from the step to the end, weight 1 and t - t_step."""
        error = -self.poly[:, :, THETA_L]
        error[:, 0] += self.task.step
        part = self._split(error, self._after_step)
        size = np.abs(_at(error[part.i], part.x))
        t = self.t0[part.i, None] + self.length[part.i, None] * part.x - self.task.t_step
        return {
            "IAE_rad_s": float(np.sum(part.weight * size)),
            "ITAE_rad_s2": float(np.sum(part.weight * size * t)),
        }

    def _effort(self) -> Metrics:
        """Torques over the whole run, and what the damping of the contact turns into heat."""
        everywhere = np.arange(len(self.t0))
        x = np.broadcast_to(0.5 * (GAUSS_X + 1.0), (len(everywhere), len(GAUSS_X)))
        damping = np.einsum("nja,na->nj", self.poly, self.damping_rows)
        power = _at(damping, x) * _at(self.poly[:, :, OMEGA_B], x)
        extremes = [self._maximum(s * self._torque_poly, everywhere).value for s in (1.0, -1.0)]
        return {
            "TM_max_Nm": self._maximum(self._motor_poly, everywhere).value,
            "TM_min_Nm": -self._maximum(-self._motor_poly, everywhere).value,
            "largest_torque_Nm": max(extremes),
            "impact_energy_J": float(0.5 * self.length @ (power @ GAUSS_W)),
        }

    # What they share.

    def _maximum(self, poly: Array, chosen: Array) -> Extreme:
        """The largest value on the chosen intervals: at their ends or where the slope vanishes."""
        p = poly[chosen]
        before, after = _end_slopes(p)
        candidates = [(float(p[k].sum()), k, 1.0) for k in [int(np.argmax(p.sum(axis=1)))]]
        candidates += [(float(p[k, 0]), k, 0.0) for k in [int(np.argmax(p[:, 0]))]]
        for k in np.flatnonzero((before > 0.0) & (after < 0.0)):
            x = _root(_slope(p[k].tolist()), 0.0, 1.0)
            candidates.append((_value(p[k].tolist(), x), int(k), x))
        value, k, x = max(candidates)
        return Extreme(value, float(self.t0[chosen[k]] + x * self.length[chosen[k]]))

    def _changes(self, poly: Array, chosen: Array) -> list[tuple[int, list[float]]]:
        """The chosen intervals in which a series changes sign, and where."""
        p = poly[chosen]
        before, after = _end_slopes(p)
        suspect = ((p[:, 0] < 0.0) != (p.sum(axis=1) < 0.0)) | (before * after < 0.0)
        found = [(int(chosen[k]), _sign_changes(p[k].tolist())) for k in np.flatnonzero(suspect)]
        return [(i, xs) for i, xs in found if xs]

    def _passages(self, poly: Array, level: float) -> list[float]:
        """Times after the step at which a series passes a level."""
        shifted = poly.copy()
        shifted[:, 0] -= level
        changes = self._changes(shifted, self._after_step)
        return [float(self.t0[i] + x * self.length[i]) for i, xs in changes for x in xs]

    def _split(self, poly: Array, chosen: Array) -> _Quadrature:
        """Gauss points on the chosen intervals, cut where the series changes sign."""
        cuts = dict(self._changes(poly, chosen))
        parts = [
            (i, a, b) for i in chosen.tolist() for a, b in pairwise([0.0, *cuts.get(i, ()), 1.0])
        ]
        i, a, b = (np.array(column) for column in zip(*parts, strict=True))
        half = 0.5 * (b - a)[:, None]
        x = 0.5 * (a + b)[:, None] + half * GAUSS_X
        return _Quadrature(i, x, self.length[i, None] * half * GAUSS_W)


class _Quadrature(NamedTuple):
    i: Array  # (m,) interval
    x: Array  # (m, nodes) within it
    weight: Array  # (m, nodes) s


def _at(poly: Array, x: Array) -> Array:
    """Series (m, DEGREE + 1) at the points x (m, nodes)."""
    return np.einsum("mj,mqj->mq", poly, x[..., None] ** np.arange(poly.shape[1]))


# ---------------------------------------------------------------------------------------------
# Entrances


def solve(
    params: Params,
    law: Law,
    *,
    step: float = 0.30,
    t_step: float = 0.010,
    duration: float = 0.3,
    start: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    loads: Sequence[tuple[float, float]] = (),
    position_loop: bool = True,
    no_pull: bool = False,
) -> Solution:
    """The closed loop from 0 to `duration`, accurate to rounding.

    params: plant and gains; law: of the torsional damping, (22) or (23);
    step, t_step: the reference is 0 rad, then `step` (before the 20 Hz filter);
    start: omega_L, omega_B rad/s, theta_L, theta_B rad; both filters start at 0;
    loads: (time s, torque Nm added to d_L from then on);
    position_loop: False leaves T_M = T_B;
    no_pull: T_s is clipped at 0 where it would pull.
    """
    loads = tuple((float(t), float(torque)) for t, torque in loads)
    task = Task(params, law, step, t_step, duration, start, loads, position_loop, no_pull)
    solver = _Solver(task)
    solver.run()
    segments = solver.segments
    counts = [len(s.t0) for s in segments]
    starts = [s.t0[0] for s in segments]
    return Solution(
        task=task,
        events=tuple(solver.events),
        breakpoints=np.array([*starts, solver.t]),
        t0=np.concatenate([s.t0 for s in segments]),
        length=np.concatenate([s.length for s in segments]),
        poly=np.concatenate([s.poly for s in segments]),
        contact=np.repeat([s.mode.contact for s in segments], counts),
        torque_rows=np.repeat([s.flow.torque for s in segments], counts, axis=0),
        motor_rows=np.repeat([s.flow.motor_torque for s in segments], counts, axis=0),
        damping_rows=np.repeat([s.flow.contact_damping for s in segments], counts, axis=0),
    )


def central_differences(
    fun: Callable[[Params], Any],
    params: Params,
    names: Sequence[str],
    *,
    rel: float = 1e-5,
) -> dict[str, Array]:
    """d fun / d params[name] for each name; steps of `rel` times the parameter, so not for 0.

    rel = 1e-5 balances what is cut off, O(rel^2), against rounding, 1e-16 / rel.
    """
    gradients = {}
    for name in names:
        value = getattr(params, name)
        up, down = (value * (1.0 + sign * rel) for sign in (1, -1))
        change = np.asarray(fun(replace(params, **{name: up}))) - np.asarray(
            fun(replace(params, **{name: down}))
        )
        gradients[name] = change / (up - down)  # the step that rounding left
    return gradients
