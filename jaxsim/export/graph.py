"""Scalar expressions as a graph: shared where they are equal, folded where they are numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

Value = float | bool | str | None


class Node(NamedTuple):
    """One scalar: an operation on others, a number (`const`) or something named (`name`)."""

    op: str
    args: tuple[int, ...]
    value: Value


_FOLD: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": abs,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "pow": lambda a, b: a**b,
    "max": max,
    "min": min,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
}


class Graph:
    """All scalars of one function; the same scalar is there once, under one number."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[tuple[str, tuple[int, ...], str], int] = {}

    def add(self, op: str, *args: int, value: Value = None) -> int:
        """The number of a scalar, after what can be said of it without running it."""
        simpler = self._simpler(op, args)
        if simpler is not None:
            return simpler
        key = (op, args, repr(value))  # repr: 1.0 and True, 0.0 and -0.0 are not the same
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(Node(op, args, value))
        return self._known[key]

    def const(self, value: Any) -> int:
        return self.add("const", value=value if isinstance(value, bool) else float(value))

    def name(self, text: str) -> int:
        return self.add("name", value=text)

    def number(self, node: int) -> Any:
        """What a scalar is where it is a number, else None."""
        return self.nodes[node].value if self.nodes[node].op == "const" else None

    def below(self, roots: list[int]) -> set[int]:
        """All scalars that the roots stand on, themselves included."""
        found: set[int] = set()
        todo = list(roots)
        while todo:
            node = todo.pop()
            if node not in found:
                found.add(node)
                todo += self.nodes[node].args
        return found

    def _simpler(self, op: str, args: tuple[int, ...]) -> int | None:
        numbers = [self.number(a) for a in args]
        if args and op in _FOLD and None not in numbers:
            if op == "div" and numbers[1] == 0.0:
                return None
            return self.const(_FOLD[op](*numbers))
        if op == "select" and numbers[0] is not None:
            return args[1] if numbers[0] else args[2]
        if op == "select" and args[1] == args[2]:
            return args[1]
        return self._neutral(op, args, numbers) if len(args) == 2 else None

    def _neutral(self, op: str, args: tuple[int, ...], numbers: list[Any]) -> int | None:
        """x + 0, x - 0, 0 - x, 1 x, 0 x, x/1: what differentiating an affine field leaves."""
        left, right = numbers
        if op == "mul" and 0.0 in (left, right):
            return self.const(0.0)  # all readings are finite: the step refuses others
        neutral = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0}.get(op)
        if neutral is None:
            return None
        if right is not None and right == neutral:
            return args[0]
        if left is not None and left == neutral and op in ("add", "mul"):
            return args[1]
        if op == "sub" and left is not None and left == 0.0:
            return self.add("neg", args[1])
        return None
