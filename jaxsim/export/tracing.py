"""A jaxpr as scalar expressions: arrays become arrays of scalars, and only arithmetic is left."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jax.extend.core import Literal

from jaxsim.errors import InputError
from jaxsim.export.graph import Graph

_SAME = {
    "add": "add", "add_any": "add", "sub": "sub", "mul": "mul", "div": "div", "neg": "neg",
    "max": "max", "min": "min", "abs": "abs", "sqrt": "sqrt", "exp": "exp", "log": "log",
    "log1p": "log1p", "expm1": "expm1", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "asin", "acos": "acos", "atan": "atan", "atan2": "atan2", "sinh": "sinh",
    "cosh": "cosh", "tanh": "tanh", "floor": "floor", "ceil": "ceil", "pow": "pow",
    "rem": "fmod", "gt": "gt", "ge": "ge", "lt": "lt", "le": "le", "eq": "eq", "ne": "ne",
    "and": "and", "or": "or", "not": "not",
}  # fmt: skip
# What only moves elements is asked where it moves them, with their numbers in their place.
LOGICAL = {"gt", "ge", "lt", "le", "eq", "ne", "and", "or", "not"}
_MOVES = {
    "broadcast_in_dim",
    "reshape",
    "squeeze",
    "transpose",
    "slice",
    "rev",
    "expand_dims",
    "concatenate",
    "stack",
}
_INSIDE = ("jaxpr", "call_jaxpr", "fun_jaxpr")
_AS_IS = {"copy", "copy_p", "stop_gradient", "reduce_precision", "optimization_barrier"}


def read(graph: Graph, closed: Any, inputs: list[np.ndarray]) -> list[np.ndarray]:
    """The outputs of a closed jaxpr as arrays of scalars of the graph, given those of its inputs.

    Raises: InputError for an operation that has no counterpart, by its name.
    """
    return _run(graph, closed.jaxpr, [constants(graph, c) for c in closed.consts], inputs)


def constants(graph: Graph, value: Any) -> np.ndarray:
    """Numbers as an array of scalars."""
    array = np.asarray(value)
    plain = array.astype(bool if array.dtype == bool else float).ravel().tolist()
    return _array([graph.const(v) for v in plain], array.shape)


def _array(nodes: list[int], shape: Any) -> np.ndarray:
    return np.array(nodes, dtype=np.int64).reshape(shape)


def _run(graph: Graph, jaxpr: Any, consts: list[Any], inputs: list[Any]) -> list[np.ndarray]:
    known: dict[Any, np.ndarray] = {}
    known.update(zip(jaxpr.constvars, consts, strict=True))
    known.update(zip(jaxpr.invars, inputs, strict=True))

    def value(v: Any) -> np.ndarray:
        return constants(graph, v.val) if isinstance(v, Literal) else known[v]

    for eqn in jaxpr.eqns:
        results = _apply(graph, eqn, [value(v) for v in eqn.invars])
        known.update(zip(eqn.outvars, results, strict=True))
    return [value(v) for v in jaxpr.outvars]


def _apply(graph: Graph, eqn: Any, args: list[np.ndarray]) -> list[np.ndarray]:
    name, params = eqn.primitive.name, eqn.params
    inside = next((params[k] for k in _INSIDE if k in params), None)
    if inside is not None:
        return _called(graph, inside, args)
    if name in _AS_IS:
        return args
    if name in _MOVES:
        return [_moved(eqn, args)]
    if name in _SAME:
        return [_each(lambda *v: graph.add(_SAME[name], *v), args)]
    if name not in _SPECIAL:
        raise InputError(
            "export", "must be a law made of arithmetic on its readings and state",
            f"the operation `{name}`", "write it with jnp arithmetic, where, clip, minimum, ...",
        )  # fmt: skip
    return [_SPECIAL[name](graph, args, params)]


def _moved(eqn: Any, args: list[np.ndarray]) -> np.ndarray:
    starts = np.cumsum([0, *(a.size for a in args)])
    places = [s + np.arange(a.size).reshape(a.shape) for s, a in zip(starts, args, strict=False)]
    order = np.asarray(eqn.primitive.bind(*places, **eqn.params))
    return np.concatenate([a.ravel() for a in args])[order]


def _called(graph: Graph, inside: Any, args: list[np.ndarray]) -> list[np.ndarray]:
    closed = hasattr(inside, "consts") and hasattr(inside, "jaxpr")
    if closed:
        return read(graph, inside, args)
    return _run(graph, inside, [], args)


def _each(function: Callable[..., int], args: list[np.ndarray]) -> np.ndarray:
    """Element by element."""
    broad = np.broadcast_arrays(*args)
    flat = zip(*(a.ravel().tolist() for a in broad), strict=True)
    return _array([function(*v) for v in flat], broad[0].shape)


def _sign(graph: Graph, args: list[np.ndarray], _: Any) -> np.ndarray:
    return _each(lambda v: graph.add("sign", v), args)


def _select(graph: Graph, args: list[np.ndarray], _: Any) -> np.ndarray:
    return _each(lambda which, no, yes: graph.add("select", which, yes, no), args)


def _clamp(graph: Graph, args: list[np.ndarray], _: Any) -> np.ndarray:
    return _each(lambda low, v, high: graph.add("min", graph.add("max", v, low), high), args)


def _square(graph: Graph, args: list[np.ndarray], _: Any) -> np.ndarray:
    return _each(lambda v: graph.add("mul", v, v), args)


def _integer_pow(graph: Graph, args: list[np.ndarray], params: Any) -> np.ndarray:
    def one(v: int) -> int:
        power = graph.const(1.0)
        for _ in range(abs(params["y"])):
            power = graph.add("mul", power, v)
        return graph.add("div", graph.const(1.0), power) if params["y"] < 0 else power

    return _each(one, args)


def _round(graph: Graph, args: list[np.ndarray], params: Any) -> np.ndarray:
    op = "rint" if int(params["rounding_method"]) == 1 else "round"
    return _each(lambda v: graph.add(op, v), args)


def _convert(graph: Graph, args: list[np.ndarray], params: Any) -> np.ndarray:
    """Between bool and numbers; whole numbers are kept as real ones, which holds to 2^24."""
    to_bool = np.dtype(params["new_dtype"]) == bool
    one, zero = graph.const(1.0), graph.const(0.0)

    def each(v: int) -> int:
        if to_bool == _is_bool(graph, v):
            return v
        return graph.add("ne", v, zero) if to_bool else graph.add("select", v, one, zero)

    return _each(each, args)


def _is_bool(graph: Graph, node: int) -> bool:
    op = graph.nodes[node].op
    logical = op in LOGICAL
    return logical or isinstance(graph.nodes[node].value, bool)


def _sum(graph: Graph, args: list[np.ndarray], params: Any) -> np.ndarray:
    axes = tuple(params["axes"])
    rest = [a for a in range(args[0].ndim) if a not in axes]
    rows = np.transpose(args[0], (*rest, *axes))
    shape = [args[0].shape[a] for a in rest]
    flat = rows.reshape(int(np.prod(shape, dtype=int)), -1).tolist()
    return _array([_total(graph, row) for row in flat], shape)


def _dot(graph: Graph, args: list[np.ndarray], params: Any) -> np.ndarray:
    (mine, yours), batch = params["dimension_numbers"]
    if any(batch) or len(mine) != 1 or max(a.ndim for a in args) > 2:
        raise InputError("export", "must have products of matrices and vectors only",
                         "a higher product", "write it as matrix times vector")  # fmt: skip
    left, right = np.moveaxis(args[0], mine[0], -1), np.moveaxis(args[1], yours[0], -1)
    rows, columns = left.reshape(-1, left.shape[-1]), right.reshape(-1, right.shape[-1])
    found = [
        _total(graph, [graph.add("mul", int(a), int(b)) for a, b in zip(row, column, strict=True)])
        for row in rows
        for column in columns
    ]
    return _array(found, (*left.shape[:-1], *right.shape[:-1]))


def _total(graph: Graph, terms: list[int]) -> int:
    """One flat sum: a chain of additions would be as deep as a layer is wide."""
    terms = [t for t in terms if graph.number(t) != 0.0]
    if not terms:
        return graph.const(0.0)
    return graph.add("sum", *terms) if len(terms) > 1 else terms[0]


_SPECIAL: dict[str, Callable[..., np.ndarray]] = {
    "sign": _sign,
    "select_n": _select,
    "clamp": _clamp,
    "square": _square,
    "integer_pow": _integer_pow,
    "round": _round,
    "convert_element_type": _convert,
    "reduce_sum": _sum,
    "dot_general": _dot,
}
