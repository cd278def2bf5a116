"""gearlash watch: wear from a sequence of logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file with [identify], logs in their order.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
) -> None:
    """Fit each log of one axis by itself and report what changes: half gap, friction, ...

    Limits are in [identify.watch]: half_gap = "9 mrad". Exit 2 when one raises an alarm.
    """
    from rich.console import Console
    from rich.table import Table

    from jaxsim import configure, load
    from jaxsim.provenance import keep_results, make_folder
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
    _write(seen, out)
    table = Table("unknown", "first", "last", "per log", "+-", "chance", "alarm")
    for t in seen.trends:
        numbers = (f"{v:.4g}" for v in (t.values[0], t.values[-1], t.slope, t.slope_deviation))
        table.add_row(f"{t.name} ({t.unit})", *numbers, f"{t.p:.2g}", t.alarm or "none")
    console.print(table)
    for name in seen.failed:
        console.print(f"{name}: no fit", markup=False, style="yellow")
    console.print(f"Wrote watch.csv, watch.png, result.json: {out}", markup=False)
    if any(t.alarm for t in seen.trends):
        raise typer.Exit(2)


def _write(seen: Any, out: Path) -> None:
    from jaxsim.provenance import provenance, write_json
    from tuning.identification.report import write_csv

    head = ["log", *(f"{t.name}{more} [{t.unit}]" for t in seen.trends for more in ("", " error"))]
    rows = [
        (log, *(v for t in seen.trends for v in (t.values[i], t.deviation[i])))
        for i, log in enumerate(seen.logs)
    ]
    write_csv(out / "watch.csv", head, rows)
    trends = [t._asdict() for t in seen.trends]
    content = {"logs": seen.logs, "failed": seen.failed, "trends": trends}
    write_json(out / "result.json", content | provenance())
    _draw(seen, out / "watch.png")


def _draw(seen: Any, path: Path) -> None:
    import numpy as np

    from jaxsim.plots import COLOURS, figure

    with figure(path, len(seen.trends), sharex=True, squeeze=False) as axes:
        for ax, t in zip(axes[:, 0], seen.trends, strict=True):
            at = np.arange(len(seen.logs))
            ax.errorbar(at, t.values, 1.96 * t.deviation, fmt="o", markersize=4, capsize=3)
            good = np.isfinite(t.values)
            if np.isfinite(t.slope):
                weight = 1.0 / t.deviation[good] ** 2
                middle = np.average(at[good], weights=weight)
                mean = np.average(t.values[good], weights=weight)
                ax.plot(at, mean + t.slope * (at - middle), color="0.4", linewidth=1.0)
            if np.isfinite(t.limit):
                ax.axhline(t.limit, color=COLOURS["limit"], linestyle="--", label="limit")
                ax.legend()
            ax.set_ylabel(f"{t.name} [{t.unit}]")
        axes[0, 0].set_title("Log by log, with 95 % intervals")
        axes[-1, 0].set_xticks(np.arange(len(seen.logs)), seen.logs, rotation=30, ha="right")
