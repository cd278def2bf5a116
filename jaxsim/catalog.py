"""Extension without registration: package folders are scanned for classes and presets.

A name stands for what the modules of a folder of this repository define (a new file is enough) or
what an installed package offers as entry point `gearlash.<kind>`; "module:Name" stands for
anything that can be imported (the command adds the current folder to the import path).
"""

from __future__ import annotations

import functools
import importlib
import inspect
import pkgutil
import re
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any, NamedTuple

from jaxsim.errors import InputError


class Catalog(NamedTuple):
    """The public concrete subclasses of `base` ("module:Class") in the modules of `package`.

    They are named in snake_case: SwitchedDamping is switched_damping. With base None: the
    functions that are named as their module (presets). Modules and classes with a leading
    underscore are left out. `kind` is for messages and names the entry points.
    """

    kind: str
    package: str
    base: str | None

    def all(self) -> dict[str, Any]:
        """Every name and what it stands for; where names collide, ours wins."""
        return _plugins(self.kind) | _scan(self.package, self.base)

    def names(self) -> list[str]:
        """Every name, sorted."""
        return sorted(self.all())

    def find(self, name: str) -> Any:
        """What a name or "module:Name" stands for.

        Raises: InputError for a name that is unknown, with the nearest ones, and for a
        "module:Name" that cannot be imported or is not of this kind.
        """
        if ":" in name:
            return self._import(name)
        known = self.all()
        if name not in known:
            raise InputError.unknown(self.kind, name, known)
        return known[name]

    def _import(self, path: str) -> Any:
        try:
            found = _load(path)
        except (ImportError, AttributeError, TypeError, ValueError) as error:
            raise InputError(
                self.kind,
                "module:Name must be importable",
                f"{path!r} ({error})",
                "check the spelling, and that the module is installed or in the current folder",
            ) from error
        if not _fits(found, self.base):
            rule = f"a concrete subclass of {self.base}" if self.base else "callable"
            raise InputError(self.kind, f"must be {rule}", repr(path), "name another one")
        return found


def snake_case(name: str) -> str:
    """PD -> pd, SwitchedDamping -> switched_damping, DCMotor -> dc_motor."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def _load(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def _fits(found: Any, base: str | None) -> bool:
    if base is None:
        return callable(found)
    concrete = inspect.isclass(found) and not inspect.isabstract(found)
    return concrete and issubclass(found, _load(base))


@functools.cache
def _plugins(kind: str) -> dict[str, Any]:
    return {point.name: point.load() for point in entry_points(group=f"gearlash.{kind}")}


@functools.cache
def _scan(package: str, base: str | None) -> dict[str, Any]:
    found: dict[str, Any] = {}
    folder = importlib.import_module(package)
    for info in pkgutil.iter_modules(folder.__path__):
        if info.name.startswith("_"):
            continue
        module = importlib.import_module(f"{package}.{info.name}")
        if base is None:
            found[info.name] = getattr(module, info.name)
        else:
            found |= {snake_case(c.__name__): c for c in _own_classes(module) if _fits(c, base)}
    return found


def _own_classes(module: ModuleType) -> list[type]:
    """The public classes that a module defines itself."""
    return [
        member
        for name, member in vars(module).items()
        if inspect.isclass(member)
        and member.__module__ == module.__name__
        and not name.startswith("_")
    ]


METRICS = Catalog("metrics", "jaxsim.metrics", "jaxsim.metric:Metric")
CRITERIA = Catalog("criteria", "jaxsim.criteria", "jaxsim.criterion:Criterion")
LAWS = Catalog("laws", "jaxsim.laws", "jaxsim.law:Control")
DRIVES = Catalog("drives", "jaxsim.drives", None)
DERIVATIVES = Catalog("derivatives", "jaxsim.derivatives", "jaxsim.derivative:Derivatives")
SIGNALS = Catalog("signals", "jaxsim.signals", "jaxsim.signal:Signal")
MOTORS = Catalog("motors", "jaxsim.motors", "jaxsim.drive:Motor")
TRANSMISSIONS = Catalog("transmissions", "jaxsim.transmissions", "jaxsim.drive:Transmission")
LOADS = Catalog("loads", "jaxsim.loads", "jaxsim.drive:Load")
