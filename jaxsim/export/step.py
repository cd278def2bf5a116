"""What a sampled law does at a sample, as scalar expressions of gains, readings and memory."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError
from jaxsim.export import tracing
from jaxsim.export.graph import Graph
from jaxsim.law import Measured, Supervised
from jaxsim.sampled import Noisy, Sampled

UNITS = dict.fromkeys(Measured._fields, "rad") | {
    "omega_L": "rad/s", "omega_B": "rad/s", "omega_M": "rad/s", "T_s": "Nm",
}  # fmt: skip


class Gain(NamedTuple):
    """A parameter of the law: its name on the target, its values, unit and meaning."""

    name: str
    values: np.ndarray
    unit: str
    doc: str


class Cell(NamedTuple):
    """One number that the law remembers: its name, and the scalars it starts and goes on as."""

    name: str
    now: int
    first: int
    following: int


class Step(NamedTuple):
    """All that a target needs: expressions in `graph`; readings by name; only what is used."""

    graph: Graph
    gains: list[Gain]
    readings: dict[str, int]
    memory: list[Cell]
    commands: list[int]


def step_of(law: Sampled, ratios: tuple[float, ...]) -> Step:
    """The step of a sampled law. ratios: of the gears, per axis.

    Raises: InputError for what has no meaning on a target: random noise, a policy that is told
    the motor's current, operations without counterpart.
    """
    _check(law)
    graph = Graph()
    gains, leaves = _gains(graph, law)
    ys, readings = _readings(graph, law)
    arrays = [jax.ShapeDtypeStruct(np.shape(v), jnp.float64) for v in jax.tree.leaves(law)]
    structure = jax.tree.structure(law)
    scalars = [
        Measured(*[jax.ShapeDtypeStruct((), jnp.float64)] * len(Measured._fields))
    ] * law.axes

    def start(values: Any, ys: Any) -> Any:
        return _first(jax.tree.unflatten(structure, values), tuple(ys))

    def step(values: Any, memory: Any, ys: Any) -> Any:
        return _next(jax.tree.unflatten(structure, values), memory, tuple(ys), ratios)

    first, shapes = jax.make_jaxpr(start, return_shape=True)(arrays, scalars)
    names = _cell_names(shapes, law.axes)
    now = [np.array(graph.name(f"state->{name}")) for name in names]
    firsts = [int(v) for v in tracing.read(graph, first, [*leaves, *ys])]
    memory = jax.tree.map(lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype), shapes)
    whole = jax.make_jaxpr(step)(arrays, memory, scalars)
    results = [int(v) for v in tracing.read(graph, whole, [*leaves, *now, *ys])]
    cells = [Cell(n, int(i), f, r) for n, i, f, r in zip(names, now, firsts, results, strict=False)]
    return _used(Step(graph, gains, readings, cells, results[len(cells) :]))


def _check(law: Any) -> None:
    if not isinstance(law, Sampled):
        kind = type(law).__name__
        raise InputError("law", "must be sampled to run on a target", kind, "give a period")
    for sensors in (law.sensors, getattr(law.law, "sensors", None)):
        if isinstance(sensors, Noisy):
            fix = "take the sensors inside `noisy`"
            raise InputError("law.sensors", "must be without noise of their own", "noisy", fix)


class _Memory(NamedTuple):
    """States of the law and of a policy over it, the readings before, samples since its turn."""

    x: Any
    policy: Any
    last: Any
    count: Any


def _first(law: Sampled, ys: Any) -> _Memory:
    """The memory before the first sample."""
    held = law.start(ys, law.period)
    x, policy = held.law if isinstance(law.law, Supervised) else (held.law, ())
    return _Memory(x, policy, held.seen, jnp.zeros(()))


def _next(law: Sampled, memory: _Memory, ys: Any, ratios: tuple[float, ...]) -> tuple[Any, Any]:
    """Memory and commands after a sample, in whatever precision the target has and undelayed."""
    law = dataclasses.replace(law, delay=0.0, precision=64)
    supervised = isinstance(law.law, Supervised)
    every = law.law.ticks(law.period) if supervised else 1
    inside = (memory.x, memory.policy) if supervised else memory.x
    held = law.start(ys, law.period)._replace(law=inside, seen=memory.last)
    # Where every sample is its turn, nothing is counted: what follows from 0 is folded away.
    held = law.sample(ys, held, ratios, memory.count if every > 1 else 0)
    x, policy = held.law if supervised else (held.law, ())
    count = jnp.where(memory.count + 1.0 == every, 0.0, memory.count + 1.0)
    return _Memory(x, policy, held.seen, count), held.waiting[0]


def _gains(graph: Graph, law: Any) -> tuple[list[Gain], list[np.ndarray]]:
    """Every parameter under the shortest name that no other has, and its scalars in the code."""
    found = jax.tree_util.tree_flatten_with_path(law)[0]
    names = _short([_parts(path) for path, _ in found])
    gains, leaves = [], []
    for short, (path, value) in zip(names, found, strict=True):
        name = f"LAW_{short}"  # a macro called `limit` would break other people's code
        meta = _metadata(law, path)
        array = np.asarray(value, float)
        gains.append(Gain(name, array, meta.get("unit", "1"), meta.get("doc", "")))
        at = ["".join(f"[{i}]" for i in index) for index in np.ndindex(array.shape)]
        leaves.append(np.array([graph.name(name + i) for i in at], np.int64).reshape(array.shape))
    return gains, leaves


def _parts(path: Any) -> list[str]:
    return [str(getattr(key, "name", getattr(key, "idx", key))) for key in path]


def _short(paths: list[list[str]]) -> list[str]:
    """Each path by its last part, or by as many more as make it its own."""

    def tail(parts: list[str], length: int) -> str:
        return "_".join(parts[-length:])

    names = []
    for parts in paths:
        length = 1
        while sum(tail(p, length) == tail(parts, length) for p in paths) > 1:
            length += 1
        names.append(tail(parts, length))
    return names


def _metadata(law: Any, path: Any) -> Any:
    """What the field that declares a leaf says about it."""
    owner: Any = law
    for key in path[:-1]:
        owner = getattr(owner, key.name) if hasattr(key, "name") else owner[key.idx]
    if not isinstance(owner, eqx.Module):
        return {}
    return next((f.metadata for f in dataclasses.fields(owner) if f.name == path[-1].name), {})


def _readings(graph: Graph, law: Any) -> tuple[list[np.ndarray], dict[str, int]]:
    names = [name for axis in range(law.axes) for name in named(Measured._fields, axis, law.axes)]
    numbers = {name: graph.name(f"in->{name}") for name in names}
    return [np.array(v) for v in numbers.values()], numbers


def named(names: Any, axis: int, axes: int) -> list[str]:
    """Names of one axis's signals: with its number where there are several."""
    return [f"{name}_{axis}" if axes > 1 else name for name in names]


def _cell_names(memory: _Memory, axes: int) -> list[str]:
    """x1, x2, ... for the law's own state in its order; the others by what they are."""
    names = [f"x{i + 1}" for i in range(len(jax.tree.leaves(memory.x)))]
    for path, _ in jax.tree_util.tree_flatten_with_path(memory._replace(x=()))[0]:
        words = _parts(path)
        if words[0] == "last":
            words = ["last", words[2], *(words[1:2] if axes > 1 else [])]
        names.append("_".join(words))
    return names


def _used(step: Step) -> Step:
    """Without the memory, readings and parameters that no command stands on."""
    live: set[str] = set()
    while True:
        kept = [c for c in step.memory if c.name in live]
        below = step.graph.below([*step.commands, *(c.following for c in kept)])
        more = {c.name for c in step.memory if c.now in below}
        if more <= live:
            break
        live |= more
    below |= step.graph.below([c.first for c in kept])
    words = [str(step.graph.nodes[n].value) for n in below if step.graph.nodes[n].op == "name"]
    gains = [g for g in step.gains if any(w.split("[")[0] == g.name for w in words)]
    readings = {k: v for k, v in step.readings.items() if v in below}
    return step._replace(memory=kept, gains=gains, readings=readings)
