"""What fell: ratios of the newest run against the committed ones.

    python benchmarks/compare.py [NEW [COMMITTED]]

Every ratio is one side of a run over another of the same run, larger is better; so runs on other
machines, or on a busy one, can be compared as far as that goes. Exit code 1 where one has fallen by
more than 20 %.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import measuring

MOST = 0.20


class Fall(NamedTuple):
    """A ratio that fell, or (new is None) that was not measured although its benchmark ran."""

    benchmark: str
    ratio: str
    committed: float
    new: float | None

    @property
    def words(self) -> str:
        where = f"{self.benchmark}: {self.ratio}"
        if self.new is None:
            return f"{where}: {self.committed:.4g}, now missing"
        return (
            f"{where}: {self.committed:.4g}, now {self.new:.4g} ({self.new / self.committed:.0%})"
        )


def ratios(folder: Path) -> dict[str, dict[str, float]]:
    """Benchmark -> name -> ratio, of all result files in a folder."""
    files = sorted(folder.glob("*.json"))
    found = {file.stem: json.loads(file.read_text("utf-8")) for file in files}
    return {name: run["ratios"] for name, run in found.items() if "ratios" in run}


def fallen(new: Path, committed: Path) -> list[Fall]:
    """Ratios that fell by more than MOST; benchmarks that did not run are left out."""
    found = []
    now = ratios(new)
    for benchmark, before in ratios(committed).items():
        for name, value in before.items() if benchmark in now else ():
            there = now[benchmark].get(name)
            if there is None or there < (1.0 - MOST) * value:
                found.append(Fall(benchmark, name, value, there))
    return found


def main(arguments: Sequence[str]) -> int:
    folders = [Path(name) for name in arguments]
    new, committed = [*folders, *(measuring.NEW, measuring.RESULTS)[len(folders) :]]
    seen = ratios(new).keys() & ratios(committed).keys()
    if not seen:
        print(f"Nothing to compare: {new} and {committed} have no benchmark in common.")
        return 1
    found = fallen(new, committed)
    for fall in found:
        print(fall.words)
    print(f"{len(found)} ratios of {', '.join(sorted(seen))} fell by more than {MOST:.0%}.")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
