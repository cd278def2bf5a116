"""One million drives x 0.3 s, exact mode: time, peak memory, the worst drives.

`gearlash montecarlo bench_worst_case` in a process of its own; compilation, chunks on disk, tables
and page are in the time.
"""

from __future__ import annotations

import csv
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import measuring

DRIVES = 1_000_000


def main() -> None:
    gearlash = str(Path(sys.executable).with_name("gearlash"))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "many"
        command = [gearlash, "montecarlo", "bench_worst_case", "--drives", str(DRIVES)]
        begin = time.perf_counter()
        subprocess.run([*command, "--out", str(out)], check=True)
        spent = time.perf_counter() - begin
        # Linux counts in kB, macOS in bytes.
        unit = 1e6 if sys.platform == "darwin" else 1e3
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / unit
        tables = {"quantiles": _read(out / "quantiles.csv"), "worst": _read(out / "worst.csv")}
    rows = [{"drives": DRIVES, "s": spent, "peak_MB": peak, "cores": os.cpu_count()}]
    measuring.save("million", {"run": rows, **tables}, {"2 GB over peak": 2000.0 / peak})


def _read(path: Path) -> list[dict[str, Any]]:
    with path.open(encoding="utf-8", newline="") as file:
        return [{k: _number(v) for k, v in row.items()} for row in csv.DictReader(file)]


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


if __name__ == "__main__":
    main()
