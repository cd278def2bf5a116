"""Piecewise affine form of one-axis drives and closed loops; 2018 paper, section II.B.

The matrices are derivatives of the engine's own field in each carried mode, exact because the
field is affine there; nothing is written down a second time.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import linprog

from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.linear.flat import FlatLoop
from jaxsim.linear.state_space import by_real_part
from jaxsim.loop import ClosedLoop, When
from jaxsim.scenario import Scenario

Signs = tuple[int, ...]
Array = np.ndarray

_PAPER = ("omega_L", "omega_B", "theta_L", "theta_B")
_OMEGA_B, _THETA_B = 1, 3
# Two Jacobians of an affine map differ by rounding only, 1e-15 of its largest entry.
_SAME = 1e-9
# A cell thinner than this share of the size of the gap has no interior: LP solvers work to 1e-7.
_INTERIOR = 1e-6


@dataclass(frozen=True, eq=False)
class Cell:
    """x' = A x + a + B u where G x + g >= 0; (6)-(8).

    name, mode: e.g. "contact+ damped, omega_B >= 0, omega_L < 0" and "contact+ damped"; signs:
    the carried signs of all surfaces. A (n, n), a (n,); G (k, n), g (k,) without redundant rows.

    F (m, n), f (m,): F x + f is the same on both sides of every boundary. Row 0 is theta_B limited
    to the play, as (11), (15), (18); one more for each other surface, max(0, its guard). With a
    rank of m at most, and 0 or 1 in row 0 alone, F carries no Lyapunov argument by itself, as the
    paper's does not; below the identity (Johansson and Rantzer 1998) it has full rank.
    """

    name: str
    mode: str
    signs: Signs
    A: Array
    a: Array
    G: Array
    g: Array
    F: Array
    f: Array


@dataclass(frozen=True, eq=False)
class PiecewiseAffine:
    """Cells of the state space, each with its affine field; inputs act alike in all, (6).

    states: names of x, paper's first (omega_L, omega_B, theta_L, theta_B; rad and rad/s), then
    the states of motor, transmission and law in their own order. inputs: names of u, B (n, 2).
    surfaces: names; their guard values are H x + h.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    surfaces: tuple[str, ...]
    cells: tuple[Cell, ...]
    B: Array
    H: Array
    h: Array
    _owners: Mapping[Signs, int]

    def locate(self, x: Array) -> int:
        """The index of the cell that holds x (n,), as the engine decides on boundaries.

        Contact includes |theta_B| = half_gap (5); omega_B omega_L = 0 counts as damped (23).
        Raises: InputError where x is not finite or has another length.
        """
        x = np.asarray(x, dtype=np.float64)
        if x.shape != (len(self.states),) or not np.all(np.isfinite(x)):
            rule = f"must be {len(self.states)} finite numbers"
            raise InputError("x", rule, x.tolist(), f"give {', '.join(self.states)}")
        return self._owners[tuple(int(s) for s in np.sign(self.H @ x + self.h))]

    def poles(self) -> dict[str, Array]:
        """Eigenvalues of A, 1/s, rightmost first, by mode; by cell where a mode has several A."""
        found: dict[str, Array] = {}
        for cell in self.cells:
            family = [c for c in self.cells if c.mode == cell.mode]
            alike = all(_same(c.A, cell.A) for c in family)
            found[cell.mode if alike else cell.name] = by_real_part(np.linalg.eigvals(cell.A))
        return found


def plant(drive: Drive) -> PiecewiseAffine:
    """The drive alone, u = [command, d_L]: for the bench (6)-(19), with the errata's (12).

    Raises: InputError for several axes, or a part that is not affine in each mode.
    """
    return _form(drive, None)


def closed_loop(drive: Drive, law: Any) -> PiecewiseAffine:
    """Drive and continuous law, u = [theta_Lref, d_L]: 12 cells with PD and switched damping.

    Raises: InputError for several axes, a sampled law, or a part that is not affine in each mode.
    """
    return _form(drive, law)


class _Affine(NamedTuple):
    """Values at 0 and Jacobian by (x, u) in one mode: of the field, guards, command, contact."""

    value: Array
    slope: Array


def _coordinates(flat: FlatLoop) -> Any:
    """P with engine's x = P (paper's x): [theta_L, omega_L, theta_B, omega_M, ...]."""
    P = jnp.eye(len(flat.start))
    N = flat.loop.ratios[0]
    head = [[0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1], [N, N, 0, 0]]
    return P.at[:4, :4].set(jnp.asarray(head, P.dtype))


def _everything(flat: FlatLoop, v: Any, signs: Any) -> Any:
    """Rates of x, guards, command and contact at v = (x, u) in the modes `signs`."""
    P, n, modes = _coordinates(flat), len(flat.start), tuple(signs)
    x, u = P @ v[:n], jnp.append(v[n:], 0.0)  # no torque on the motor's shaft
    now = When(v[0] * 0.0, v[0] * 0.0)
    output = flat.under(u).outputs(now, flat.unravel(x), modes, ())[0]
    rates = jnp.linalg.solve(P, flat.field(x, u, modes))
    return jnp.stack([*rates, *flat.guards(x, u, modes), output.command, output.contact])


@eqx.filter_jit
def _jacobians(flat: FlatLoop, v: Any, signs: Any) -> tuple[Any, Any]:
    def one(modes: Any) -> tuple[Any, Any]:
        return _everything(flat, v, modes), jax.jacfwd(lambda w: _everything(flat, w, modes))(v)

    return jax.vmap(one)(signs)


def _same(a: Array, b: Array) -> bool:
    """Equal to rounding; never for NaN."""
    return bool(np.all(np.abs(a - b) <= _SAME * np.max(np.abs(a), initial=1e-300)))


def _form(drive: Drive, law: Any) -> PiecewiseAffine:
    """The form under a law, or of the drive alone where law is None."""
    if drive.axes != 1:
        raise InputError("drive", "must have one axis for a PWA form", drive.axes, "take one axis")
    system = drive if law is None else ClosedLoop(drive, law, Scenario(), Exact(), dt=1e-4)
    with jax.enable_x64(True):  # float64 whatever the caller runs in
        flat = FlatLoop.of(system)
        modes = _modes(flat)
        if modes is not None:
            return _Builder(flat, modes, closed=law is not None).form()
    if law is not None:
        _form(drive, None)  # if the drive is to blame, this says so
    name, part = ("drive", drive.load) if law is None else ("law", law)
    fix = "linearise it at an operating point instead"
    raise InputError(name, "must be affine in each mode", type(part).__name__, fix)


def _modes(flat: FlatLoop) -> dict[Signs, _Affine] | None:
    """The affine maps of all combinations of signs, 0 included; None where one is not affine."""
    n, g = len(flat.start), len(flat.loop.surfaces)
    combinations = list(itertools.product((1, -1, 0), repeat=g))
    signs = jnp.asarray(combinations, flat.start.dtype).reshape(-1, g)
    generic = 0.7 + 0.3 * np.sin(np.arange(n + 2.0))
    value, slope = (np.asarray(v) for v in _jacobians(flat, jnp.zeros(n + 2), signs))
    _, elsewhere = _jacobians(flat, jnp.asarray(generic), signs)
    # Guards without a mode, sign 0, may choose by value: they serve `locate` only.
    known = [i for i, s in enumerate(combinations) if 0 not in s]
    if not all(_same(slope[i], np.asarray(elsewhere)[i]) for i in known):
        return None
    maps = zip(combinations, value, slope, strict=True)
    return {signs: _Affine(*map_) for signs, *map_ in maps}


class _Builder:
    """Cells out of the affine maps of all modes."""

    def __init__(self, flat: FlatLoop, modes: dict[Signs, _Affine], *, closed: bool) -> None:
        self.flat, self.modes, self.closed = flat, modes, closed
        self.n = n = len(flat.start)
        self.g = g = len(flat.loop.surfaces)
        first = next(iter(modes.values()))
        self.H, self.h = first.slope[n : n + g, :n], first.value[n : n + g]
        self.B = first.slope[:n, n:]

    def form(self) -> PiecewiseAffine:
        definite = [s for s in self.modes if 0 not in s]
        cells = [self._cell(s) for s in definite if self._has_interior(s)]
        cells = tuple(sorted(cells, key=lambda c: self._contact(c.signs) % 3))  # i of (5)
        self._check(tuple(self.modes[c.signs] for c in cells))
        owners = {s: self._owner(s, cells) for s in self.modes}
        reached = {s: owner for s, owner in owners.items() if owner is not None}
        command = {"Nm": "T_M", "V": "V"}[self.flat.loop.drive.command_unit]
        return PiecewiseAffine(
            states=(*_PAPER, *self.flat.states()[4:]),
            inputs=("theta_Lref" if self.closed else command, "d_L"),
            surfaces=self.flat.loop.surface_names(),
            cells=cells,
            B=self.B,
            H=self.H,
            h=self.h,
            _owners=reached,
        )

    def _check(self, modes: tuple[_Affine, ...]) -> None:
        """Cells share their boundaries and inputs, or (6)-(7) do not describe the system."""
        n, rows = self.n, slice(self.n, self.n + self.g)
        fix = "take another part"
        for mode in modes:
            partition = _same(self.H, mode.slope[rows, :n]) and _same(self.h, mode.value[rows])
            if self.g and not (partition and np.all(mode.slope[rows, n:] == 0.0)):
                rule = "surfaces must depend on the state only, for cells to partition its space"
                raise InputError("drive or law", rule, self.flat.loop.surface_names(), fix)
            if not _same(self.B, mode.slope[:n, n:]):
                raise InputError("law", "must let inputs act alike in all modes (6)", "B_i", fix)

    def _guards(self, signs: Signs) -> tuple[Array, Array]:
        # + 0.0 makes -0.0 a plain zero.
        return np.asarray(signs)[:, None] * self.H + 0.0, np.asarray(signs) * self.h + 0.0

    def _has_interior(self, signs: Signs) -> bool:
        """Whether a ball of some size fits: max r with G x + g >= r |G|."""
        G, g = self._guards(signs)
        if not self.g:
            return True
        G, g = _scaled(G, g)
        result = linprog(
            np.r_[np.zeros(self.n), -1.0],
            A_ub=np.c_[-G, np.ones(self.g)],
            b_ub=g,
            bounds=[(None, None)] * self.n + [(None, 1.0)],
        )
        return result.status == 0 and -result.fun > _INTERIOR

    def _cell(self, signs: Signs) -> Cell:
        n, (value, slope) = self.n, self.modes[signs]
        G, g = _irredundant(*self._guards(signs))
        F, f = self._continuity(signs)
        mode = self._mode(signs)
        return Cell(
            name=", ".join((mode, *self._signed(signs))),
            mode=mode,
            signs=signs,
            A=slope[:n, :n],
            a=value[:n],
            G=G,
            g=g,
            F=F,
            f=f,
        )

    def _contact(self, signs: Signs) -> int:
        return round(float(self.modes[signs].value[-1]))

    def _mode(self, signs: Signs) -> str:
        contact = {0: "gap", 1: "contact+", -1: "contact-"}[self._contact(signs)]
        gain = self.modes[signs].slope[-2, _OMEGA_B]
        damping = "undamped" if gain == 0.0 else "damped" if gain < 0.0 else "driven"
        return f"{contact} {damping}" if self.closed else contact

    @property
    def _walls(self) -> list[int]:
        """The surfaces of the play: those of the transmission that are angles."""
        own = self.flat.loop.drive.transmission[0].surfaces
        return [k for k, surface in enumerate(own) if surface.unit == "rad"]

    @property
    def _others(self) -> list[int]:
        return [k for k in range(self.g) if k not in self._walls]

    def _signed(self, signs: Signs) -> list[str]:
        names = self.flat.loop.surface_names()
        return [f"{names[k]} {'>=' if signs[k] > 0 else '<'} 0" for k in self._others]

    def _continuity(self, signs: Signs) -> tuple[Array, Array]:
        """theta_B less what is beyond the walls; max(0, guard) of each other surface."""
        on = np.asarray(signs) > 0
        beyond, beyond_0 = on[:, None] * self.H, on * self.h
        share = np.where([k in self._walls for k in range(self.g)], self.H[:, _THETA_B], 0.0)
        play = np.eye(self.n)[_THETA_B] - share @ beyond
        F = np.vstack([play, beyond[self._others]])
        return F, np.r_[-share @ beyond_0, beyond_0[self._others]]

    def _owner(self, signs: Signs, cells: tuple[Cell, ...]) -> int | None:
        """Which cell holds the points with these signs, 0 on a surface.

        The one with the field that the engine has there; contact goes before play.
        """
        here = [i for i, c in enumerate(cells) if _agree(signs, c.signs)]
        slope, value, n = self.modes[signs].slope, self.modes[signs].value, self.n

        def rank(i: int) -> tuple[bool, int]:
            alike = _same(cells[i].A, slope[:n, :n]) and _same(cells[i].a, value[:n])
            return not alike, -sum(cells[i].signs)

        return min(here, key=rank) if here else None


def _agree(signs: Signs, cell: Signs) -> bool:
    return all(s in (0, c) for s, c in zip(signs, cell, strict=True))


def _scaled(G: Array, g: Array) -> tuple[Array, Array]:
    """Rows of unit length, and x in units of the largest offset, as LP tolerances are absolute."""
    length = np.linalg.norm(G, axis=1)
    g = g / length
    return G / length[:, None], g / max(np.max(np.abs(g)), 1e-300)


def _irredundant(G: Array, g: Array) -> tuple[Array, Array]:
    """Leave out the rows that the others imply: their minimum over the others is not negative."""
    if not len(G):
        return G, g
    keep = list(range(len(G)))
    unit, offset = _scaled(G, g)
    for k in range(len(G)):
        others = [i for i in keep if i != k]
        rows = [*others, k]  # row k itself, moved out by 1, so that the minimum is finite
        bound = offset[rows] + np.r_[np.zeros(len(others)), 1.0]
        free = [(None, None)] * G.shape[1]
        result = linprog(unit[k], A_ub=-unit[rows], b_ub=bound, bounds=free)
        if result.status == 0 and result.fun + offset[k] > -_INTERIOR:
            keep = others
    return G[keep], g[keep]
