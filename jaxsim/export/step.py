"""What a sampled law does at a sample, as scalar expressions of gains, readings and memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError
from jaxsim.export import tracing
from jaxsim.export.graph import Graph
from jaxsim.law import Measured
from jaxsim.laws.policy import Policy
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


class _Functions(NamedTuple):
    """start(law, ys) -> memory; step(law, memory, ys) -> memory and commands. All traceable."""

    start: Callable[..., Any]
    step: Callable[..., Any]


def step_of(law: Any, ratios: tuple[float, ...]) -> Step:
    """The step of a sampled law or of a policy. ratios: of the gears, per axis.

    Raises: InputError for what has no meaning on a target: random noise, a policy over a law with
    a state of its own or one that is told the motor's current, operations without counterpart.
    """
    functions = _policy(law, ratios) if isinstance(law, Policy) else _sampled(law, ratios)
    graph = Graph()
    gains, leaves = _gains(graph, law)
    ys, readings = _readings(graph, law)
    arrays = [jax.ShapeDtypeStruct(np.shape(v), jnp.float64) for v in jax.tree.leaves(law)]
    structure = jax.tree.structure(law)
    scalars = [
        Measured(*[jax.ShapeDtypeStruct((), jnp.float64)] * len(Measured._fields))
    ] * law.axes

    def start(values: Any, ys: Any) -> Any:
        return functions.start(jax.tree.unflatten(structure, values), tuple(ys))

    def step(values: Any, memory: Any, ys: Any) -> Any:
        return functions.step(jax.tree.unflatten(structure, values), memory, tuple(ys))

    first, shapes = jax.make_jaxpr(start, return_shape=True)(arrays, scalars)
    names = _cell_names(shapes, law.axes)
    now = [np.array(graph.name(f"state->{name}")) for name in names]
    firsts = [int(v) for v in tracing.read(graph, first, [*leaves, *ys])]
    memory = jax.tree.map(lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype), shapes)
    whole = jax.make_jaxpr(step)(arrays, memory, scalars)
    results = [int(v) for v in tracing.read(graph, whole, [*leaves, *now, *ys])]
    cells = [Cell(n, int(i), f, r) for n, i, f, r in zip(names, now, firsts, results, strict=False)]
    return _used(Step(graph, gains, readings, cells, results[len(cells) :]))


def _sampled(law: Any, ratios: tuple[float, ...]) -> _Functions:
    if not isinstance(law, Sampled):
        kind = type(law).__name__
        raise InputError("law", "must be sampled to run on a target", kind, "give a period")
    if isinstance(law.sensors, Noisy):
        fix = "take the sensors inside `noisy`"
        raise InputError("law.sensors", "must be without noise of their own", "noisy", fix)

    def start(law: Any, ys: Any) -> Any:
        held = law.start(ys, law.period)
        return held.law, held.seen

    def step(law: Any, memory: Any, ys: Any) -> Any:
        # The target has its own delay: what is written is the law without one.
        law = dataclasses.replace(law, delay=0.0)
        held = law.start(ys, law.period)._replace(law=memory[0], seen=memory[1])
        held = law.on_tick(0, ys, held, ratios, law.period)
        return (held.law, held.seen), held.command

    return _Functions(start, step)


def _policy(law: Policy, ratios: tuple[float, ...]) -> _Functions:
    """The network, and the law that it sets, whose command is held for the period."""
    if isinstance(law.sensors, Noisy):
        fix = "take the sensors inside `noisy`"
        raise InputError("law.sensors", "must be without noise of their own", "noisy", fix)
    zeros = (Measured(*[0.0] * len(Measured._fields)),) * law.axes
    if jax.tree.leaves(law.base.rest(zeros)) or any(law.base.surfaces):
        raise InputError(
            "law.base", "must have neither state nor switches: it runs between samples",
            type(law.base).__name__, "sample it, or train a policy that commands the torque",
        )  # fmt: skip

    def start(law: Any, ys: Any) -> Any:
        return law.start(ys, law.period)

    def step(law: Any, held: Any, ys: Any) -> Any:
        states = (law.base.rest(ys), ((),) * law.axes)
        held = law.on_tick(0, ys, held, ratios, law.period, states)
        return held, law.under(held).command(states[0], (held.seen,), ((),) * law.axes)

    return _Functions(start, step)


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


def _cell_names(memory: Any, axes: int) -> list[str]:
    """last_... for the readings before; x1, x2, ... for the law's own state, in its order."""
    names, own = [], 0
    for path, _ in jax.tree_util.tree_flatten_with_path(memory)[0]:
        parts = _parts(path)
        if parts[-1] in Measured._fields and parts[0] in ("1", "seen"):
            axis = parts[1] if axes > 1 else ""
            names.append("_".join(v for v in ("last", parts[-1], axis) if v))
        else:
            own += 1
            names.append(f"x{own}" if parts[0].isdigit() else "_".join(parts))
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
