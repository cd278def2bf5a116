"""What a comparison leaves behind: table.csv, comparison.json, plots, report.html."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim import components
from jaxsim.html import Picture, Section, Summary, Table, Text, write_html
from jaxsim.provenance import provenance, replace_text, write_json, write_toml
from jaxsim.run import Run
from rl import figures
from rl.classical import Tuned
from rl.comparison import TUNED, Entry, Line
from rl.nominal import JUDGED
from rl.study import Comparison

_AGENTS = 4  # drawn
_COMMAND = ("command_peak", "command_variation")


def head(lines: Sequence[Line]) -> list[str]:
    """The columns of table.csv."""
    metrics = [f"{key}, median" for key in lines[0].medians if key != "cost"]
    return [
        "law", "cost, median", "95 % interval", "of the tuned", "95 % interval", "failed %",
        "wins %", *metrics, "steps", "CPU s",
    ]  # fmt: skip


def cells(line: Line) -> list[Any]:
    """One line under `head`."""
    metrics = [value for key, value in line.medians.items() if key != "cost"]
    return [
        line.name,
        line.median,
        f"{line.low:.4g} to {line.high:.4g}",
        line.ratio,
        f"{line.ratio_low:.3g} to {line.ratio_high:.3g}",
        100.0 * line.failed,
        100.0 * line.wins["cost"],
        *metrics,
        line.steps,
        line.cpu,
    ]


def _wins(lines: Sequence[Line]) -> Table:
    metrics = list(lines[0].wins)
    rows = [
        [line.name, *(round(100.0 * line.wins[m], 1) for m in metrics)]
        for line in lines
        if line.name != TUNED
    ]
    caption = "Share of the episodes, %, in which the law has less of a metric than the tuned one."
    return Table(caption, ["law", *metrics], rows)


def _medians(lines: Sequence[Line]) -> Table:
    metrics = [key for key in lines[0].medians if key != "cost"]
    rows = [[line.name, *(line.medians[m] for m in metrics)] for line in lines]
    return Table("Medians of the metrics in the cost.", ["law", *metrics], rows)


def nominal_table(runs: Mapping[str, Run], unit: str) -> Table:
    """The metrics of the nominal case."""
    names = (*JUDGED[unit], *_COMMAND)
    rows = [[name, *(float(run.metrics[m]) for m in names)] for name, run in runs.items()]
    caption = (
        "The paper's drive and step, simulated with each law; of an agent the seed that was best "
        "on the validation episodes. Encoders, but neither noise nor delay."
    )
    return Table(caption, ["law", *names], rows)


def write(
    folder: Path,
    study: Comparison,
    entries: Sequence[Entry],
    lines: Sequence[Line],
    words: Sequence[str],
    found: Tuned,
    runs: Mapping[str, Run],
    unit: str,
) -> None:
    """All files of a comparison."""
    _write_numbers(folder, study, entries, lines, words, found, runs, unit)
    figures.costs(folder / "costs.png", entries, lines)
    signals = ("theta_L", "T_s", "command") if unit == "rad" else ("T_s", "command")
    figures.responses(folder / "responses.png", _drawn(lines, runs), signals)
    verdict, *rest = words
    mood = "good" if verdict.startswith("Learning pays") else "plain"
    tables = [_main_table(lines), _medians(lines), _wins(lines)]
    costs, learning, responses = _pictures(folder)
    sections = [
        Section("How it was compared", [Text(_about(study, found, list(runs)))]),
        Section("Random episodes", [*tables, costs, learning]),
        Section("Nominal case", [nominal_table(runs, unit), responses]),
    ]
    write_html(
        folder / "report.html",
        f"Comparison: {study.name}",
        Summary(verdict, rest, mood),
        sections,
        provenance(dtype="float32"),
    )


def _about(study: Comparison, found: Tuned, names: Sequence[str]) -> list[str]:
    """How it was compared, in words; names: of the laws, the tuned one after its original."""
    seeds = max(len(specs) for specs in study.agents.values())
    gains = ", ".join(f"{n} = {v:.4g}" for n, v in found.gains.items())
    return [
        f"{study.about}. {study.episodes} fresh episodes, the same for all, apart from those "
        f"that agents are trained and chosen on and from those that the law is tuned on; "
        f"{seeds} seeds per agent.",
        "Classical laws run continuously on exact signals. Agents read encoders every "
        "millisecond, with noise, and in half of the episodes one period late.",
        f"The tuned law has the structure of {names[names.index(TUNED) - 1]}, and the gains "
        f"{gains}, by CMA-ES on the median cost of 256 other episodes ({found.runs} runs).",
    ]


def _pictures(folder: Path) -> list[Picture]:
    captions = {
        "costs.png": "Cost of every episode and seed; the line is the tuned law's median.",
        "learning.png": "Learning curves: median cost of the validation episodes.",
        "responses.png": "Responses in the nominal case: the paper's law, the tuned one, and "
        f"the {_AGENTS} best agents at most.",
    }
    return [Picture(text, folder / name) for name, text in captions.items()]


def _drawn(lines: Sequence[Line], runs: Mapping[str, Run]) -> dict[str, Run]:
    """The runs that are drawn: more than six lie on top of each other."""
    before = list(runs).index(TUNED)
    agents = [line.name for line in lines if line.learned][:_AGENTS]
    return {name: runs[name] for name in (list(runs)[before - 1], TUNED, *agents)}


def _main_table(lines: Sequence[Line]) -> Table:
    caption = (
        "Cost: mean of its terms, each over the paper's law's in the nominal case. Median over "
        "seeds of the median over episodes; intervals (95 %) by bootstrap over seeds and episodes. "
        "Steps of control and CPU seconds per seed."
    )
    header = ["law", "cost", "interval", "of the tuned", "interval", "failed %", "wins %"]
    rows = []
    for line in lines:
        own = line.name == TUNED
        ratio = None if own else f"{line.ratio_low:.3f}–{line.ratio_high:.3f}"
        wins = None if own else round(100.0 * line.wins["cost"], 1)
        interval = f"{line.low:.3f}–{line.high:.3f}"
        cost = round(line.median, 3), interval, round(line.ratio, 3), ratio
        spent = (int(line.steps), int(line.cpu)) if line.steps else (None, None)
        rows.append([line.name, *cost, round(100.0 * line.failed, 2), wins, *spent])
    return Table(caption, [*header, "steps", "CPU s"], rows)


def _write_numbers(
    folder: Path, study: Comparison, entries: Sequence[Entry], lines: Sequence[Line],
    words: Sequence[str], found: Tuned, runs: Mapping[str, Run], unit: str,
) -> None:  # fmt: skip
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head(lines))
    writer.writerows(cells(line) for line in lines)
    replace_text(folder / "table.csv", text.getvalue())
    per_seed = {e.name: np.median(e.numbers["cost"], axis=1).tolist() for e in entries}
    nominal = nominal_table(runs, unit)
    content = {
        "study": study.name,
        "verdict": list(words),
        "lines": [line._asdict() for line in lines],
        "median_cost_per_seed": per_seed,
        "tuned": {"gains": found.gains, "cost": found.cost, "runs": found.runs, "cpu_s": found.cpu},
        "nominal": {r[0]: dict(zip(nominal.header[1:], r[1:], strict=True)) for r in nominal.rows},
        **provenance(dtype="float32"),
    }
    write_json(folder / "comparison.json", content)
    about = f"{TUNED} on {study.task}: median cost {found.cost:.6g} of the episodes of its tuning"
    write_toml(folder / "tuned_law.toml", {"law": components.dump(found.law)}, about)


__all__ = ["cells", "head", "write"]
