"""Linear systems from a drive or closed loop at an equilibrium, in given modes.

The physics is the drive's own field, differentiated; nothing is written down twice.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim.drive import Drive, Transmission
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import share
from jaxsim.linear.flat import FlatLoop, signals
from jaxsim.linear.frozen import pseudo_inverse
from jaxsim.linear.joints import JointSystem, per_joint, plant
from jaxsim.linear.state_space import StateSpace, per_axis
from jaxsim.loop import ClosedLoop
from jaxsim.motors.dc import DC

_STEPS = 50  # of Newton's method; 1 where the mode is affine
_TRACED_STEPS = 8  # the angles are given: what is left is affine but for products of law states
_SETTLED = 1e-12  # last Newton step, relative to 1 + |unknown|
AT_REST = 1e-8  # residual of the equilibrium, each row relative to its largest term
_RANK = 1e-11  # of the row-normed Jacobian: a direction below it is free (deflection in the gap)
_SAME = 1e-9  # entries of the paper's form and the drive's, relative to the largest in the row


@dataclass(frozen=True, eq=False)
class Linearised:
    """system: the linear system of deviations; x, reference, modes: where it was taken.

    x (n,) in the order of system.states; reference (axes,): of the closed loop, or the command
    (Nm or V) of a drive without law; modes: the carried sign of each surface, by name.
    """

    system: StateSpace
    x: np.ndarray
    reference: np.ndarray
    modes: dict[str, float]


def linearise(
    system: ClosedLoop | Drive,
    theta_L: float | np.ndarray = 0.0,
    *,
    contact: int | tuple[int, ...] | None = None,
    modes: Mapping[str, float] | None = None,
    d_L: float | np.ndarray = 0.0,
) -> Linearised:
    """x' = A x + B u, y = C x + D u of small motion about the rest at theta_L.

    theta_L (axes,) rad: the load angles held at rest; what holds them is found: command, or
    reference of the closed loop, deflections, law states. contact: +1, 0 or -1 per axis (positive
    contact, gap, negative contact), also where its rest lies outside it; None: as the guards of a
    start at rest say. modes: signs of other surfaces by the names of `ClosedLoop.surface_names`.
    d_L (axes,) Nm: steady load torques.

    Inputs of the result: reference (or command, for a drive), d_L, tau_d (Nm, motor shaft).
    Outputs: the signals of `jaxsim.loop.Outputs` but P_loss and contact. States: theta_L, omega_L,
    theta_B, omega_M and own states of motor and transmission axis by axis, then the law's.

    Raises: InputError for a sampled law, a contact that the transmission does not have, an unknown
    surface, and where nothing rests at theta_L in these modes.
    """
    with jax.enable_x64(True):  # float64 whatever the caller runs in
        flat = FlatLoop.of(system)
        p = flat.axes
        held, loads = per_joint("theta_L", theta_L, p), per_joint("d_L", d_L, p)
        signs = _modes(flat, held, loads, contact, modes or {})
        x, reference = _equilibrium(flat, held, loads, signs)
        u = np.concatenate([reference, loads, np.zeros(p)])
        A, B, C, D = (
            np.asarray(slope) for slope in local(flat, signs, jnp.asarray(x), jnp.asarray(u))[1]
        )
        states = flat.states()
    source = "command" if isinstance(system, Drive) else "reference"
    inputs = tuple(n for name in (source, "d_L", "tau_d") for n in per_axis(name, p))
    outputs = tuple(n for name in signals() for n in per_axis(name, p))
    named = zip(flat.loop.surface_names(), (float(s) for s in signs), strict=True)
    return Linearised(StateSpace(A, B, C, D, states, inputs, outputs), x, reference, dict(named))


@eqx.filter_jit
def local(flat: FlatLoop, modes: tuple[Any, ...], x: Any, u: Any) -> tuple[Any, tuple[Any, ...]]:
    """The rates at x and u, and A, B, C, D there."""

    def both(x: Any, u: Any) -> Any:
        rates = flat.field(x, u, modes)
        return (rates, flat.outputs(x, u, modes)), rates

    (of_rates, of_outputs), rates = jax.jacfwd(both, argnums=(0, 1), has_aux=True)(x, u)
    return rates, (*of_rates, *of_outputs)


def _modes(
    flat: FlatLoop,
    theta_L: np.ndarray,
    d_L: np.ndarray,
    contact: int | tuple[int, ...] | None,
    named: Mapping[str, float],
) -> tuple[Any, ...]:
    """One sign per surface: as the guards say at theta_L, but for what the caller asks."""
    transmissions, names = flat.loop.drive.transmission, flat.loop.surface_names()
    wanted = contact if isinstance(contact, tuple) else (contact,) * flat.axes
    if len(wanted) != flat.axes:
        raise InputError("contact", f"must be one per axis ({flat.axes})", contact, "a tuple")
    x = jnp.asarray(_with_load(flat, theta_L))
    u = jnp.concatenate([jnp.zeros(flat.axes), jnp.asarray(d_L), jnp.zeros(flat.axes)])
    zero = (jnp.zeros(()),) * len(names)
    seen = [float(np.sign(g)) for g in flat.guards(x, u, zero)]
    own = share(tuple(seen), [t.surfaces for t in transmissions])
    asked = [
        o if w is None else contact_signs(t, w, o)
        for t, w, o in zip(transmissions, wanted, own, strict=True)
    ]
    start = [s for group in asked for s in group]
    signs = dict(enumerate(start + seen[len(start) :]))
    for name, sign in named.items():
        if name not in names:
            raise InputError.unknown("modes", name, names)
        signs.update({i: float(np.sign(sign)) for i, n in enumerate(names) if n == name})
    return tuple(jnp.asarray(s) for s in signs.values())


def contact_signs(
    transmission: Transmission, wanted: int, seen: tuple[float, ...]
) -> tuple[float, ...]:
    """The signs of a transmission's surfaces that mean this contact, the nearest to those seen."""
    surfaces, zero = transmission.surfaces, jnp.zeros(())
    fitting = []
    for signs in itertools.product((1.0, -1.0), repeat=len(surfaces)):
        switches = tuple(
            Exact().switch(s, zero, jnp.asarray(m)) for s, m in zip(surfaces, signs, strict=True)
        )
        if float(transmission.contact(switches)) == wanted:
            both = len(signs) > 1 and signs[:2] == (1.0, 1.0)  # never in both contacts at once
            fitting += [] if both else [signs]
    if not fitting:
        raise InputError(
            "contact", f"must be one that {type(transmission).__name__} has", wanted, "+1, 0 or -1"
        )
    return max(fitting, key=lambda signs: sum(a == b for a, b in zip(signs, seen, strict=True)))


def _positions(flat: FlatLoop) -> list[int]:
    """Where the load angles stand among the states."""
    return [flat.states().index(n) for n in per_axis("theta_L", flat.axes)]


def _with_load(flat: FlatLoop, theta_L: np.ndarray) -> np.ndarray:
    """The start with these load angles."""
    x = np.array(flat.start)
    x[_positions(flat)] = theta_L
    return x


class _Newton(NamedTuple):
    """Of z = (x, reference): a step towards rest, the matrix that gave it, by how much z misses."""

    step: Any
    slope: Any
    miss: Any


@eqx.filter_jit
def _newton(flat: FlatLoop, modes: tuple[Any, ...], z: Any, theta_L: Any, d_L: Any) -> _Newton:
    """One step of Newton's method."""
    slope = jax.jacfwd(lambda v: _unrest(flat, modes, v, theta_L, d_L))(z)
    return _towards_rest(slope, _unrest(flat, modes, z, theta_L, d_L))


def _unrest(flat: FlatLoop, modes: tuple[Any, ...], z: Any, theta_L: Any, d_L: Any) -> Any:
    """What is zero at rest: the rates, and the load angles less those to be held."""
    n, p = len(flat.start), flat.axes
    u = jnp.concatenate([z[n:], d_L, jnp.zeros(p)])
    return jnp.concatenate([flat.field(z[:n], u, modes), z[jnp.array(_positions(flat))] - theta_L])


def _towards_rest(slope: Any, value: Any) -> _Newton:
    size = jnp.linalg.norm(slope, axis=1)
    scale = jnp.where(size == 0.0, 1.0, size)
    step = -pseudo_inverse(slope / scale[:, None], jnp.asarray(_RANK)) @ (value / scale)
    return _Newton(step, slope, jnp.abs(value / scale).max())


def rest(flat: FlatLoop, modes: tuple[Any, ...], theta_L: Any, d_L: Any) -> tuple[Any, Any]:
    """z = (x, reference) at rest, traced by JAX with its derivatives, and by how much it misses.

    As `linearise` finds it, in a fixed number of steps; theta_L, d_L (axes,).
    """
    frozen, held, loads = jax.lax.stop_gradient((flat, theta_L, d_L))
    start = flat.start.at[jnp.asarray(_positions(flat))].set(held)
    z = jnp.concatenate([jax.lax.stop_gradient(start), jnp.zeros(flat.axes)])

    def closer(_: Any, now: tuple[Any, Any]) -> tuple[Any, Any]:
        found = _newton(frozen, modes, now[0], held, loads)
        return now[0] + found.step, found.slope

    n = len(z)
    z, slope = jax.lax.fori_loop(0, _TRACED_STEPS, closer, (z, jnp.zeros((n, n))))
    # At rest the step is one in the residual alone: the matrix needs no derivative.
    last = _towards_rest(slope, _unrest(flat, modes, z, theta_L, d_L))
    return z + last.step, last.miss


def _equilibrium(
    flat: FlatLoop, theta_L: np.ndarray, d_L: np.ndarray, modes: tuple[Any, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """x and reference at rest: field = 0 with theta_L as given, by Newton's method.

    Directions that nothing determines (the deflection inside the gap) stay where they start.
    """
    n, p = len(flat.start), flat.axes
    z = np.concatenate([_with_load(flat, theta_L), np.zeros(p)])
    held, loads = jnp.asarray(theta_L), jnp.asarray(d_L)
    for _ in range(_STEPS):
        found = _newton(flat, modes, jnp.asarray(z), held, loads)
        step = np.asarray(found.step)
        if np.all(np.abs(step) <= _SETTLED * (1.0 + np.abs(z))):
            break
        z = z + step
    if not found.miss <= AT_REST * (1.0 + np.abs(z).max()):
        raise InputError(
            "theta_L", "must be an angle at which the drive can rest in these modes",
            theta_L.tolist(), "choose the contact that carries the load, or another angle",
        )  # fmt: skip
    return z[:n], z[n:]


def joint_system(
    drive: Drive, theta_L: float | np.ndarray = 0.0, *, contact: int | tuple[int, ...] = 1
) -> JointSystem:
    """The matrices of (2)-(5) of a drive with DC motors, at rest at theta_L and in contact.

    Read off the drive's own linearised field. Ripple, friction and supply limit are left out:
    (2) has them as the disturbance tau_d.

    Raises: InputError for a drive that (2)-(5) do not describe, naming where it differs (damping
    in the transmission, no electrical side), and what `linearise` raises.
    """
    for motor in drive.motor:
        if not isinstance(motor, DC):
            raise InputError(
                "drive.motor", "must be DC: (3) is about voltage", type(motor).__name__,
                "use linearise, whose result all but the torque loop take",
            )  # fmt: skip
    motors = tuple(
        eqx.tree_at(
            lambda m: (m.ripple, m.friction, m.supply), m, (None,) * 3, is_leaf=lambda v: v is None
        )
        for m in drive.motor
    )
    found = linearise(replace(drive, motor=motors), theta_L, contact=contact).system
    # A motor does not name its own state.
    states = tuple(n.replace("motor_0", "current") for n in found.states)
    found = replace(found, states=states)
    joints = _read(found, drive.axes)
    _compare(found, plant(joints), drive.axes)
    return joints


def _block(system: StateSpace, matrix: str, rows: str, columns: str, p: int) -> np.ndarray:
    """The (p, p) block of A, B or C from one signal to another."""
    row_names = system.outputs if matrix == "C" else system.states
    column_names = system.inputs if matrix == "B" else system.states
    own = [row_names.index(n) for n in per_axis(rows, p)]
    other = [column_names.index(n) for n in per_axis(columns, p)]
    return getattr(system, matrix)[np.ix_(own, other)]


def _read(found: StateSpace, p: int) -> JointSystem:
    """The parameters of (2)-(5) from the entries where they stand."""

    def diagonal(matrix: str, rows: str, columns: str) -> np.ndarray:
        return _block(found, matrix, rows, columns, p).diagonal().copy()

    M_L = np.linalg.inv(_block(found, "B", "omega_L", "d_L", p))
    J_m, L = 1.0 / diagonal("B", "omega_M", "tau_d"), 1.0 / diagonal("B", "current", "command")
    return JointSystem(
        L=L,
        R=-L * diagonal("A", "current", "current"),
        K_t=J_m * diagonal("A", "omega_M", "current"),
        K_w=-L * diagonal("A", "current", "omega_M"),
        J_m=J_m,
        B_m=-J_m * diagonal("A", "omega_M", "omega_M"),
        N=1.0 / diagonal("A", "theta_B", "omega_M"),
        K_H=diagonal("C", "T_s", "theta_B"),
        M_L=M_L,
        B_L=-M_L @ _block(found, "A", "omega_L", "omega_L", p),
        K_L=-M_L @ _block(found, "A", "omega_L", "theta_L", p),
    )


def _compare(found: StateSpace, paper: StateSpace, p: int) -> None:
    """All entries of the drive's A are those of the paper's form, or the drive is another."""
    names = ("theta_L", "omega_L", "theta_B", "omega_M", "current")
    for rows in names:
        blocks = [(_block(found, "A", rows, c, p), _block(paper, "A", rows, c, p)) for c in names]
        size = max(np.abs(b).max() for _, b in blocks)
        for columns, (own, form) in zip(names, blocks, strict=True):
            if np.abs(own - form).max() > _SAME * size:
                raise InputError(
                    "drive", "must have the form (2)-(5) of the 2014 paper",
                    f"d {rows}'/d {columns} = {own.tolist()} instead of {form.tolist()}",
                    "set damping D_B in the transmission to 0, or use linearise",
                )  # fmt: skip
