"""Ties: parameters of a law that follow a free one, written as "2 * K_P + 0.1"."""

from __future__ import annotations

import ast
from typing import Any, NamedTuple

from jaxsim.errors import InputError

_RULE = "must be a number times one free parameter, plus a number"


class Tie(NamedTuple):
    """The parameter at `path` is factor*gain + offset, SI."""

    path: str
    factor: float = 1.0
    offset: float = 0.0

    def value(self, gain: Any) -> Any:
        return self.factor * gain + self.offset


class _Line(NamedTuple):
    """factor*name + offset; without a name a number."""

    name: str | None
    factor: float
    offset: float


def read_tie(text: str, where: str) -> tuple[str, float, float]:
    """name, factor and offset of what is written: any sum and product that comes to that.

    Raises: InputError for anything else.
    """
    try:
        found = _line(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError, ZeroDivisionError):
        found = None
    if found is None or found.name is None or found.factor == 0.0:
        raise InputError(where, _RULE, repr(text), 'e.g. "2 * K_P" or "K_P / 20 + 0.01"')
    return found.name, found.factor, found.offset


def _line(node: ast.expr) -> _Line:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return _Line(None, 0.0, float(number))
        case ast.Name(id=name):
            return _Line(name, 1.0, 0.0)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return _scaled(_line(inner), -1.0)
        case ast.BinOp(left=left, op=op, right=right):
            return _joined(_line(left), op, _line(right))
    raise ValueError("neither number, name, sum nor product")


def _joined(a: _Line, op: ast.operator, b: _Line) -> _Line:
    match op:
        case ast.Add():
            return _sum(a, b)
        case ast.Sub():
            return _sum(a, _scaled(b, -1.0))
        case ast.Mult() if a.name is None:
            return _scaled(b, a.offset)
        case ast.Mult() if b.name is None:
            return _scaled(a, b.offset)
        case ast.Div() if b.name is None:
            return _scaled(a, 1.0 / b.offset)
    raise ValueError("not linear")


def _scaled(a: _Line, by: float) -> _Line:
    return _Line(a.name, by * a.factor, by * a.offset)


def _sum(a: _Line, b: _Line) -> _Line:
    if a.name is not None and b.name is not None and a.name != b.name:
        raise ValueError("two names")
    return _Line(a.name or b.name, a.factor + b.factor, a.offset + b.offset)
