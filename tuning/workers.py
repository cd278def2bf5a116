"""The calls of an evaluation, made by workers; the search itself stays where it is."""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import shutil
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxsim import scale
from tuning.problem import LANES, ROWS, Problem, Share


@contextlib.contextmanager
def sharing(where: scale.Where, folder: Path, *, resume: bool) -> Iterator[Share | None]:
    """Who makes the calls of a search: workers, whose chunks are kept in `folder`, or None."""
    if not resume:
        shutil.rmtree(folder, ignore_errors=True)  # of another search
    with scale.Team(where) as team:
        yield None if team.here else OnWorkers(team, folder)
    shutil.rmtree(folder, ignore_errors=True)


class _Job(NamedTuple):
    """An evaluation. problem: study and specification, pickled: a worker compiles them once."""

    problem: bytes
    points: np.ndarray
    drives: np.ndarray
    slopes: bool


class OnWorkers:
    """A `Share` for problems: each call is a chunk, kept until the next evaluation.

    So a search that was stopped in the middle of an evaluation goes on in its middle.
    """

    def __init__(self, team: scale.Team, folder: Path) -> None:
        self.team, self.folder = team, folder
        self._last: Path | None = None

    def __call__(
        self, problem: Problem, points: np.ndarray, drives: np.ndarray, *, slopes: bool
    ) -> list[list[np.ndarray]]:
        job = _Job(pickle.dumps((problem.study, problem.spec)), points, drives, slopes)
        folder = self.folder / _digest(problem, job)
        folder.mkdir(parents=True, exist_ok=True)
        chunks = problem.calls(points, drives, slopes=slopes)
        self.team.compute(work, job, chunks, folder)
        parts = [scale.read(folder, k) for k in range(chunks)]
        if self._last not in (None, folder):
            shutil.rmtree(self._last, ignore_errors=True)  # type: ignore[arg-type]
        self._last = folder
        return [[part[name] for name in _NAMES] for part in parts]


_NAMES = ("values", "slopes", "status")


def work(job: _Job, k: int) -> scale.Arrays:
    """One call."""
    found = _problem(job.problem).call(job.points, job.drives, k, slopes=job.slopes)
    return dict(zip(_NAMES, found, strict=True))


@lru_cache(maxsize=1)
def _problem(pickled: bytes) -> Problem:
    from jaxsim import configure

    configure()
    return Problem(*pickle.loads(pickled))


def _digest(problem: Problem, job: _Job) -> str:
    """Of the laws and drives; whose study they are is in the checkpoint beside."""
    seen = hashlib.sha256(
        str((LANES, ROWS, problem.metrics, problem.scenarios, job.slopes)).encode()
    )
    seen.update(np.ascontiguousarray(job.points).tobytes())
    seen.update(np.ascontiguousarray(problem.drives[job.drives]).tobytes())
    return seen.hexdigest()[:16]


__all__ = ["OnWorkers", "sharing"]
