"""Linear systems with named signals: the one form that all linear analysis works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from jaxsim.errors import InputError


def per_axis(name: str, axes: int) -> tuple[str, ...]:
    """The names of one signal: as it is for one axis, `name[0]`, `name[1]`, ... for several."""
    return (name,) if axes == 1 else tuple(f"{name}[{i}]" for i in range(axes))


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x' = A x + B u, y = C x + D u, with the names of x, u and y.

    A (n, n), B (n, m), C (q, n), D (q, m): float64 arrays; SI units of the named signals.
    Raises: InputError where shapes and names disagree.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __post_init__(self) -> None:
        n, m, q = len(self.states), len(self.inputs), len(self.outputs)
        for name, shape in {"A": (n, n), "B": (n, m), "C": (q, n), "D": (q, m)}.items():
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape:
                raise InputError(name, f"must have shape {shape}", value.shape, "match the names")
            object.__setattr__(self, name, value)

    def channel(self, outputs: Sequence[str], inputs: Sequence[str]) -> StateSpace:
        """The same system seen from some inputs to some outputs.

        Raises: InputError for an unknown name.
        """
        rows = [_find(name, self.outputs, "output") for name in outputs]
        columns = [_find(name, self.inputs, "input") for name in inputs]
        return StateSpace(
            self.A, self.B[:, columns], self.C[rows], self.D[np.ix_(rows, columns)],
            self.states, tuple(inputs), tuple(outputs),
        )  # fmt: skip

    def balanced(self) -> StateSpace:
        """The same system with states scaled by powers of two so that rows and columns match.

        Currents, angles and speeds differ by 1e5 here; eigenvalue problems need them alike.
        """
        _, transform = linalg.matrix_balance(self.A, permute=False)
        scale = np.diag(transform)
        return StateSpace(
            self.A * scale / scale[:, None], self.B / scale[:, None], self.C * scale, self.D,
            self.states, self.inputs, self.outputs,
        )  # fmt: skip


def _find(name: str, known: tuple[str, ...], kind: str) -> int:
    if name not in known:
        raise InputError.unknown(kind, name, known)
    return known.index(name)


def static(gain: np.ndarray, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> StateSpace:
    """y = gain u, without states."""
    q, m = len(outputs), len(inputs)
    return StateSpace(
        np.zeros((0, 0)), np.zeros((0, m)), np.zeros((q, 0)), gain, (), inputs, outputs
    )


def poles(system: StateSpace) -> np.ndarray:
    """Eigenvalues of A, 1/s, sorted by real part, rightmost first."""
    return by_real_part(np.linalg.eigvals(system.balanced().A))


def by_real_part(values: np.ndarray) -> np.ndarray:
    """Complex numbers sorted from right to left, conjugates side by side."""
    height = np.imag(values)
    return values[np.lexsort((height, np.abs(height), -np.real(values)))]


def interconnect(
    systems: Sequence[StateSpace], inputs: Sequence[str], outputs: Sequence[str]
) -> StateSpace:
    """Systems joined by the names of their signals.

    An input takes the output of the same name; outputs of one name add up (a summing point).
    `inputs` are those that come from outside.

    Raises: InputError for an input without a source, and for an algebraic loop without solution.
    """
    A, B = (linalg.block_diag(*(getattr(s, k) for s in systems)) for k in "AB")
    C, D = (linalg.block_diag(*(getattr(s, k) for s in systems)) for k in "CD")
    u, y = [n for s in systems for n in s.inputs], [n for s in systems for n in s.outputs]
    signals = tuple(dict.fromkeys(y))
    total = np.array([[a == b for b in y] for a in signals], dtype=float)
    inside = np.array([[a == b for b in signals] for a in u], dtype=float)
    outside = np.array([[a == b for b in inputs] for a in u], dtype=float)
    for name, row in zip(u, np.hstack([inside, outside]), strict=True):
        if not row.any():
            raise InputError("input", f"{name} must come from somewhere", "nothing", "name it")
    loop = np.eye(len(signals)) - total @ D @ inside
    if np.linalg.cond(loop) > _SOLVABLE:
        raise InputError("loop", "must have a solution at every instant", "none", "add a filter")
    of_state, of_input = (
        np.linalg.solve(loop, total @ C),
        np.linalg.solve(loop, total @ D @ outside),
    )
    states = tuple(n for s in systems for n in s.states)
    return StateSpace(
        A + B @ inside @ of_state, B @ (inside @ of_input + outside), of_state, of_input,
        states, tuple(inputs), signals,
    ).channel(outputs, inputs)  # fmt: skip


_SOLVABLE = 1e12  # condition number of an algebraic loop
