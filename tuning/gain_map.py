"""A plane of two gains: poles of every contact mode, and the runs of the whole grid as one batch.

That every mode is stable by itself does not make the switched loop stable, nor the other way
round; so both are shown, and neither is taken for the other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import batch, tree
from jaxsim.analysis import linearisable
from jaxsim.errors import InputError, called
from jaxsim.linear import operating, routh
from jaxsim.linear.flat import FlatLoop
from jaxsim.linear.linearise import Linearised, joint_system, linearise
from jaxsim.loop import ClosedLoop
from jaxsim.study import Study

# Ends of one sign that span more than this are spaced in the logarithm.
_WIDE = 10.0
# Without bounds in the study: from the gain over this to the gain times this.
_AROUND = 4.0
# Matrices of a batch and of a linearisation of its own differ by rounding, relative to the largest.
_SAME = 1e-9
# A pole of this size, relative to the fastest, is at 0: twin poles there, which a load without
# contact has, come out of the eigenvalues with half of the digits.
_AT_ZERO = 1e-6


# Of the runs per gain, unless told otherwise.
POINTS = 41
# Poles are found on a grid so many times finer than the runs: they cost next to nothing.
FINER = 4


class Axis(NamedTuple):
    """A gain of the law by its path, at `points` values from low to high in SI units."""

    name: str
    path: str
    unit: str
    low: float
    high: float
    points: int
    log: bool

    @property
    def values(self) -> np.ndarray:
        return self._spaced(self.points)

    @property
    def fine(self) -> np.ndarray:
        """The values of the grid of the poles; every `FINER`th is one of `values`."""
        return self._spaced(FINER * (self.points - 1) + 1)

    def _spaced(self, count: int) -> np.ndarray:
        return (np.geomspace if self.log else np.linspace)(self.low, self.high, count)


class Mode(NamedTuple):
    """Real part of the rightmost pole, 1/s, on the fine grid, in one contact and switch setting.

    Poles at 0 that no gain moves, as those of a load without contact, do not count.
    """

    name: str
    rightmost: np.ndarray


class Edge(NamedTuple):
    """The Routh-Hurwitz bound (22) of a torque loop: K_i(K_p) of one axis, points (n,) each."""

    axis: int
    K_p: np.ndarray
    K_i: np.ndarray


class GainMap(NamedTuple):
    """Metrics and modes over a plane: arrays (rows, columns), y over x.

    metrics, status: of the runs at `values` of the axes. modes: at `fine` ones; empty
    where the law cannot be linearised; notes say why.
    """

    x: Axis
    y: Axis
    metrics: dict[str, np.ndarray]
    status: np.ndarray
    modes: tuple[Mode, ...]
    edges: tuple[Edge, ...]
    notes: tuple[str, ...]

    @property
    def stable(self) -> np.ndarray:
        """Where every mode is stable, on the fine grid."""
        return np.all([m.rightmost < 0.0 for m in self.modes], axis=0)


def axis_of(
    study: Study, option: str, name: str, bounds: tuple[float, float] | None, points: int
) -> Axis:
    """A gain over a range: the one given, else its bounds in [tune.free], else around its value.

    Raises: InputError for an unknown gain, one that is no single number, and for an empty range.
    """
    with called(option):
        path = tree.resolve(study.law, name)
    value, unit = tree.get(study.law, path), tree.unit(study.law, path)
    if np.ndim(value):
        raise InputError(option, "must name a single number", np.shape(value), "name another")
    low, high = bounds or _bounds(study, name, float(value), option)
    if not low < high:
        raise InputError(f"{option}-range", "must be lower < upper", [low, high], "swap them")
    log = low * high > 0.0 and max(low / high, high / low) >= _WIDE
    return Axis(name.rpartition(".")[2], path, unit, low, high, points, log)


def _bounds(study: Study, name: str, value: float, option: str) -> tuple[float, float]:
    if study.objective is not None and study.section("tune"):
        from tuning.spec import read_spec

        path = tree.resolve(study.law, name)
        for f in read_spec(study).free:
            for tie in f.ties:
                if tie.path == path:
                    low, high = sorted(map(tie.value, (f.lower, f.upper)))
                    return low, high
    if value == 0.0:
        fix = f"e.g. {option}-range -1 1"
        raise InputError(f"{option}-range", "must be given for a gain that is 0", 0.0, fix)
    low, high = sorted((value / _AROUND, value * _AROUND))
    return low, high


def usual(study: Study) -> tuple[str, ...]:
    """What is mapped unless told otherwise: the objective's metrics and the limit cycle."""
    wanted = study.objective.metrics() if study.objective else ("largest_torque_Nm",)
    return tuple(dict.fromkeys([*wanted, "limit_cycle_rad"]))


def survey(study: Study, x: Axis, y: Axis, metrics: tuple[str, ...]) -> GainMap:
    """Run and linearise the study's loop over the plane of two gains."""
    values, status = _runs(study, x, y, _plane(x.values, y.values), metrics)
    shape = (y.points, x.points)
    grids = {name: v.reshape(shape) for name, v in values.items()}
    return GainMap(x, y, grids, status.reshape(shape), *poles(study, x, y))


def poles(
    study: Study, x: Axis, y: Axis
) -> tuple[tuple[Mode, ...], tuple[Edge, ...], tuple[str, ...]]:
    """Modes, edges and notes of a plane; no modes where the law cannot be linearised."""
    try:
        loop, notes = linearisable(study)
    except InputError as error:
        return (), (), (f"no poles: {error.field} {error.rule} ({error.value})",)
    modes = _modes(loop, x, y, notes)
    return modes, _edges(loop, x, y), tuple(notes)


def _plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """All points (rows*columns, 2), row by row."""
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _runs(
    study: Study, x: Axis, y: Axis, plane: np.ndarray, metrics: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """All points as one batch; of several axes the value of largest size."""
    laws = batch.spread(study.law, **{x.path: plane[:, 0], y.path: plane[:, 1]})
    run = study.measure(metrics, law=laws)
    status = np.asarray(run.status)
    values = {}
    for name, found in run.metrics.items():
        own = np.asarray(found, float).reshape(len(plane), -1)
        pick = np.argmax(np.abs(np.nan_to_num(own)), axis=1)
        values[name] = np.where(status == 0, own[np.arange(len(plane)), pick], np.nan)
    return values, status


def _modes(loop: ClosedLoop, x: Axis, y: Axis, notes: list[str]) -> tuple[Mode, ...]:
    """The distinct ones: settings that give the same poles everywhere are one."""
    theta_L = operating.angles(loop)
    weight = np.asarray(operating.weight(loop.drive, theta_L), float)
    found: dict[str, np.ndarray] = {}
    for contact, signs in operating.contacts(loop.drive).items():
        at = {"contact": signs, "d_L": np.where(np.asarray(signs) == 0, weight, 0.0)}
        for label, own in operating.settings(loop):
            try:
                A = _matrices(loop, x, y, np.asarray(theta_L, float), at | {"modes": own})
            except InputError as error:
                notes.append(f"{contact}: no rest there ({error.rule})")
                break
            if all(not np.allclose(A, other, atol=0.0) for other in found.values()):
                found[f"{contact} {label}".rstrip()] = A
    shape = (len(y.fine), len(x.fine))
    return tuple(Mode(name, _rightmost(A).reshape(shape)) for name, A in found.items())


def _matrices(
    loop: ClosedLoop, x: Axis, y: Axis, theta_L: np.ndarray, at: dict[str, Any]
) -> np.ndarray:
    """The closed loop's A at every point of the fine grid (points, n, n).

    At the rest of the study's own gains, in one batch: a held load rests where it rests, gains
    move only the reference that holds it there. Checked at the corners; where a law has it
    otherwise, every point is linearised by itself (15 ms each).
    """
    plane = _plane(x.fine, y.fine)
    here = linearise(loop, theta_L, **at)
    whole = _batched(loop, x, y, plane, here, at["d_L"])
    for k in (0, len(x.fine) - 1, len(plane) - len(x.fine), len(plane) - 1):
        own = linearise(_with(loop, x, y, plane[k]), theta_L, **at).system.A
        if not np.allclose(own, whole[k], rtol=0.0, atol=_SAME * np.abs(own).max()):
            laws = (_with(loop, x, y, p) for p in plane)
            return np.array([linearise(changed, theta_L, **at).system.A for changed in laws])
    return whole


def _batched(
    loop: ClosedLoop, x: Axis, y: Axis, plane: np.ndarray, here: Linearised, d_L: np.ndarray
) -> np.ndarray:
    with jax.enable_x64(True):
        flat, rest = FlatLoop.of(loop), jnp.asarray(here.x)
        u = jnp.asarray(np.concatenate([here.reference, d_L, np.zeros(len(d_L))]))
        signs = tuple(jnp.asarray(s) for s in here.modes.values())

        def slope(p: Any) -> Any:
            own = eqx.tree_at(lambda f: f.loop, flat, _with(flat.loop, x, y, p))
            return jax.jacfwd(lambda z: own.field(z, u, signs))(rest)

        return np.asarray(jax.jit(jax.vmap(slope))(jnp.asarray(plane)))


def _with(loop: ClosedLoop, x: Axis, y: Axis, values: Any) -> ClosedLoop:
    changed = tree.replace(loop.law, {x.path: values[0], y.path: values[1]})
    return eqx.tree_at(lambda v: v.law, loop, changed)


def _rightmost(A: np.ndarray) -> np.ndarray:
    """Without the poles at 0 that no gain moves: they are there at every point."""
    poles = np.linalg.eigvals(A)
    size = np.abs(poles) / np.abs(poles).max(axis=-1, keepdims=True)
    fixed = int((size <= _AT_ZERO).sum(axis=-1).min())
    rank = np.argsort(np.argsort(size, axis=-1), axis=-1)
    return np.where(rank < fixed, -np.inf, np.real(poles)).max(axis=-1)


def _edges(loop: ClosedLoop, x: Axis, y: Axis) -> tuple[Edge, ...]:
    """Where the plane is that of K_p and K_i of an axis of the 2014 paper's torque loop."""
    ends = {a.path.rpartition(".")[2]: a for a in (x, y)}
    same = x.path.rpartition(".")[0] == y.path.rpartition(".")[0]
    if set(ends) != {"K_p", "K_i"} or not same or loop.law.reference_unit != "Nm":
        return ()
    paths = operating.gain_paths(loop.law, ("K_p",))
    axis = paths.index(ends["K_p"].path)
    try:
        joints = joint_system(loop.drive, np.asarray(operating.angles(loop), float))
    except InputError:
        return ()
    K_p, K_i = routh.stability_region(joints, 400)
    return (Edge(axis, K_p[:, axis], K_i[:, axis]),)
