"""What a tuning run shows on the screen at its end."""

from __future__ import annotations

from typing import Any

import numpy as np

from tuning.report import lines
from tuning.result import Result
from tuning.session import Session
from tuning.words import at_bound


def tables(session: Session, result: Result) -> list[Any]:
    """Gains, and metrics before and after."""
    return [_gains_table(session, result), _metrics_table(session, result)]


def _gains_table(session: Session, result: Result) -> Any:
    from rich.table import Table

    shown = Table(title="Gains", title_justify="left")
    shown.add_column("gain")
    for column in ("before", "after"):
        shown.add_column(column, justify="right")
    shown.add_column("bounds")
    rows = zip(session.spec.free, result.initial, result.gains, strict=True)
    for f, before, after in rows:
        at = " (at a bound)" if at_bound(f, after) else ""
        unit = "" if f.unit == "1" else f" {f.unit}"
        bounds = f"{f.lower:g} to {f.upper:g}{unit}{at}"
        shown.add_row(f.name, f"{before:.6g}", f"{after:.6g}", bounds)
    return shown


def _metrics_table(session: Session, result: Result) -> Any:
    from rich import box
    from rich.table import Table

    count = len(session.problem.scenarios)
    where = f" in {count} scenarios" if count > 1 else ""
    drives = f"{len(result.drives)} drives" if len(result.drives) > 1 else "the drive"
    title = f"On {drives}{where}"
    shown = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown.add_column("metric", no_wrap=True)
    for when in ("before", "after"):
        for what in ("nominal", "mean", "worst"):
            shown.add_column(f"{when}\n{what}", justify="right", no_wrap=True)
    objective = session.problem.metrics
    for name, pair in lines(session, result).items():
        values = [v for line in pair for v in line[:3]]
        if np.isnan(values).all():
            continue  # this study has no such quantity
        style = "bold" if name in objective else None
        last = name == objective[-1]
        shown.add_row(name, *map(_number, values), style=style, end_section=last)
    return shown


def _number(value: float) -> str:
    """Three digits in at most eight characters."""
    if not np.isfinite(value):
        return "-" if np.isnan(value) else "never"
    if value == 0.0 or 1e-2 <= abs(value) < 1e4:
        return f"{value:.3f}" if abs(value) < 10.0 else f"{value:.4g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"
