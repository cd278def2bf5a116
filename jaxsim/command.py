"""The `gearlash` command: its subcommands are entry points, loaded only when they are called."""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.util
import os
import platform
import sys
import warnings
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from jaxsim.errors import InputError

GROUP = "gearlash.commands"
# Markdown leaves units such as [rad] in help texts alone; rich's own markup takes them for styles.
LOOK: dict[str, Any] = {
    "rich_markup_mode": "markdown",
    "add_completion": False,
    "pretty_exceptions_enable": False,
}
SHOWN = ("gearlash", "jax", "jaxlib", "equinox", "optimistix", "numpy", "scipy")


class Subcommands(TyperGroup):
    """The entry points of GROUP. Listing them imports none of them; calling imports one.

    The annotations are loose because newer versions of typer carry a private copy of click: its
    types cannot be named here, and those of click itself are no longer the same.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        return sorted(_entry_points())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """What a listing shows of a subcommand: name and summary."""
        point = _entry_points().get(cmd_name)
        return point and TyperCommand(cmd_name, help=_summary(point))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The subcommand itself, for a call."""
        points, (name, *rest) = _entry_points(), args
        if name not in points:
            raise InputError.unknown("command", name, points)
        return name, _load(points[name]), rest

    def invoke(self, ctx: Any) -> Any:
        """A person's mistake is one line, not a traceback; everything else is a bug and is one."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            _complain(f"error: {error}")
            raise typer.Exit(2) from None
        except KeyboardInterrupt:
            _complain("interrupted")
            raise typer.Exit(130) from None


def _entry_points() -> dict[str, EntryPoint]:
    return {point.name: point for point in importlib.metadata.entry_points(group=GROUP)}


def _load(point: EntryPoint) -> Any:
    target = point.load()
    one = typer.Typer(**LOOK)
    one.command(point.name)(getattr(target, "command", target))
    return get_command(one)


def _summary(point: EntryPoint) -> str:
    """The first line of the docstring, read from the source: an import may take seconds."""
    wanted = point.attr or "command"
    for node in ast.parse(_source(point.module)).body:
        if isinstance(node, ast.FunctionDef) and node.name == wanted:
            return (ast.get_docstring(node) or "").partition("\n")[0]
    return ""


def _source(module: str) -> str:
    """The source of a module, found without running it or its packages; "" if there is none."""
    name, *rest = module.split(".")
    spec = importlib.util.find_spec(name)
    for part in rest:
        name = f"{name}.{part}"
        spec = spec and PathFinder.find_spec(name, spec.submodule_search_locations)
    get_source = getattr(spec and spec.loader, "get_source", None)
    return (get_source and get_source(name)) or ""


def _warn(message: Any, *_: Any) -> None:
    """In place of Python's own format, which shows a line of our source."""
    _complain(f"warning: {message}", "yellow")


def _complain(message: str, style: str = "red") -> None:
    from rich.console import Console
    from rich.text import Text

    # Text, so that brackets in values are no markup; soft, so that it stays one line.
    Console(stderr=True).print(Text(message, style=style), soft_wrap=True)


def _print_versions(wanted: bool) -> None:
    if not wanted:
        return
    for name in SHOWN:
        typer.echo(f"{name} {importlib.metadata.version(name)}")
    typer.echo(f"python {platform.python_version()}")
    raise typer.Exit


app = typer.Typer(cls=Subcommands, no_args_is_help=True, **LOOK)


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_versions, is_eager=True, help="Print versions and exit."
        ),
    ] = False,
) -> None:
    """Simulate, tune, identify and learn to control geared drives with backlash."""


def main() -> None:
    """Run the command."""
    # For a person's own laws and drives, "module:Name" in a study file; last, so it hides nothing.
    sys.path.append(os.getcwd())
    warnings.showwarning = _warn
    app(prog_name="gearlash")
