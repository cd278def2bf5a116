"""Extension without registration: package folders are scanned for classes and presets."""

from __future__ import annotations

import functools
import importlib
import inspect
import pkgutil
import re
from typing import Any, NamedTuple

from jaxsim.errors import InputError


class Catalog(NamedTuple):
    """The public concrete subclasses of `base` ("module:Class") in the modules of `package`.

    With base None: the functions that are named as their module (presets).
    """

    kind: str
    package: str
    base: str | None

    def all(self) -> dict[str, Any]:
        return _scan(self.package, self.base)

    def names(self) -> list[str]:
        return sorted(self.all())

    def find(self, name: str) -> Any:
        if ":" in name:
            return _load(name)
        known = self.all()
        if name not in known:
            raise InputError.unknown(self.kind, name, known)
        return known[name]


def snake_case(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def _load(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


@functools.cache
def _scan(package: str, base: str | None) -> dict[str, Any]:
    found: dict[str, Any] = {}
    folder = importlib.import_module(package)
    kind = _load(base) if base else None
    for info in pkgutil.iter_modules(folder.__path__):
        module = importlib.import_module(f"{package}.{info.name}")
        if kind is None:
            found[info.name] = getattr(module, info.name)
            continue
        for name, member in vars(module).items():
            own = inspect.isclass(member) and member.__module__ == module.__name__
            if own and issubclass(member, kind) and not inspect.isabstract(member):
                found[snake_case(name)] = member
    return found


METRICS = Catalog("metrics", "jaxsim.metrics", "jaxsim.metric:Metric")
