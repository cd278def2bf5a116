"""Poles and margins of a closed loop as functions that JAX differentiates.

The analysis for people is in `linearise`, `stability` and `frequency`; here are the numbers that a
search needs, with derivatives with respect to every parameter of drive and law.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import tree
from jaxsim.errors import InputError
from jaxsim.law import Supervised
from jaxsim.linear import operating
from jaxsim.linear.flat import FlatLoop, signals
from jaxsim.linear.frozen import Modal, modal
from jaxsim.linear.linearise import AT_REST, contact_signs, rest
from jaxsim.linear.period import period_map
from jaxsim.loop import ClosedLoop
from jaxsim.sampled import Sampled

Cut = tuple[Any, Any]  # columns (n, cuts) into x' and rows (cuts, n), of x' = A x, A = A_0 + B C


class Modes(NamedTuple):
    """The closed loop in several modes; every array has a leading axis for them.

    A (modes, n, n) 1/s, with decoupled states put out of the way (see `_seen`); commands: the
    loop cut at each axis's command; torques: at each axis's PI torque law, inside all other
    feedback (None: the law has none). period (modes,) s: of a law that works at samples, A then
    is the map over one period (see `jaxsim.linear.period`); None: x' = A x.
    """

    A: Any
    commands: Cut
    torques: Cut | None
    period: Any = None


def in_contact(loop: ClosedLoop) -> Modes:
    """All modes in which every joint is in contact, in every setting of the law's switches."""
    found = operating.contacts(loop.drive)
    return _modes(loop, [c for c in found.values() if 0 not in c])


def in_the_gap(loop: ClosedLoop) -> Modes:
    """All modes in which a joint is in its gap.

    Raises: InputError for a drive without play.
    """
    found = [c for c in operating.contacts(loop.drive).values() if 0 in c]
    if not found:
        raise InputError(
            "drive.transmission", "must have play, to have poles in the gap", "none",
            "leave this limit out",
        )  # fmt: skip
    return _modes(loop, found)


def _modes(loop: ClosedLoop, contacts: list[tuple[int, ...]]) -> Modes:
    sampled = loop.law if isinstance(loop.law, Sampled) else None
    loop = operating.smooth(_linear(loop))[0]
    flat = FlatLoop.of(loop)
    angles = jnp.stack([jnp.asarray(a, flat.start.dtype) for a in operating.angles(loop)])
    weight = operating.weight(flat.loop.drive, tuple(angles))
    pairs = [(c, s.signs) for c in contacts for s in operating.settings(loop)]
    signs = np.array([_signs(loop, *pair) for pair in pairs])
    opened = np.array([contact for contact, _ in pairs]) == 0

    def one(own: Any, is_open: Any) -> Modes:
        d_L = jnp.where(is_open, weight, 0.0)
        return _mode(flat, tuple(own), angles, d_L, is_open, sampled)

    return jax.vmap(one)(jnp.asarray(signs, flat.start.dtype), jnp.asarray(opened))


def _signs(loop: ClosedLoop, contact: tuple[int, ...], law: dict[str, float]) -> list[float]:
    """One sign per surface; those of motors that are left stay at zero, undecided."""
    joints = loop.drive.transmission
    with jax.ensure_compile_time_eval():  # signs are numbers, whatever is traced
        own = [
            s
            for t, c in zip(joints, contact, strict=True)
            for s in contact_signs(t, c, (0.0,) * len(t.surfaces))
        ]
    names = loop.surface_names()[len(own) :]
    return [*own, *(law.get(name, 0.0) for name in names)]


def _linear(loop: ClosedLoop) -> ClosedLoop:
    """The loop with the law that a sampled one runs.

    Raises: InputError for a law that is no linear filter in each of its settings.
    """
    law = loop.law.law if isinstance(loop.law, Sampled) else loop.law
    if isinstance(law, Supervised) or law.discrete:
        raise InputError(
            "law", "must be made of filters to have poles and margins", "one with other memory",
            "limit small_start_cycle_rad, which runs the law as it is",
        )  # fmt: skip
    return ClosedLoop(loop.drive, law, loop.scenario, loop.deadzone, loop.dt)


def _mode(
    flat: FlatLoop, signs: tuple[Any, ...], theta_L: Any, d_L: Any, is_open: Any,
    sampled: Sampled | None,
) -> Modes:  # fmt: skip
    z, miss = rest(flat, signs, theta_L, d_L)
    z = jnp.where(miss <= AT_REST * (1.0 + jnp.abs(z).max()), z, jnp.nan)
    n, p = len(flat.start), flat.axes
    x, u = z[:n], jnp.concatenate([z[n:], d_L, jnp.zeros(p)])
    B = _into(flat, signs, x, d_L)
    if sampled is None:
        (A, C), torques = _with_torque_cuts(flat, signs, x, u)
        away = -jax.lax.stop_gradient(jnp.abs(A).max()) * jnp.ones(len(A))
        return Modes(_seen(flat, A, is_open, away), (B, C), torques)
    A, C = _rows(flat, signs, x, u)
    own = len(FlatLoop.of(flat.loop.drive).start)
    drive = (A - B @ C)[:own, :own], B[:own]
    found = period_map(flat, sampled, signs, x, u, drive)
    n = len(found.Phi)
    # Apart from each other and from z = 0, where others may be.
    away = _ASIDE * jnp.arange(1.0, 1.0 + n) - 1.0
    Phi = jnp.eye(n) + _seen(flat, found.Phi - jnp.eye(n), is_open, away)
    return Modes(Phi, (found.columns, found.rows), None, jnp.asarray(sampled.period))


def _rows(flat: FlatLoop, signs: tuple[Any, ...], x: Any, u: Any) -> tuple[Any, Any]:
    """A, and the rows by which the law makes the commands."""
    first = signals().index("command") * flat.axes

    def both(x: Any) -> tuple[Any, Any]:
        outputs = flat.outputs(x, u, signs)
        return flat.field(x, u, signs), outputs[first : first + flat.axes]

    return jax.jacfwd(both)(x)


def _into(flat: FlatLoop, signs: tuple[Any, ...], x: Any, d_L: Any) -> Any:
    """Columns of the commands into the states; the drive's come first among them."""
    drive, p = FlatLoop.of(flat.loop.drive), flat.axes
    n, own = len(drive.start), signs[: len(drive.loop.surfaces)]

    def rates(command: Any) -> Any:
        return drive.field(x[:n], jnp.concatenate([command, d_L, jnp.zeros(p)]), own)

    B = jax.jacfwd(rates)(jnp.zeros(p))
    return jnp.zeros((len(flat.start), p)).at[:n].set(B)


def _seen(flat: FlatLoop, A: Any, is_open: Any, away: Any) -> Any:
    """A with the poles that no law can move far in the left half plane, at `away` (n,).

    Those are positions that nothing depends on (of a load without weight under a torque law, of a
    motor in its gap) and, for a single joint in its gap, the load. They are decoupled, so that
    the other poles stay as they are.
    """
    n, states = len(A), flat.states()
    positions = [k for k, s in enumerate(states) if s.startswith(("theta_L", "theta_B"))]
    for k in positions:
        A = A.at[k, k].set(jnp.where(jnp.any(A[:, k] != 0.0), A[k, k], away[k]))
    if flat.axes > 1:
        return A
    load = [states.index("theta_L"), states.index("omega_L")]
    free = jnp.where(is_open[0], 1.0, 0.0) * jnp.zeros(n).at[jnp.array(load)].set(1.0)
    return jnp.where(free[:, None] > 0.0, jnp.diag(away), A)


def _with_torque_cuts(
    flat: FlatLoop, signs: tuple[Any, ...], x: Any, u: Any
) -> tuple[tuple[Any, Any], Cut | None]:
    """A and the rows of the commands, and the loop cut at each K_p.

    A is affine in every K_p: dA/dlog K_p is a column times a row.
    """
    loop = flat.loop
    paths = operating.gain_paths(loop.law, ("K_p",))
    if len(paths) != flat.axes:
        return _rows(flat, signs, x, u), None

    def scaled(factors: Any) -> tuple[Any, Any]:
        own = {path: factors[i] * tree.get(loop.law, path) for i, path in enumerate(paths)}
        law = tree.replace(loop.law, own)
        changed = ClosedLoop(loop.drive, law, loop.scenario, loop.deadzone, loop.dt)
        found = _rows(FlatLoop(changed, flat.rest), signs, x, u)
        return found[0], found

    slopes, found = jax.jacfwd(scaled, has_aux=True)(jnp.ones(flat.axes))
    columns, rows = jax.vmap(_factors, in_axes=2)(slopes)
    return found, (columns.T, rows)


def _factors(A: Any) -> tuple[Any, Any]:
    """A column and a row whose product is a matrix of rank 1, with their derivatives."""
    frozen = jax.lax.stop_gradient(A)
    row = frozen[jnp.argmax(jnp.linalg.norm(frozen, axis=1))]
    row = row / jnp.linalg.norm(row)
    column = frozen @ row
    return A @ row, (column @ A) / (column @ A @ row)


def rightmost(modes: Modes) -> Any:
    """The largest real part of the poles of all modes, 1/s; of samples log|z|/period."""
    return jnp.real(_poles(modes)).max()


def damping(modes: Modes) -> Any:
    """The least damping ratio -Re s/|s| of the poles of all modes, 1; 1 where all are real."""
    poles = _poles(modes)
    return (-jnp.real(poles) / jnp.abs(poles)).min()


def _poles(modes: Modes) -> Any:
    """With derivatives ds = w dA v, w the rows of the inverse of the eigenvectors v."""

    def one(A: Any, period: Any) -> Any:
        found = modal(A)
        change = A - jax.lax.stop_gradient(A)
        moved = found.poles + jnp.einsum("ki,ij,jk->k", found.inverse, change, found.V)
        return moved if period is None else _continuous(found.poles, moved, period)

    return jax.vmap(one)(modes.A, modes.period)


def _continuous(poles: Any, moved: Any, period: Any) -> Any:
    """s = log(z)/period; what dies out within a sample or two (z near 0) needs no derivative."""
    gone = jnp.abs(poles) < _GONE
    return jnp.log(jnp.where(gone, _GONE, moved)) / period


_ACROSS = (-3.0, -1.0, -0.3, 0.3, 1.0, 3.0)  # a resonance, in half-widths
_PER_MODE = 256  # frequencies between the slowest and the fastest pole, and beyond
_BISECTIONS = 48


class Loop(NamedTuple):
    """L(s) of a loop cut in one place, 1 + L closing it to x' = A x; frequencies to look at.

    modal: of A; gains: (row V)_k (V^-1 column)_k. period: of `Modes`.
    """

    A: Any
    column: Any
    row: Any
    modal: Modal
    gains: Any
    omega: Any
    period: Any = None

    def point(self, omega: Any) -> Any:
        """Where L is looked at: s = j omega, or z = exp(j omega period)."""
        return 1j * omega if self.period is None else jnp.exp(1j * omega * self.period)

    def value(self, omega: Any) -> Any:
        """L(j omega) at one frequency, rad/s, without derivatives by A, column and row.

        By the closed loop: M = row (j omega - A)^-1 column is -L/(1 + L).
        """
        M = (self.gains / (self.point(omega) - self.modal.poles)).sum()
        return -M / (1.0 + M)

    def differentiable(self, omega: Any) -> Any:
        """The same with its first derivatives: dM = l dA r + drow r + l dcolumn, all at omega."""
        V, inverse = self.modal.V, self.modal.inverse
        frozen = jax.lax.stop_gradient((self.A, self.column, self.row))
        share = 1.0 / (self.point(omega) - self.modal.poles)
        right, left = V @ (share * (inverse @ frozen[1])), ((frozen[2] @ V) * share) @ inverse
        dA, dcolumn, drow = (
            v - f for v, f in zip((self.A, self.column, self.row), frozen, strict=True)
        )
        right_0, left_0 = jax.lax.stop_gradient((right, left))
        M = (self.gains * share).sum() + left_0 @ dA @ right_0 + drow @ right_0 + left_0 @ dcolumn
        return -M / (1.0 + M)


def cut_loops(A: Any, cut: Cut, period: Any) -> Loop:
    """The loops of one mode, one per cut, along a leading axis of every array."""
    closed, (columns, rows) = modal(A), cut

    def one(column: Any, row: Any) -> Loop:
        opened = modal(A - jnp.outer(column, row)).poles
        gains = jax.lax.stop_gradient((row @ closed.V) * (closed.inverse @ column))
        omega = _frequencies(closed.poles, opened, period)
        return Loop(A, column, row, closed, gains, omega, period)

    return jax.vmap(one)(columns.T, rows)


def _frequencies(closed: Any, opened: Any, period: Any) -> Any:
    """Ascending, rad/s: evenly in the logarithm, and closely around the poles of both loops.

    Of samples up to half their rate, at which z = -1 is the last.
    """
    poles = jnp.concatenate([closed, opened])
    if period is not None:
        poles = _continuous(poles, poles, period)
    size = jnp.abs(poles)
    slowest = jnp.maximum(size[: len(closed)].min(), 1e-9 * size.max())
    width = -jnp.real(poles) / jnp.maximum(size, slowest)
    near = size[:, None] * jnp.abs(1.0 + width[:, None] * jnp.array([_ACROSS]))
    fastest = 30.0 * size.max() if period is None else jnp.pi / period
    evenly = jnp.geomspace(0.1 * slowest, fastest, _PER_MODE)
    # The first one stands for omega = 0, where a real pole may cross.
    every = jnp.concatenate([1e-4 * slowest[None], evenly, near.ravel()])
    return jnp.sort(every.clip(1e-4 * slowest, None if period is None else fastest))


def _crossings(values: Any, height: Any) -> tuple[Any, Any]:
    """Between which neighbours a height changes sign, and the share of the way to there."""
    change = height[1:] - height[:-1]
    share = -height[:-1] / jnp.where(change == 0.0, 1.0, change)
    crosses = (height[:-1] > 0.0) != (height[1:] > 0.0)
    return crosses, values[:-1] + share * (values[1:] - values[:-1])


def _polished(loop: Loop, height: Callable[[Any], Any], at: Any) -> Any:
    """L where height(L) = 0, after the frequency number `at`, with its derivatives."""
    low, high = loop.omega[at], loop.omega[at + 1]
    sign = jnp.sign(height(loop.value(low)))

    def halve(_: Any, ends: Any) -> Any:
        low, high = ends
        middle = jnp.sqrt(low * high)
        same = jnp.sign(height(loop.value(middle))) == sign
        return jnp.where(same, middle, low), jnp.where(same, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high))
    omega = jax.lax.stop_gradient(jnp.sqrt(low * high))
    slope = jax.jvp(lambda w: height(loop.value(w)), (omega,), (jnp.ones_like(omega),))[1]
    # One step of Newton's method moves the crossing with the parameters.
    moved = omega - height(loop.differentiable(omega)) / slope
    return loop.differentiable(moved)


def gain_margins(loop: Loop, stable: Any) -> Any:
    """(2,) dB by which the gain may rise, and fall, until poles lie on the imaginary axis.

    At most `MOST_DB`; negative where the closed loop is unstable: dB to the nearest such gain.
    """
    values = jax.vmap(loop.value)(loop.omega)
    crosses, between = _crossings(values, jnp.imag(values))
    crosses = crosses & (jnp.real(between) < 0.0)
    distance = -_dB(jnp.where(crosses, -jnp.real(between), 1.0))
    ends = jnp.array([0] if loop.period is None else [0, -1])
    at_ends = jax.vmap(loop.differentiable)(loop.omega[ends])
    real = (jnp.real(at_ends) < 0.0) & (jnp.abs(jnp.imag(at_ends)) < _REAL * jnp.abs(at_ends))
    still = jnp.where(real, -_dB(jnp.maximum(-jnp.real(at_ends), _TINY)), MOST_DB)

    def least(sign: Any) -> Any:
        """Up with sign 1, down with -1; no distance counts as one down."""
        usable = crosses & (sign * distance >= 0.0) & ((distance != 0.0) | (sign < 0.0))
        at = jnp.argmin(jnp.where(usable, jnp.abs(distance), jnp.inf))
        found = -_dB(jnp.maximum(-jnp.real(_polished(loop, jnp.imag, at)), _TINY))
        found = jnp.where(usable.any(), sign * found, MOST_DB)
        return jnp.minimum(found, jnp.where(sign * still > 0.0, sign * still, MOST_DB).min())

    margins = jax.vmap(least)(jnp.array([1.0, -1.0]))
    told = jnp.where(stable, margins, -jnp.abs(margins).min())
    return told.clip(-MOST_DB, MOST_DB)


def phase_margin(loop: Loop, stable: Any) -> Any:
    """deg to the nearest |L| = 1 at L = -1, at most 180; negative where the loop is unstable."""
    values = jax.vmap(loop.value)(loop.omega)
    crosses, between = _crossings(values, jnp.abs(values) - 1.0)
    away = jnp.where(crosses, jnp.abs(jnp.angle(-between)), jnp.inf)
    found = _polished(loop, lambda L: jnp.abs(L) - 1.0, jnp.argmin(away))
    margin = jnp.where(crosses.any(), jnp.degrees(jnp.abs(jnp.angle(-found))), 180.0)
    return jnp.where(stable, margin, -margin)


MOST_DB = 60.0
_TINY = 1e-9
_GONE = 1e-12  # of a sampled loop: |z|
_ASIDE = 1e-3  # of a sampled loop: z of what is not seen, times its number among the states
_REAL = 1e-2  # of |L| where omega stands for 0: without an integrator its phase is 1e-4 there


def _dB(factor: Any) -> Any:
    return 20.0 * jnp.log10(factor)
