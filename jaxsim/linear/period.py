"""A sampled loop over one period, exactly: held commands, delay, Tustin's rule, differences.

Between samples the drive in one contact mode is linear, so that its motion under a held command is
a matrix exponential; the law is affine in its state, so that `Sampled` advances it by a matrix,
too. The eigenvalues z of both together say what the loop does: stable where all |z| < 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxsim.errors import InputError
from jaxsim.hybrid import Exact, switch_all
from jaxsim.law import Measured, share
from jaxsim.linear.flat import FlatLoop, signals
from jaxsim.loop import ClosedLoop
from jaxsim.sampled import (
    Differences,
    Encoders,
    Noisy,
    Sampled,
    Sensors,
    TrueSpeeds,
    solve_unrolled,
)

# exp(M) = exp(M/2^n)^(2^n), by a power series of so many terms: for M up to a size of thousands.
# Not SciPy's: its LAPACK calls, made in a batch, can hang (see `frozen`).
_HALVINGS, _TERMS = 12, 14
# What is remembered for a sample leaves so much behind, the next such value twice as much, and so
# on: without it a law that is not used in a mode has several poles at exactly z = 0 with one
# eigenvector, and no derivatives. It moves log|z| of the others by no more than this.
_FADE = 1e-9


class Plant(NamedTuple):
    """x' = A x + B command, y = C x: all readings of all axes, axis by axis."""

    A: Any
    B: Any
    C: Any


class LawMaps(NamedTuple):
    """s' = F s + G y, command = H s + J y."""

    F: Any
    G: Any
    H: Any
    J: Any


class PeriodMap(NamedTuple):
    """X+ = Phi X, cut at the commands: Phi = Phi_0 + columns rows."""

    Phi: Any
    columns: Any
    rows: Any


def linear_sensors(sensors: Sensors) -> Sensors:
    """What sensors do to small motions: without noise and rounding.

    Raises: InputError for sensors of another kind.
    """
    if isinstance(sensors, Noisy):
        return linear_sensors(sensors.sensors)
    if isinstance(sensors, Encoders):
        return Differences()
    if not isinstance(sensors, TrueSpeeds | Differences):
        raise InputError(
            "law.sensors", "must be linear to have poles and margins", type(sensors).__name__,
            "use true_speeds, differences or encoders",
        )  # fmt: skip
    return sensors


def exponential(M: Any) -> Any:
    """exp(M), differentiable both ways."""
    M = M / 2.0**_HALVINGS
    term = total = jnp.eye(len(M))
    for k in range(1, _TERMS + 1):
        term = term @ M / k
        total = total + term
    for _ in range(_HALVINGS):
        total = total @ total
    return total


def period_map(
    flat: FlatLoop, sampled: Sampled, signs: tuple[Any, ...], x: Any, u: Any, drive: tuple[Any, Any]
) -> PeriodMap:
    """The loop from just before one sample to just before the next, near rest at x.

    flat: the loop with the law inside `sampled`, continuous; drive: its A and B, of the commands
    into the states of the drive. States: the drive's, the law's, the commands under way, and what
    angles have moved in the last period, of which `Differences` makes speeds.
    """
    A, B = drive
    plant = Plant(A, B, _readings(flat, signs, x, u)[:, : len(A)])
    step, size = _stepper(plant, _law_maps(flat, signs, x, u), sampled, flat.loop)
    still = jnp.zeros(size), jnp.zeros(flat.axes)
    (Phi, columns), (rows, _) = jax.jacfwd(step, argnums=(0, 1))(*still)
    return PeriodMap(Phi, columns, rows)


def _order(axes: int) -> Any:
    """Where the readings stand among the outputs, axis by axis."""
    names = signals()
    return jnp.array([names.index(n) * axes + i for i in range(axes) for n in Measured._fields])


def _readings(flat: FlatLoop, signs: tuple[Any, ...], x: Any, u: Any) -> Any:
    """Slopes of all readings by all states."""
    return jax.jacfwd(lambda v: flat.outputs(v, u, signs)[_order(flat.axes)])(x)


def _law_maps(flat: FlatLoop, signs: tuple[Any, ...], x: Any, u: Any) -> LawMaps:
    law, p = flat.loop.law, flat.axes
    state, unravel = ravel_pytree(flat.unravel(x).law)
    own = share(signs[len(signs) - sum(map(len, law.surfaces)) :], law.surfaces)

    def both(s: Any, y: Any) -> tuple[Any, Any]:
        now, ys = unravel(s), tuple(Measured(*row) for row in y.reshape(p, -1))
        switches = switch_all(Exact(), law.surfaces, law.guards(now, ys), own)
        rates = ravel_pytree(law.field(now, ys, switches))[0]
        return rates, jnp.stack(law.command(now, ys, switches))

    read = flat.outputs(x, u, signs)[_order(p)]
    (F, G), (H, J) = jax.jacfwd(both, argnums=(0, 1))(state, read)
    return LawMaps(F, G, H, J)


def _held(plant: Plant, duration: float) -> tuple[Any, Any]:
    """x after a time under a held command: Phi x + Gamma command."""
    n, p = plant.B.shape
    grown = exponential(duration * jnp.block([[plant.A, plant.B], [jnp.zeros((p, n + p))]]))
    return grown[:n, :n], grown[:n, n:]


def _inverse(M: Any) -> Any:
    rows = [list(row) for row in M]
    columns = [solve_unrolled(rows, list(unit)) for unit in jnp.eye(len(rows))]
    return jnp.stack([jnp.stack(c) for c in columns], axis=1) if columns else M


def _stepper(plant: Plant, law: LawMaps, sampled: Sampled, loop: ClosedLoop) -> tuple[Any, int]:
    """The map (X, what is added to the command) -> (X+, command), and the size of X."""
    T, axes = sampled.period, loop.drive.axes
    period, delay = sampled.ticks(loop.dt)
    waits, late = divmod(delay, period)
    before, after = _held(plant, late * loop.dt), _held(plant, T - late * loop.dt)
    sensors = linear_sensors(sampled.sensors)
    sizes = len(plant.A), len(law.F), (waits + (late > 0)) * axes, 2 * axes
    if isinstance(sensors, TrueSpeeds):
        sizes = (*sizes[:3], 0)
    half, ends = 0.5 * T, np.cumsum(sizes)[:-1].tolist()
    solved = _inverse(jnp.eye(sizes[1]) - half * law.F)
    fade = _FADE * jnp.arange(1.0, 1.0 + sum(sizes[2:]))

    def step(X: Any, extra: Any) -> tuple[Any, Any]:
        x, v, under_way, moved = jnp.split(X, ends)
        read = _read(sensors, plant.C @ x, moved, loop.ratios, T)
        s = solved @ (v + half * law.G @ read)
        command = law.H @ s + law.J @ read + extra
        queue = [command, *jnp.split(under_way, waits + (late > 0))] if sizes[2] else [command]
        y = x if not late else before[0] @ x + before[1] @ queue[waits + 1]
        y = after[0] @ y + after[1] @ queue[waits]
        v = s + half * (law.F @ s + law.G @ read)
        now = (_angles(plant.C @ y) - _angles(plant.C @ x))[: sizes[3]]
        memory = jnp.concatenate([*queue[: len(queue) - 1], now])
        return jnp.concatenate([y, v, memory + fade * jnp.append(under_way, moved)]), command

    return step, sum(sizes)


def _angles(readings: Any) -> Any:
    """theta_L and theta_M of every axis."""
    names, width = Measured._fields, len(Measured._fields)
    own = readings.reshape(-1, width)[:, [names.index("theta_L"), names.index("theta_M")]]
    return own.ravel()


def _read(sensors: Sensors, readings: Any, moved: Any, ratios: Any, period: float) -> Any:
    """What the law sees; moved: by how much the angles have changed since the last sample."""
    seen = []
    for axis, row in enumerate(readings.reshape(len(ratios), -1)):
        y = last = Measured(*row)
        if len(moved):
            back = moved[2 * axis], moved[2 * axis + 1]
            last = y._replace(theta_L=y.theta_L - back[0], theta_M=y.theta_M - back[1])
        seen += sensors.read(y, last, ratios[axis], period, jnp.zeros(()))
    return jnp.stack(seen)
