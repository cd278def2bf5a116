"""Scalar expressions as statements of C99."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from jaxsim.export.graph import Graph
from jaxsim.export.tracing import LOGICAL

_INFIX = {
    "add": ("+", 4), "sub": ("-", 4), "mul": ("*", 5), "div": ("/", 5),
    "gt": (">", 3), "ge": (">=", 3), "lt": ("<", 3), "le": ("<=", 3),
    "eq": ("==", 2), "ne": ("!=", 2), "and": ("&&", 1), "or": ("||", 1),
}  # fmt: skip
_CALLS = {"abs": "fabs", "max": "fmax", "min": "fmin"}
_ATOM, _UNARY = 9, 6
_LONG = 60


class Printer:
    """Writes the scalars of a graph in C, in the order in which they need each other.

    single: float instead of double. What is used once and is short stands where it is used; the
    rest has a name of its own, so that nothing is computed twice.
    """

    def __init__(self, graph: Graph, roots: list[int], *, single: bool) -> None:
        self.graph, self.single = graph, single
        below = graph.below(roots)
        self.uses = Counter(a for n in below for a in graph.nodes[n].args) + Counter(roots)
        self.lines: list[str] = []
        self._done: dict[int, tuple[str, int]] = {}
        for node in sorted(below):  # arguments have smaller numbers than what is made of them
            self._done[node] = self._write(node)

    def text(self, node: int) -> str:
        """A root as an expression."""
        return self._done[node][0]

    def _write(self, node: int) -> tuple[str, int]:
        op, args, value = self.graph.nodes[node]
        if op == "name":
            return str(value), _ATOM
        if op == "const":
            return literal(value, single=self.single), _ATOM
        text, level = self._expression(op, args)
        if self.uses[node] == 1 and len(text) <= _LONG:
            return text, level
        name = f"t{len(self.lines) + 1}"
        kind = "int" if op in LOGICAL else "law_real"
        self.lines.append(f"const {kind} {name} = {text};")
        return name, _ATOM

    def _expression(self, op: str, args: tuple[int, ...]) -> tuple[str, int]:
        if op in _INFIX:
            sign, level = _INFIX[op]
            if level < 4:  # compilers warn of a comparison or `&&` beside another without them
                return f"{self._at(args[0], 4)} {sign} {self._at(args[1], 4)}", level
            # Left to right as in Python: rounding is the same only in the same order.
            return f"{self._at(args[0], level)} {sign} {self._at(args[1], level + 1)}", level
        if op == "sum":
            return "\n        + ".join(self._at(a, 5) for a in args), 4
        if op in ("neg", "not"):
            return f"{'-' if op == 'neg' else '!'}{self._at(args[0], _ATOM)}", _UNARY
        if op == "select":
            which, yes, no = (self._at(a, 1) for a in args)
            return f"({which} ? {yes} : {no})", _ATOM
        if op == "sign":
            zero, x = literal(0.0, single=self.single), self._at(args[0], 4)
            return f"(law_real)(({x} > {zero}) - ({x} < {zero}))", _UNARY
        name = _CALLS.get(op, op) + ("f" if self.single else "")
        return f"{name}({', '.join(self._done[a][0] for a in args)})", _ATOM

    def _at(self, node: int, level: int) -> str:
        text, own = self._done[node]
        return text if own >= level else f"({text})"


def literal(value: Any, *, single: bool) -> str:
    """A number that reads back as itself; negative ones in parentheses."""
    if isinstance(value, bool):
        return str(int(value))
    text = str(np.float32(value)) if single else repr(float(value))
    if text.lstrip("-") == "inf":
        return f"({text.replace('inf', 'HUGE_VALF' if single else 'HUGE_VAL')})"
    if text == "nan":
        return "(law_real)NAN"
    text = text if any(c in text for c in ".en") else f"{text}.0"
    text = f"{text}f" if single else text
    return f"({text})" if text.startswith("-") else text
