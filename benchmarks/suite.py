"""All benchmarks one after the other, a chart of them, and what fell since the committed run.

    python benchmarks/suite.py [NAME ...]

About half an hour on two idle cores. A benchmark that fails is named at the end; the others run.
The exit code is 1 where one failed or a ratio fell (compare.py). To commit a run, copy
results/bench/*.json to benchmarks/results.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import chart
import compare
import measuring
from rich.console import Console

HERE = Path(__file__).parent
SUITE = (
    "throughput", "arm", "equal_accuracy", "peers", "gradients_cost", "growth", "million",
    "cold_start", "environments", "evaluation",
)  # fmt: skip


def main(names: Sequence[str]) -> int:
    console, failed = Console(), []
    chosen = names or SUITE
    for i, name in enumerate(chosen, 1):
        console.rule(f"{i} of {len(chosen)}: {name}")
        begin = time.perf_counter()
        done = subprocess.run([sys.executable, str(HERE / f"{name}.py")], check=False)
        console.print(f"{name}: {time.perf_counter() - begin:.0f} s")
        if done.returncode:
            failed.append(name)
    console.rule("chart and comparison")
    picture = measuring.NEW / "bench.png"
    chart.draw(measuring.NEW, picture)
    console.print(f"Wrote {picture}")
    code = compare.main([])
    if failed:
        console.print(f"Failed: {', '.join(failed)}", style="bold red")
    return 1 if failed else code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
