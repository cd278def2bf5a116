"""A law on a great many drives: drawn per chunk, kept on disk, told in quantiles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim import batch, tree
from jaxsim._simulate import simulate
from jaxsim.catalog import METRICS
from jaxsim.components import dump
from jaxsim.errors import InputError, called
from jaxsim.scale import Arrays, gather
from jaxsim.study import Study

# Half a second of work on a core: small enough to lose, large enough to fill every vector lane.
CHUNK = 8192
QUANTILES = (0.0, 0.01, 0.05, 0.5, 0.95, 0.99, 0.999, 1.0)


class Range(NamedTuple):
    """A parameter of the drive, by path, that is uniform between two values in SI units."""

    path: str
    lower: float
    upper: float


class Job(NamedTuple):
    """What every worker needs: the parts of a study, what varies, and which metrics to keep."""

    drive: Any
    law: Any
    scenario: Any
    dt: float
    deadzone: Any
    dtype: str
    metrics: tuple[str, ...]
    ranges: tuple[Range, ...]
    seed: int


class Row(NamedTuple):
    """A metric over all drives: its mean, quantiles, and the drive that is worst (largest |v|)."""

    metric: str
    mean: float
    quantiles: tuple[float, ...]
    worst: float
    drive: int
    values: dict[str, float]


def ranges_of(study: Study, given: dict[str, str]) -> tuple[Range, ...]:
    """Plus and minus so many percent around the drive's own values.

    given: parameter -> "30 %"; where it is empty, what the study's [tune.drives] spreads.
    Raises: InputError for parameters or widths that are none, and where nothing varies.
    """
    spread = given or study.section("tune").get("drives", {}).get("spread", {})
    if not spread:
        fix = 'e.g. --vary "half_gap=30 %"'
        raise InputError("--vary", "must name what differs from drive to drive", "none", fix)
    return tuple(_range(study, name, str(width)) for name, width in spread.items())


def _range(study: Study, name: str, width: str) -> Range:
    with called("--vary"):
        path = tree.resolve(study.drive, name)
    nominal = float(np.asarray(tree.get(study.drive, path)))
    number = width.strip().removesuffix("%").strip()
    try:
        share = float(number) / 100.0
    except ValueError:
        share = float("nan")
    if not width.strip().endswith("%") or not 0.0 < share < 1.0:
        raise InputError(f"--vary {name}", "must be more than 0 % and less than 100 %", width,
                         f'e.g. "{name}=30 %"')  # fmt: skip
    edges = sorted((nominal * (1.0 - share), nominal * (1.0 + share)))
    return Range(path, *edges)


def job_of(study: Study, ranges: tuple[Range, ...], seed: int) -> Job:
    """The study as its workers need it; the metrics are those of its objective, else all."""
    every = tuple(v for group in METRICS.all().values() for v in group.values)
    metrics = study.objective.metrics() if study.objective else every
    run = study.run
    return Job(
        study.drive, study.law, study.scenario, run.dt, run.deadzone, run.dtype, tuple(metrics),
        ranges, seed,
    )  # fmt: skip


def plan_of(study: Study, job: Job, drives: int) -> dict[str, Any]:
    """What makes two computations the same one."""
    return {
        "drives": drives,
        "chunk": CHUNK,
        "seed": job.seed,
        "ranges": {r.path: [r.lower, r.upper] for r in job.ranges},
        "metrics": job.metrics,
        "drive": dump(study.drive),
        "law": dump(study.law),
        "scenario": repr(job.scenario),
        "study": json.loads(json.dumps(study.table, default=str)),
    }


def chunks_of(drives: int) -> int:
    return -(-drives // CHUNK)


def draw(job: Job, k: int) -> dict[str, np.ndarray]:
    """The values of a chunk's drives, by path: of the seed and the number of the chunk alone."""
    random = np.random.default_rng([job.seed, k])
    unit = random.random((len(job.ranges), CHUNK))
    pairs = zip(job.ranges, unit, strict=True)
    return {r.path: r.lower + (r.upper - r.lower) * u for r, u in pairs}


def work(job: Job, k: int) -> Arrays:
    """The metrics and the status of the drives of one chunk; every chunk is whole.

    The last one is cut by its reader: one of another size would be compiled afresh.
    """
    import jaxsim

    jaxsim.configure()
    run = simulate(
        batch.spread(job.drive, **draw(job, k)),
        job.law,
        job.scenario,
        dt=job.dt,
        deadzone=job.deadzone,
        metrics=job.metrics,
        store=None,
        dtype=job.dtype,
        throw=False,
    )
    arrays = {name: np.asarray(v) for name, v in run.metrics.items()}
    return arrays | {"status": np.asarray(run.status)}


def table(job: Job, folder: Path, drives: int) -> tuple[list[Row], dict[int, int]]:
    """Per metric (and axis) its row, and how often each status other than OK, from the chunks.

    Exact quantiles, one metric in memory at a time. Drives that did not complete are left out of
    the rows and counted.
    """
    chunks = chunks_of(drives)
    status = gather(folder, chunks, "status")[:drives]
    codes, counts = np.unique(status[status != 0], return_counts=True)
    rows = []
    for name in job.metrics:
        values = gather(folder, chunks, name)[:drives].reshape(drives, -1).astype(float)
        values[status != 0] = np.nan
        for axis, column in enumerate(values.T):
            label = f"{name}[{axis}]" if values.shape[1] > 1 else name
            rows.append(_row(job, label, column))
    return rows, {int(c): int(n) for c, n in zip(codes, counts, strict=True)}


def _row(job: Job, name: str, values: np.ndarray) -> Row:
    sizes = np.where(np.isnan(values), -1.0, np.abs(values))
    drive = int(np.argmax(sizes))
    if sizes[drive] < 0.0:
        none = float("nan")
        return Row(name, none, (none,) * len(QUANTILES), none, -1, {})
    own = {path: float(v[drive % CHUNK]) for path, v in draw(job, drive // CHUNK).items()}
    quantiles = tuple(np.nanquantile(values, QUANTILES).tolist())
    return Row(name, float(np.nanmean(values)), quantiles, float(values[drive]), drive, own)


__all__ = ["CHUNK", "Job", "Range", "Row", "chunks_of", "draw", "job_of", "plan_of", "ranges_of",
           "table", "work"]  # fmt: skip
