"""Trainings under one progress bar."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any


def train_under_a_bar(trainings: Sequence[Any], folder: Path, where: Any, console: Any) -> None:
    """All of them, in units of trainings."""
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from jaxsim.scale import Team
    from rl.trainings import train_all

    columns = (
        TextColumn("trainings"),
        BarColumn(bar_width=16),
        TextColumn("{task.completed:.1f} of {task.total}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[shown]}"),
    )
    shares = dict.fromkeys((name for name, _ in trainings), 0.0)
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("", total=len(shares), shown="compiling")

        def tell(name: str, spec: Any, row: Any) -> None:
            shares[name] = 1.0 if row is None else min(row.done / spec.total, 1.0)
            shown = f"{name}: " + ("there already" if row is None else f"cost {row.cost:.4g}")
            bar.update(task, completed=sum(shares.values()), shown=shown)

        with Team(where) as team:
            train_all(trainings, folder, tell, team)
