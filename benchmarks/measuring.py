"""How every benchmark measures: interleaved repeats, minima, ratios, the machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
from rich.console import Console
from rich.progress import track
from rich.table import Table

from jaxsim.provenance import provenance, write_json

# What is committed; `make bench` writes beside it and compare.py says what fell.
RESULTS = Path(__file__).parent / "results"
NEW = Path("results/bench")
Rows = list[dict[str, Any]]
REPEATS = 5
ENOUGH_S = 0.05


class Timing(NamedTuple):
    """first_s: with compilation. best_s: the least of the repeats, per call."""

    first_s: float
    best_s: float


def interleaved(
    calls: Mapping[str, Callable[[], Any]], repeats: int = REPEATS
) -> dict[str, Timing]:
    """Time calls in turns, so that a busy moment of the machine hits all of them alike.

    A call that takes less than ENOUGH_S is repeated inside one measurement.
    """
    first, often = {}, {}
    for name, call in calls.items():
        first[name] = _seconds(call, 1)
        often[name] = max(1, round(ENOUGH_S / max(_seconds(call, 1), 1e-6)))
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(repeats):
        for name, call in calls.items():
            best[name] = min(best[name], _seconds(call, often[name]))
    return {name: Timing(first[name], best[name]) for name in calls}


def _seconds(call: Callable[[], Any], often: int) -> float:
    begin = time.perf_counter()
    for _ in range(often):
        call()
    return (time.perf_counter() - begin) / often


def megabytes(program: Any, members: int) -> float:
    """What a compiled program sets aside for intermediate results, on all cores.

    The compiler tells it of one, and `jaxsim.batch` spreads so many members over several.
    """
    cores = min(jax.local_device_count(), max(2, members // 32))
    return program.memory_analysis().temp_size_in_bytes * cores / 1e6


def fingerprint() -> dict[str, Any]:
    """The machine as far as it matters to speed, and how busy it was."""
    return {
        "processor": _model(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "load_average_1_min": os.getloadavg()[0],
    }


def _model() -> str:
    """The name of the processor, and its widest vectors."""
    lines = Path("/proc/cpuinfo").read_text("ascii").splitlines() if os.name == "posix" else []
    values = dict(line.split(":", 1) for line in lines if ":" in line)
    named = {key.strip(): value.strip() for key, value in values.items()}
    flags = named.get("flags", "").split()
    widest = next((f for f in ("avx512f", "avx2", "avx") if f in flags), "")
    return f"{named.get('model name', platform.processor())} {widest}".strip()


def save(name: str, tables: Mapping[str, Rows], ratios: Mapping[str, float]) -> None:
    """Write results/bench/NAME.json. ratios: what runs are compared by, larger is better."""
    path = NEW / f"{name}.json"
    write_json(path, {"ratios": ratios, "tables": tables, **provenance(), "machine": fingerprint()})
    for title, rows in tables.items():
        show(f"{name}: {title}", rows)
    show(f"{name}: ratios", [{"ratio": key, "value": value} for key, value in ratios.items()])
    Console().print(f"Wrote {path}")


def show(title: str, rows: Rows) -> None:
    table = Table(title=title)
    for key in rows[0]:
        table.add_column(key, justify="left" if isinstance(rows[0][key], str) else "right")
    for row in rows:
        table.add_row(*(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()))
    Console().print(table)


def progress(items: Any, description: str) -> Any:
    """A bar over the cases of a benchmark."""
    return track(list(items), description=description)
