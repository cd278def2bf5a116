"""Linear analysis of a study: poles, zeros, bandwidth, margins and stability, contact by contact.

Everything is read off linearisations of the study's own closed loop, so it serves any drive and
law; the Routh-Hurwitz region is added where the study is a torque loop of the 2014 paper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxsim import tree
from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import JointLaw
from jaxsim.linear import frequency, operating, routh
from jaxsim.linear.frequency import Margins
from jaxsim.linear.joints import JointSystem, per_joint
from jaxsim.linear.linearise import Linearised, joint_system, linearise
from jaxsim.linear.stability import Interval, stable_intervals
from jaxsim.linear.state_space import StateSpace, per_axis, poles
from jaxsim.linear.zeros import zeros
from jaxsim.loop import ClosedLoop
from jaxsim.sampled import Sampled
from jaxsim.study import Study

_MARGINAL = 1e-9  # of the fastest pole: a real part below it is zero


class Family(NamedTuple):
    """A = A_0 + k A_1: how the closed loop depends on one factor k, which is 1 in the study."""

    A_0: np.ndarray
    A_1: np.ndarray

    def roots(self, k: float) -> np.ndarray:
        """The poles at k, 1/s."""
        return np.linalg.eigvals(self.A_0 + k * self.A_1)

    def loop(self) -> StateSpace:
        """L(s) with 1 + L cut where the factor acts; one axis, so A_1 has rank 1."""
        u, sizes, v = np.linalg.svd(self.A_1)
        n = len(self.A_0)
        return StateSpace(
            self.A_0, u[:, :1] * sizes[0], -v[:1], np.zeros((1, 1)),
            tuple(f"x_{k}" for k in range(n)), ("u",), ("y",),
        )  # fmt: skip

    def intervals(self) -> list[Interval]:
        """All k > 0 for which it is stable."""
        return stable_intervals(self.A_0, self.A_1)


@dataclass(frozen=True, eq=False)
class Mode:
    """The loop in one contact and one setting of the law's switches.

    system: closed loop; poles and zeros 1/s, zeros from commands to the controlled outputs;
    bandwidth rad/s per axis (nan: unstable); margins per axis, the loop cut at that axis's
    command (None: unstable); loops: those cut loops; pi_margins: cut at that axis's PI torque law,
    inside the positive feedback (empty: the law has none); gain: all commands scaled; K_p: all PI
    torque gains scaled, alpha: all shares of positive feedback scaled (None: the law has none).
    """

    name: str
    system: StateSpace
    poles: np.ndarray
    zeros: np.ndarray
    bandwidth: list[float]
    margins: list[Margins | None]
    loops: list[StateSpace]
    pi_margins: list[Margins | None]
    gain: Family
    K_p: Family | None
    alpha: Family | None

    @property
    def rightmost(self) -> float:
        return float(np.real(self.poles)[0])

    @property
    def verdict(self) -> str:
        """stable, marginal (poles on the axis) or unstable."""
        rounding = _MARGINAL * float(np.abs(self.poles).max())
        if abs(self.rightmost) <= rounding:
            return "marginal"
        return "stable" if self.rightmost < 0.0 else "unstable"


class Region(NamedTuple):
    """The Routh-Hurwitz region of the PI gains under full positive feedback; (21), (22)."""

    joints: JointSystem
    K_p: np.ndarray
    K_i: np.ndarray
    K_p_max: np.ndarray
    K_i_max: np.ndarray


class Analysis(NamedTuple):
    """Of one study: where it was linearised, its modes, its region (None: no torque loop)."""

    study: str
    theta_L: np.ndarray
    controlled: str
    modes: list[Mode]
    region: Region | None
    notes: list[str]


def analyse(study: Study, theta_L: Any = None) -> Analysis:
    """Linearise a study at rest and say what the linear loop does.

    theta_L (axes,) rad: where; None: at the final reference of a position law, at the start's
    angles under a torque law. Ripple, friction and the supply limit are left out.

    Raises: InputError for a law with discrete memory, and for angles that are no numbers.
    """
    loop, notes = linearisable(study)
    if theta_L is None:
        angles = np.asarray(operating.angles(loop), dtype=float)
    else:
        angles = per_joint("theta_L", theta_L, loop.drive.axes)
    controlled = "T_s" if loop.law.reference_unit == "Nm" else "theta_L"
    modes: list[Mode] = []
    for name, contact in operating.contacts(loop.drive).items():
        modes += _modes(loop, angles, name, contact, controlled, notes)
    if not modes:
        raise InputError("theta_L", "must be where the drive can rest", angles.tolist(), notes[-1])
    return Analysis(study.name, angles, controlled, modes, _region(loop, angles, notes), notes)


def linearisable(study: Study) -> tuple[ClosedLoop, list[str]]:
    """The study's loop without what has no slope, and what was left out, in words.

    Raises: InputError for a law with discrete memory.
    """
    law, notes = study.law, []
    if isinstance(law, Sampled):
        law = law.law
        notes.append("the law inside Sampled, continuous: no hold, no delay, true sensors")
    if isinstance(law, JointLaw) and law.discrete:
        raise InputError(
            "law", "must be continuous to be linearised", "a law with discrete memory",
            "analyse the study with a continuous source of derivatives, such as butterworth",
        )  # fmt: skip
    loop = ClosedLoop(study.drive, law, study.scenario, Exact(), study.run.dt)
    loop, left_out = operating.smooth(loop)
    if left_out:
        notes.append(f"left out, as they have no slope: {', '.join(left_out)} of the motors")
    return loop, notes


def _modes(
    loop: ClosedLoop, angles: np.ndarray, name: str, contact: tuple[int, ...], controlled: str,
    notes: list[str],
) -> list[Mode]:  # fmt: skip
    """The distinct settings of the law's switches in one contact."""
    d_L = _held(loop.drive, angles, contact)
    found: list[tuple[str, dict[str, float], Linearised]] = []
    try:
        for label, signs in operating.settings(loop):
            linear = linearise(loop, angles, contact=contact, modes=signs, d_L=d_L)
            if all(not np.allclose(linear.system.A, f.system.A, atol=0.0) for *_, f in found):
                found.append((label, signs, linear))
    except InputError as error:
        notes.append(f"{name}: no rest there ({error.rule})")
        return []
    if np.any(d_L):
        notes.append(f"{name}: the load is held by d_L = {np.round(d_L, 6).tolist()} Nm")
    at = {"contact": contact, "d_L": d_L}
    return [
        _mode(loop, angles, f"{name}, {label}" if len(found) > 1 else name, controlled, linear,
              at | {"modes": signs})
        for label, signs, linear in found
    ]  # fmt: skip


def _held(drive: Drive, angles: np.ndarray, contact: tuple[int, ...]) -> np.ndarray:
    """The torques that keep joints without contact from falling, (axes,) Nm."""
    weight = np.asarray(operating.weight(drive, tuple(angles)), dtype=float)
    return np.where(np.asarray(contact) == 0, weight, 0.0)


def _mode(
    loop: ClosedLoop, angles: np.ndarray, name: str, controlled: str, found: Linearised,
    at: dict[str, Any],
) -> Mode:  # fmt: skip
    p, system = loop.drive.axes, found.system
    into, out = _command(loop, angles, system, at)
    loops = [_cut(system, into[:, [i]], out[[i]], i) for i in range(p)]
    outputs = per_axis(controlled, p)
    stable = np.real(poles(system)).max() < 0.0
    widths = [
        frequency.bandwidth(system.channel([o], [r])) if stable else math.nan
        for o, r in zip(outputs, per_axis("reference", p), strict=True)
    ]
    plant = StateSpace(
        system.A - into @ out, into, system.C, np.zeros((len(system.outputs), p)),
        system.states, per_axis("command", p), system.outputs,
    ).channel(outputs, per_axis("command", p))  # fmt: skip
    law_states = [n for n in system.states if n.startswith("law_")]
    return Mode(
        name, system, poles(system), _drive_zeros(plant, len(law_states)), widths,
        [_margins(cut) if stable else None for cut in loops], loops,
        [_margins(own.loop()) if stable else None for own in _pi_families(loop, angles, at)],
        Family(system.A - into @ out, into @ out),
        _family(loop, angles, at, operating.gain_paths(loop.law, ("K_p",)), (1.0, 2.0)),
        _family(loop, angles, at, operating.gain_paths(loop.law, operating.ALPHAS), (0.0, 1.0)),
    )  # fmt: skip


def _drive_zeros(plant: StateSpace, own: int) -> np.ndarray:
    """Zeros of the drive: the law's states, which the open loop leaves hanging, are dropped."""
    n = len(plant.states) - own
    return zeros(replace(plant, A=plant.A[:n, :n], B=plant.B[:n], C=plant.C[:, :n],
                         states=plant.states[:n]))  # fmt: skip


def _command(
    loop: ClosedLoop, angles: np.ndarray, system: StateSpace, at: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """B of the commands into all states, and the rows with which the law makes them."""
    p = loop.drive.axes
    drive = linearise(loop.drive, angles, contact=at["contact"], d_L=at["d_L"]).system
    into = np.zeros((len(system.states), p))
    columns = [drive.inputs.index(n) for n in per_axis("command", p)]
    rows = [system.states.index(n) for n in drive.states]
    into[rows] = drive.B[:, columns]
    return into, system.C[[system.outputs.index(n) for n in per_axis("command", p)]]


def _cut(system: StateSpace, into: np.ndarray, out: np.ndarray, axis: int) -> StateSpace:
    """L(s) with the loop cut at one command: 1 + L has the closed-loop poles as zeros."""
    return StateSpace(
        system.A - into @ out, into, -out, np.zeros((1, 1)), system.states,
        (f"command[{axis}]",), (f"command[{axis}]",),
    )  # fmt: skip


def _margins(cut: StateSpace) -> Margins | None:
    try:
        return frequency.margins(cut)
    except InputError:
        return None


def _pi_families(loop: ClosedLoop, angles: np.ndarray, at: dict[str, Any]) -> list[Family]:
    """One per axis, where every axis has its K_p."""
    own = operating.gain_paths(loop.law, ("K_p",))
    if len(own) != loop.drive.axes:
        return []
    found = [_family(loop, angles, at, [path], (1.0, 2.0)) for path in own]
    return [f for f in found if f is not None]


def _family(
    loop: ClosedLoop, angles: np.ndarray, at: dict[str, Any], own: list[str],
    factors: tuple[float, float],
) -> Family | None:  # fmt: skip
    """The closed loop is affine in a gain: two linearisations give it for all factors.

    Never at K_p = 0, where no integral holds the load; so the two factors are the caller's.
    """
    if not own:
        return None
    pair = []
    for factor in factors:
        values = {path: factor * tree.get(loop.law, path) for path in own}
        changed = eqx.tree_at(lambda v: v.law, loop, tree.replace(loop.law, values))
        pair.append(linearise(changed, angles, **at).system.A)
    slope = (pair[1] - pair[0]) / (factors[1] - factors[0])
    return Family(pair[0] - factors[0] * slope, slope)


def _region(loop: ClosedLoop, angles: np.ndarray, notes: list[str]) -> Region | None:
    """Of a torque loop with DC motors and stiff joints; a note where it is none."""
    gains = [
        [tree.get(loop.law, path) for path in operating.gain_paths(loop.law, (name,))]
        for name in ("K_p", "K_i")
    ]
    if loop.law.reference_unit != "Nm" or any(len(g) != loop.drive.axes for g in gains):
        return None
    try:
        joints = joint_system(loop.drive, angles)
    except InputError as error:
        notes.append(f"no Routh-Hurwitz region: {error.field} {error.rule}")
        return None
    K_p, K_i = (np.asarray(g, dtype=float) for g in gains)
    region = Region(joints, K_p, K_i, routh.K_p_max(joints), routh.K_i_max(joints, K_p))
    for axis in np.flatnonzero((K_i >= region.K_i_max) | (K_p >= region.K_p_max)):
        notes.append(
            f"axis {axis}: K_p = {K_p[axis]:g} V/Nm, K_i = {K_i[axis]:g} 1/s are outside the "
            f"stability region: K_p < {region.K_p_max[axis]:.5g} (21), K_i < "
            f"{max(region.K_i_max[axis], 0.0):.5g} at this K_p (22)"
        )
    return region
