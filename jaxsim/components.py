"""Components (drives, laws, signals) to and from the tables of a file."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxsim import law as laws
from jaxsim import sampled, signal, tree
from jaxsim.catalog import (
    DERIVATIVES,
    LAWS,
    LOADS,
    MOTORS,
    SIGNALS,
    TRANSMISSIONS,
    Catalog,
    snake_case,
)
from jaxsim.derivative import Derivatives
from jaxsim.drive import Drive, Load, Motor, Transmission
from jaxsim.errors import InputError, called
from jaxsim.laws import policy
from jaxsim.motors import dc
from jaxsim.observation import Action, Channel
from jaxsim.parameters import all_parameters
from jaxsim.quantity import to_si
from jaxsim.sampled import Sensors
from jaxsim.scenario import Start

Table = dict[str, Any]
Leaf = Callable[[Any, Any], Any]


class _Kind(typing.NamedTuple):
    """What may stand where a base class is asked for."""

    catalog: Catalog | None
    structural: dict[str, type]
    several: Callable[..., Any] | None  # what a list of tables means


_SENSORS = {
    "true_speeds": sampled.TrueSpeeds,
    "differences": sampled.Differences,
    "encoders": sampled.Encoders,
    "filtered": sampled.Filtered,
    "noisy": sampled.Noisy,
}
_STRUCTURE = {"sampled": sampled.Sampled, "decentral": laws.Decentral}
KINDS: dict[type, _Kind] = {
    laws.Control: _Kind(LAWS, _STRUCTURE, laws.total),
    laws.Law: _Kind(LAWS, _STRUCTURE, laws.total),
    Derivatives: _Kind(DERIVATIVES, {}, None),
    signal.Signal: _Kind(SIGNALS, {}, signal.Sum),
    Motor: _Kind(MOTORS, {}, None),
    Transmission: _Kind(TRANSMISSIONS, {}, None),
    Load: _Kind(LOADS, {}, None),
    Sensors: _Kind(None, _SENSORS, None),
    dc.Ripple: _Kind(None, {"ripple": dc.Ripple}, None),
    dc.Stribeck: _Kind(None, {"stribeck": dc.Stribeck}, None),
    dc.Supply: _Kind(None, {"supply": dc.Supply}, None),
    Start: _Kind(None, {"start": Start}, None),
    policy.Network: _Kind(None, {"network": policy.Network}, None),
    policy.Trained: _Kind(None, {"trained": policy.Trained}, None),
    policy.Layer: _Kind(None, {"layer": policy.Layer}, None),
    Channel: _Kind(None, {"channel": Channel}, None),
    Action: _Kind(None, {"action": Action}, None),
    Drive: _Kind(None, {"drive": Drive}, None),
}


def build(base: type, given: Any, where: str, drive: Drive | None = None) -> Any:
    """The component that a table describes.

    base: what is asked for (Law, Signal, Motor, ...). given: a table with `type` and the fields
    of that type, or, for laws and signals, a list of tables that is their sum. where: the key in
    the file, for messages. drive: given to laws that are designed for it (`design = {...}`).

    Raises: InputError for unknown types and fields (with the nearest), missing fields, values
    that are no numbers in the declared unit or break a rule.
    """
    kind = KINDS[base]
    if isinstance(given, list) and kind.several is not None and given:
        parts = [build(base, item, f"{where}[{i}]", drive) for i, item in enumerate(given)]
        return kind.several(tuple(parts)) if len(parts) > 1 else parts[0]
    table = dict(_table(given, where))
    cls = _class(base, kind, table, where)
    if "design" in table:
        return _designed(cls, table, where, drive)
    return _construct(cls, table, where, drive)


def _table(given: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise InputError(where, "must be a table", repr(given), 'e.g. { type = "..." }')
    return given


def _class(base: type, kind: _Kind, table: Table, where: str) -> type:
    only = list(kind.structural.values()) if kind.catalog is None else []
    if "type" not in table and len(only) == 1:
        return only[0]
    name = table.pop("type", None)
    scanned = kind.catalog.names() if kind.catalog else []
    known: list[str] = sorted([*kind.structural, *scanned])
    if not isinstance(name, str):
        raise InputError(f"{where}.type", "must name a type", repr(name), f"one of {known}")
    if name in kind.structural:
        return kind.structural[name]
    if kind.catalog is None or (":" not in name and name not in known):
        raise InputError.unknown(f"{where}.type", name, known)
    return kind.catalog.find(name)


def _designed(cls: type, table: Table, where: str, drive: Drive | None) -> Any:
    """`design = {...}`: the arguments of the class method `design(drive, ...)`."""
    options = dict(_table(table.pop("design"), f"{where}.design"))
    if table or not hasattr(cls, "design"):
        wrong = sorted(table) or "design"
        raise InputError(where, "takes either fields or a design", wrong, "leave one out")
    units: Mapping[str, str] = cls.design_units  # type: ignore[attr-defined]
    _no_strangers(options, units, f"{where}.design")
    _none_missing(options, units, f"{where}.design")
    values = {k: to_si(v, units[k], f"{where}.design.{k}") for k, v in options.items()}
    return cls.design(drive, **values)  # type: ignore[attr-defined]


def _construct(cls: type, table: Table, where: str, drive: Drive | None) -> Any:
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
    _no_strangers(table, fields, where)
    required = [name for name, field in fields.items() if not _has_default(field)]
    _none_missing(table, required, where)
    values = {
        name: _field(fields[name], hints[name], value, f"{where}.{name}", drive)
        for name, value in table.items()
    }
    try:
        return cls(**values)
    except InputError as error:
        raise error.called(f"{where}.{error.field.rpartition('.')[2]}") from None


def _has_default(field: Any) -> bool:
    missing = dataclasses.MISSING
    return field.default is not missing or field.default_factory is not missing


def _no_strangers(table: Mapping[str, Any], known: Any, where: str) -> None:
    for name in table:
        if name not in known:
            raise InputError.unknown(f"{where}.{name}", name, known)


def _none_missing(table: Mapping[str, Any], required: Any, where: str) -> None:
    missing = [name for name in required if name not in table]
    if missing:
        raise InputError(where, "must have all its fields", f"none for {missing}", "add them")


def _field(field: Any, hint: Any, value: Any, where: str, drive: Drive | None) -> Any:
    bases = [b for b in (field.metadata.get("base"), *_classes(hint)) if b in KINDS]
    if bases:
        return _nested(bases[0], hint, value, where, drive)
    if "rule" in field.metadata:
        number = to_si(value, field.metadata["unit"], where)
        if isinstance(number, list) and field.metadata["ndim"] == 0:
            raise InputError(where, "must be one number", value, "give a single value")
        return np.asarray(number) if isinstance(number, list) else number
    return _static(hint, value, where)


def _nested(base: type, hint: Any, value: Any, where: str, drive: Drive | None) -> Any:
    """A component, or for fields with one per axis a tuple of them."""
    if not _is_tuple(hint):
        return build(base, value, where, drive)
    if not isinstance(value, list):
        return (build(base, value, where, drive),)
    return tuple(build(base, item, f"{where}[{i}]", drive) for i, item in enumerate(value))


def _is_tuple(hint: Any) -> bool:
    return typing.get_origin(hint) is tuple


def _classes(hint: Any) -> list[type]:
    """The classes that a type hint mentions."""
    inner = typing.get_args(hint)
    if inner and typing.get_origin(hint) is not typing.Literal:
        return [c for part in inner for c in _classes(part)]
    return [hint] if isinstance(hint, type) else []


def _static(hint: Any, value: Any, where: str) -> Any:
    """Counts, flags, choices, and times, which are all in seconds."""
    if typing.get_origin(hint) is typing.Literal:
        if value not in typing.get_args(hint):
            raise InputError.unknown(where, str(value), typing.get_args(hint))
        return value
    wanted = [t for t in _classes(hint) if t is not types.NoneType]
    if float in wanted:
        return float(to_si(value, "s", where))
    if not isinstance(value, tuple(wanted)) or (isinstance(value, bool) and bool not in wanted):
        names = " or ".join(t.__name__ for t in wanted)
        raise InputError(where, f"must be of type {names}", repr(value), "check the value")
    return value


def override(component: Any, values: Mapping[str, Any], where: str) -> Any:
    """A copy with named parameters (paths or unambiguous tails of them) replaced.

    Raises: InputError for unknown names, wrong units and values that break a rule.
    """
    for name, value in values.items():
        field = f"{where}.{name}"
        with called(field):
            number = to_si(value, tree.unit(component, name), field)
        component = tree.replace(component, {name: np.asarray(number, float)})
    for item in all_parameters(component):
        if broken := item.rule.broken(item.value):
            field, got = f"{where}.{item.path.lstrip('.')}", np.asarray(item.value).tolist()
            raise InputError(field, broken.text, got, broken.fix)
    return component


def _as_is(value: Any, field: Any) -> Any:
    return value


def dump(component: Any, leaf: Leaf = _as_is) -> Any:
    """The table that `build` would make the same component of; sums are lists.

    One axis needs no list: its law stands for itself. leaf(value, field): what to write for a
    value of a dataclass field (a file with comments wraps it).

    Raises: InputError for classes that a file cannot name (defined inside a function, say).
    """
    if isinstance(component, laws.Sum | laws.JointSum):
        return [dump(part, leaf) for part in component.laws]
    if isinstance(component, signal.Sum):
        return [dump(part, leaf) for part in component.parts]
    if isinstance(component, laws.Decentral) and component.axes == 1:
        return dump(component.laws[0], leaf)
    if isinstance(component, tuple):
        return [dump(part, leaf) for part in component]
    return _dump_fields(component, leaf)


def _dump_fields(component: eqx.Module, leaf: Leaf) -> Table:
    name = _name_of(type(component))
    table: Table = {"type": name} if name else {}
    for field in dataclasses.fields(component):
        value = getattr(component, field.name)
        if not field.init or value is None:
            continue
        if field.name == "command_unit" and value == field.default:
            continue
        if isinstance(component, Drive) and isinstance(value, tuple) and len(value) == 1:
            value = value[0]
        if isinstance(value, eqx.Module | tuple):
            table[field.name] = dump(value, leaf)
        else:
            plain = value if isinstance(value, str | bool | int) else np.asarray(value).tolist()
            table[field.name] = leaf(plain, field)
    return table


def _name_of(cls: type) -> str | None:
    """How a file names a class; None where the place alone says it."""
    base = next((b for b in KINDS if issubclass(cls, b)), None)
    kind = KINDS.get(base) if base else None
    if kind is None:
        kind = _Kind(LAWS, _STRUCTURE, None)
    for name, known in kind.structural.items():
        if known is cls:
            return name if len(kind.structural) > 1 or kind.catalog else None
    short = snake_case(cls.__name__)
    if kind.catalog and kind.catalog.all().get(short) is cls:
        return short
    if "<" in cls.__qualname__:
        raise InputError(
            cls.__name__,
            "must be importable to be written to a file",
            cls.__qualname__,
            "define it at the top of a module",
        )
    return f"{cls.__module__}:{cls.__qualname__}"


def read_json(path: Path) -> Table:
    """A JSON file that holds one object.

    Raises: InputError where it is missing, cannot be read or is not JSON (with the place).
    """
    import json

    try:
        content = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise InputError(str(path), "must be a file", "nothing there", "check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), "must be readable text", str(error), "check the file") from None
    except json.JSONDecodeError as error:
        raise InputError(str(path), "must be JSON", str(error), "is the file complete?") from None
    return dict(_table(content, str(path)))


def read_toml(path: Path) -> Table:
    """A TOML file as nested tables.

    Raises: InputError where it is missing, cannot be read or is not TOML (with the line).
    """
    import tomllib

    try:
        return tomllib.loads(path.read_text("utf-8-sig"))
    except FileNotFoundError:
        raise InputError(str(path), "must be a file", "nothing there", "check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), "must be readable text", str(error), "check the file") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), "must be TOML", str(error), "mend that line") from None
