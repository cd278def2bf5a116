"""Physical parameters: array leaves with a unit and a rule, checked once, at construction."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from jaxsim.errors import InputError


class Rule(NamedTuple):
    """What a parameter must satisfy: the words for a person, the test, and the usual fix."""

    text: str
    holds: Callable[[Any], Any]
    fix: str

    def broken(self, value: Any) -> Rule | None:
        """The rule that a concrete value breaks: to be a number, to be finite, or this one."""
        rules = (NUMBER, ANY, self)
        return next((r for r in rules if not np.all(np.asarray(r.holds(np.asarray(value))))), None)


def _finite(value: Any) -> Any:
    """NumPy's for numbers: jnp.isfinite would trace them where a component is built inside jit."""
    return jnp.isfinite(value) if isinstance(value, jax.Array) else np.isfinite(value)


NUMBER = Rule("must be a number, not nan", lambda v: v == v, "find out where it is from")
ANY = Rule("must be finite", _finite, "give a finite number")
POSITIVE = Rule(
    "must be > 0",
    lambda v: _finite(v) & (v > 0),
    "give a positive number in SI units",
)
NON_NEGATIVE = Rule(
    "must be >= 0",
    lambda v: _finite(v) & (v >= 0),
    "give zero or a positive number in SI units",
)


class Checked(NamedTuple):
    """One parameter of one component, as found in a tree: where it is, its rule and its value."""

    path: str
    rule: Rule
    value: Any
    ndim: int


def _as_leaf(value: Any) -> Any:
    """Keep JAX arrays (they may be traced); make everything else a float64 numpy array.

    Numpy leaves leave the JAX backend untouched until the first run, and they keep full precision
    whatever `jax_enable_x64` says at the time a drive is written down.
    """
    if isinstance(value, jax.Array):
        return value
    if isinstance(value, bool | str) or value is None:
        raise TypeError(f"a number is needed, got {value!r}")
    return np.asarray(value, dtype=np.float64)


def parameter(
    unit: str, doc: str, *, rule: Rule = ANY, default: Any = dataclasses.MISSING, ndim: int = 0
) -> Any:
    """A differentiable parameter: an array leaf with `unit`, a one-line `doc` and a `rule`."""
    metadata = {"unit": unit, "doc": doc, "rule": rule, "ndim": ndim}
    if default is dataclasses.MISSING:
        return eqx.field(converter=_as_leaf, metadata=metadata)
    # A default goes through the converter too, so that every leaf is an array.
    return eqx.field(converter=_as_leaf, metadata=metadata, default=default)


def stacked(values: Sequence[Any]) -> Any:
    """The parameters of several components as one array: NumPy's where none is JAX's."""
    traced = any(isinstance(v, jax.Array) for v in values)
    return jnp.stack([jnp.asarray(v) for v in values]) if traced else np.stack(values)


def is_concrete(value: Any) -> bool:
    """Whether a value is a number that Python can look at, not one being traced by JAX."""
    return not isinstance(value, jax.core.Tracer)


class Parameters(eqx.Module):
    """Base of every component (motor, transmission, load, law, signal): checks its own fields."""

    def __check_init__(self) -> None:
        for item in own_parameters(self, type(self).__name__):
            if not is_concrete(item.value) or np.ndim(item.value) > item.ndim:
                continue  # traced, or a batch: the run reports the members by index
            if broken := item.rule.broken(item.value):
                got = np.asarray(item.value).tolist()
                raise InputError(item.path, broken.text, got, broken.fix)


def own_parameters(component: Parameters, path: str) -> Iterator[Checked]:
    """The parameters that a component declares itself, not those of components inside it."""
    for field in dataclasses.fields(component):
        if "rule" in field.metadata:
            value = getattr(component, field.name)
            yield Checked(
                f"{path}.{field.name}", field.metadata["rule"], value, field.metadata["ndim"]
            )


def all_parameters(tree: Any, path: str = "") -> Iterator[Checked]:
    """Every declared parameter in a tree of components, with its dotted path."""
    if isinstance(tree, Parameters):
        yield from own_parameters(tree, path)
    if isinstance(tree, eqx.Module):
        for field in dataclasses.fields(tree):
            below = f"{path}.{field.name}" if path else field.name
            yield from all_parameters(getattr(tree, field.name), below)
    elif isinstance(tree, tuple | list):
        for index, child in enumerate(tree):
            yield from all_parameters(child, f"{path}[{index}]" if len(tree) > 1 else path)


def all_valid(tree: Any) -> Any:
    """One boolean, traceable: every rule of every parameter in the tree holds."""
    valid = jnp.asarray(True)
    for item in all_parameters(tree):
        valid = valid & jnp.all(item.rule.holds(item.value))
    return valid


def violations(tree: Any, member: int | None = None) -> list[str]:
    """The broken rules of a concrete tree, in words; `member` picks one of a batch."""
    found = []
    for item in all_parameters(tree):
        value = np.asarray(item.value)
        if member is not None and value.ndim > item.ndim:
            value = value[member]
        if broken := item.rule.broken(value):
            found.append(f"{item.path}: {broken.text}; got {value.tolist()}")
    return found
