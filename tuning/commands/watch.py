"""gearlash watch: wear from a sequence of logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file with [identify], logs in their order.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
) -> None:
    """Fit each log of one axis by itself and report what changes: half gap, friction, ...

    Limits are in [identify.watch]: half_gap = "9 mrad". Writes watch.csv, result.json, watch.png
    and report.html. Exit 0: no alarm. 1: an alarm. 3: no alarm, but logs had no fit, or speak
    against the model.
    """
    from rich.console import Console
    from rich.table import Table

    from jaxsim import configure, load
    from jaxsim.provenance import keep_results, make_folder
    from tuning.identification import watch_page
    from tuning.identification.spec import read_spec
    from tuning.identification.watch import watch

    configure()
    what = load(study)
    spec = read_spec(what)
    keep_results("--out", out / "result.json")
    make_folder("--out", out)
    console = Console()
    with console.status("Fitting every log ..."):
        seen = watch(what, spec)
        watch_page.write(what, seen, out)
    name, unit, *columns = watch_page.TRENDS[:-2]  # the limit is told where it matters
    table = Table(f"{name}, {unit}", *columns)
    for name, unit, *numbers in (row[:-2] for row in watch_page.rows(seen)):
        told = ("-" if v is None else f"{v:.3g}" for v in numbers)
        table.add_row(f"{name}, {unit}", *told)
    console.print(table)
    for line in watch_page.sentences(seen):
        console.print(line, markup=False)
    console.print(f"Wrote watch.csv, watch.png, result.json, report.html: {out}", markup=False)
    if any(t.alarm for t in seen.trends):
        raise typer.Exit(1)
    if seen.failed or seen.doubts:
        raise typer.Exit(3)
