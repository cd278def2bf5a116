"""`gearlash doctor`: is this machine used as it could be?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    out: Annotated[Path | None, typer.Option(help="File for the findings, JSON.")] = None,
) -> None:
    """Say what is in force (options, cores, cache, precision), time a run, say what to mend."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim.doctor import as_table, examine
    from jaxsim.provenance import keep_results, provenance, write_json

    if out is not None:
        keep_results("--out", out)
    console = Console()
    with console.status("Looking, and timing for two seconds ..."):
        findings = examine()
    console.print(as_table(findings))
    versions = ", ".join(f"{n} {v}" for n, v in provenance()["versions"].items())
    console.print(f"{versions}; {provenance()['machine']}")
    if out is not None:
        rows = [one._asdict() for one in findings]
        write_json(out, {"findings": rows, **provenance()})
        console.print(f"Wrote {out}")
    if any(one.todo for one in findings):
        raise typer.Exit(1)
