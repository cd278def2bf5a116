"""`gearlash import-gains`: the present gains of a real axis as a law."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    sheet: Annotated[Path, typer.Argument(help="CSV (name, value, unit) or TOML.")],
    law: Annotated[str, typer.Option(help="Study whose law takes the gains: file or name.")],
    out: Annotated[Path, typer.Option(help="The law's file, for --law of other commands.")],
    rename: Annotated[
        list[str] | None, typer.Option("--map", help="DRIVE_NAME=PARAMETER; repeat.")
    ] = None,
) -> None:
    """Take the gains of a drive's parameter sheet, with their units, into a law."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim.components import dump
    from jaxsim.errors import InputError
    from jaxsim.gain_sheet import import_gains
    from jaxsim.provenance import keep_results, provenance, write_toml
    from jaxsim.study import load

    keep_results("--out", out)
    names = {}
    for text in rename or []:
        name, equals, parameter = text.partition("=")
        if not equals or not parameter:
            raise InputError("--map", "must be DRIVE_NAME=PARAMETER", repr(text), "e.g. Kv=K_D")
        names[name.strip()] = parameter.strip()
    found = import_gains(load(law).law, sheet, names)
    head = f"Gains of {sheet.name} in the law of {law}."
    write_toml(out, {"law": dump(found.law), "provenance": provenance()}, head)
    console = Console()
    for path, entry in found.taken.items():
        console.print(f"{path} = {entry.value:g} {entry.unit} ({entry.name})", soft_wrap=True)
    console.print(f"kept from {law}: {', '.join(found.kept) or 'nothing'}", soft_wrap=True)
    console.print(f"not in the law: {', '.join(found.ignored) or 'nothing'}", soft_wrap=True)
    console.print(f"Wrote {out}")
