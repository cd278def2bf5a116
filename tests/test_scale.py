"""Chunks: the same to the bit whatever computes them, kept, and never computed twice."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsim import scale
from jaxsim.errors import InputError

CHUNKS = 12


def work(job: Path, k: int) -> scale.Arrays:
    """Random numbers of the chunk; leaves a mark of each time it was computed, and by whom."""
    (job / f"{k}-{os.getpid()}-{os.urandom(4).hex()}").touch()
    return {"values": np.random.default_rng([7, k]).normal(size=1000)}


def _computed(marks: Path) -> list[int]:
    return sorted(int(p.name.split("-")[0]) for p in marks.iterdir())


def _folders(tmp_path: Path, name: str) -> tuple[Path, Path]:
    marks, chunks = tmp_path / f"{name}-marks", tmp_path / name
    marks.mkdir()
    scale.prepare(chunks, {"seed": 7}, resume=False)
    return marks, chunks


def test_finished_chunks_are_not_computed_again(tmp_path: Path) -> None:
    marks, folder = _folders(tmp_path, "here")

    def stop(progress: scale.Progress) -> None:
        if progress.done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        scale.Team().compute(work, marks, CHUNKS, folder, tell=stop)
    assert _computed(marks) == list(range(5))
    seen: list[scale.Progress] = []
    scale.Team().compute(work, marks, CHUNKS, folder, tell=seen.append)
    assert _computed(marks) == list(range(CHUNKS))
    assert seen[0] == (5, CHUNKS)
    assert seen[-1] == (CHUNKS, CHUNKS)
    expected = [np.random.default_rng([7, k]).normal(size=1000) for k in range(CHUNKS)]
    np.testing.assert_array_equal(scale.gather(folder, CHUNKS, "values"), np.concatenate(expected))


def test_a_folder_belongs_to_one_plan(tmp_path: Path) -> None:
    scale.prepare(tmp_path / "chunks", {"seed": 1}, resume=False)
    with pytest.raises(InputError, match="--resume"):
        scale.prepare(tmp_path / "chunks", {"seed": 1}, resume=False)
    scale.prepare(tmp_path / "chunks", {"seed": 1}, resume=True)
    with pytest.raises(InputError, match="same study, values and seed"):
        scale.prepare(tmp_path / "chunks", {"seed": 2}, resume=True)


def test_a_scheduler_that_is_not_there_is_named(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    marks, folder = _folders(tmp_path, "nowhere")
    where = scale.Where(scheduler="nonsense")
    with pytest.raises(InputError, match="--scheduler: must answer; got nonsense"):
        scale.Team(where).compute(work, marks, 1, folder)


def test_every_drive_of_a_chunk_is_drawn_within_its_range() -> None:
    from jaxsim import montecarlo as mc
    from jaxsim.study import load

    study = load("bench_worst_case")
    job = mc.job_of(study, mc.ranges_of(study, {"half_gap": "30 %"}), 0)
    (gap,) = mc.draw(job, 3).values()
    assert gap.min() >= 0.7 * 7.8e-3
    assert gap.max() <= 1.3 * 7.8e-3
    assert gap.std() == pytest.approx(0.6 * 7.8e-3 / np.sqrt(12.0), rel=0.02)
    np.testing.assert_array_equal(gap, mc.draw(job, 3)["transmission.half_gap"])
    assert not np.array_equal(gap, mc.draw(job, 4)["transmission.half_gap"])
    for width in ("30", "-5 %", "x %", "100 %"):
        with pytest.raises(InputError, match="more than 0 %"):
            mc.ranges_of(study, {"half_gap": width})


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Dask's own, about workers that are lost
def test_a_killed_worker_changes_nothing_and_costs_nothing_finished(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    from jaxsim import montecarlo as mc
    from jaxsim.study import load

    study = load("bench_worst_case")
    job = mc.job_of(study, mc.ranges_of(study, {}), 0)
    here, there = tmp_path / "here", tmp_path / "there"
    scale.prepare(here, {}, resume=False)
    scale.Team().compute(mc.work, job, CHUNKS, here)
    marks = tmp_path / "marks"
    marks.mkdir()
    scale.prepare(there, {}, resume=False)
    finished: list[int] = []

    def kill(progress: scale.Progress) -> None:
        if progress.done == 3:
            finished.extend(int(p.stem) for p in there.glob("*.npz"))
            os.kill(int(next(iter(marks.iterdir())).name.split("-")[1]), signal.SIGKILL)

    where = scale.Where(workers=4)
    with scale.Team(where) as team:
        team.compute(marked, (job, marks), CHUNKS, there, tell=kill)
    computed = _computed(marks)
    assert len(finished) == 3
    assert all(computed.count(k) == 1 for k in finished)
    assert set(computed) == set(range(CHUNKS))
    for name in (*job.metrics, "status"):
        alone, spread = (scale.gather(f, CHUNKS, name) for f in (here, there))
        np.testing.assert_array_equal(alone, spread)


def marked(both: Any, k: int) -> scale.Arrays:
    """A chunk of a Monte Carlo, with a mark of who computes it."""
    from jaxsim import montecarlo as mc

    job, marks = both
    arrays = mc.work(job, k)
    (marks / f"{k}-{os.getpid()}-{os.urandom(4).hex()}").touch()
    return arrays
