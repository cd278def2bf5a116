"""What the options that subcommands share mean: a study, a law, a scenario, values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jaxsim.errors import InputError, called
from jaxsim.study import Study, load, locate, with_values


def opened(
    study: str,
    *,
    law: str | None = None,
    scenario: str | None = None,
    change: Sequence[str] | None = None,
) -> Study:
    """The study of STUDY, --law, --scenario and --set.

    Raises: InputError under the name of the option that is wrong.
    """
    found = load(study, law=None if law is None else _path("--law", law))
    with called("--scenario"):
        found = found.in_scenario(scenario)
    try:
        return with_values(found, pairs(change or []))
    except InputError as error:
        raise error.called(f"--set {error.field}") from None


def law_of(study: str, option: str, name: str) -> Any:
    """The law in the file that an option names, for the drive of a study."""
    return load(study, law=_path(option, name)).law


def _path(option: str, name: str) -> str:
    return str(locate(name, field=option))


def pairs(changes: Sequence[str]) -> dict[str, Any]:
    """The values of NAME=VALUE, numbers where they are any."""
    values: dict[str, Any] = {}
    for text in changes:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError("--set", "must be NAME=VALUE", repr(text), "e.g. --set K_B=-0.5")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            values[name.strip()] = value.strip()
    return values
