"""Fits in chunks that are kept on disk: here, or spread over workers."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxsim import scale
from tuning.identification.estimator import STAGES, Fits, Progress, Stage, fit
from tuning.identification.residuals import Problem
from tuning.identification.robust import Loss, Squares

# Runs of a worker's chunk: with fewer its vector lanes and cores lie idle.
_RUNS = 64


class _Job(NamedTuple):
    """All fits of one call, as `fit` takes them, and how many a chunk has."""

    problem: Problem
    starts: np.ndarray
    who: np.ndarray
    frozen: np.ndarray
    how: dict[str, Any]
    size: int

    def rows(self, k: int) -> slice:
        return slice(k * self.size, (k + 1) * self.size)


class _Stopped(KeyboardInterrupt):
    """Ctrl-C within a chunk, and where its fits were."""

    def __init__(self, fits: Fits) -> None:
        super().__init__()
        self.fits = fits


class Chunks:
    """`estimator.fit`, to be called like it, whose chunks of fits a team computes.

    A fit's numbers do not depend on those beside it, so neither do they on the chunks. Without
    workers all fits of a call are one chunk: they share every simulation.
    """

    def __init__(self, team: scale.Team, folder: Path) -> None:
        self.team, self.folder = team, folder

    def __call__(
        self, problem: Problem, starts: np.ndarray, *, who: np.ndarray | None = None,
        stages: Sequence[Stage] = STAGES, loss: Loss | None = None, iterations: int = 50,
        tolerance: float = 1e-9, frozen: np.ndarray | None = None,
        tell: Callable[[Progress], None] | None = None,
    ) -> Fits:  # fmt: skip
        starts = np.atleast_2d(starts)
        who = problem.everyone(len(starts)) if who is None else who
        frozen = np.zeros(starts.shape, bool) if frozen is None else frozen
        how = {"stages": tuple(stages), "loss": loss or Squares()}
        how |= {"iterations": iterations, "tolerance": tolerance}
        size = len(starts) if self.team.here else max(1, _RUNS // who.shape[1])
        size = min(size, len(starts))
        job = _Job(problem, starts, who, frozen, how, size)
        return self._computed(job, tell or (lambda progress: None))

    def _computed(self, job: _Job, tell: Callable[[Progress], None]) -> Fits:
        chunks = -(-len(job.starts) // job.size)
        mark = _digest(job)
        folder = self.folder / mark[:16]
        plan = {"fits": len(job.starts), "in a chunk": job.size, "digest": mark}
        scale.prepare(folder, plan, resume=True)
        stopped = None
        try:
            if chunks == 1:  # nothing to spread
                scale.Team().compute(_told(tell), job, 1, folder)
            else:
                job = job._replace(problem=job.problem.narrowed(job.size * job.who.shape[1]))
                said = _counted(job, folder, tell)
                self.team.compute(work, job, chunks, folder, tell=said)
        except KeyboardInterrupt as stop:
            stopped = stop
        return _joined(job, folder, chunks, stopped)


def work(job: _Job, k: int, tell: Callable[[Progress], None] | None = None) -> scale.Arrays:
    """One chunk of fits."""
    from jaxsim import configure

    configure()
    rows = job.rows(k)
    starts, who, frozen = (v[rows] for v in (job.starts, job.who, job.frozen))
    found = fit(job.problem, starts, who=who, frozen=frozen, tell=tell, **job.how)
    if found.interrupted:
        raise _Stopped(found)
    return {name: np.asarray(getattr(found, name)) for name in Fits._fields[:4]}


def _told(tell: Callable[[Progress], None]) -> Callable[[Any, int], scale.Arrays]:
    return lambda job, k: work(job, k, tell)


def _counted(
    job: _Job, folder: Path, tell: Callable[[Progress], None]
) -> Callable[[scale.Progress], None]:
    """What a spread call tells: the fits that are not done, and the lowest loss of those that are.

    Its iterations are chunks: what workers do inside one is not reported.
    """

    def said(p: scale.Progress) -> None:
        low = min((float(v["loss"].min()) for _, v in _finished(folder, p.total)), default=np.inf)
        left = max(0, len(job.starts) - p.done * job.size)
        tell(Progress(0, 1, p.done, left, low))

    return said


def _finished(folder: Path, chunks: int) -> Iterator[tuple[int, scale.Arrays]]:
    return ((k, scale.read(folder, k)) for k in range(chunks) if scale.is_there(folder, k))


def _joined(job: _Job, folder: Path, chunks: int, stopped: KeyboardInterrupt | None) -> Fits:
    """All fits; those that were not finished stay where they started, or where Ctrl-C met them.

    Raises: KeyboardInterrupt where not one has come anywhere.
    """
    count = len(job.starts)
    none = np.full(count, np.inf), np.zeros(count, bool), np.zeros(count, int)
    fits = Fits(job.starts.copy(), *none, interrupted=stopped is not None)
    parts = [(job.rows(k), v) for k, v in _finished(folder, chunks)]
    if isinstance(stopped, _Stopped):
        met = {name: getattr(stopped.fits, name) for name in Fits._fields[:4]}
        parts.append((slice(0, count), met))
    if not parts:
        raise KeyboardInterrupt from stopped
    for rows, arrays in parts:
        for name, values in arrays.items():
            getattr(fits, name)[rows] = values
    return fits


def _digest(job: _Job) -> str:
    """Of everything that the numbers depend on."""
    problem = job.problem
    seen = hashlib.sha256(
        repr((problem.unknowns.free, problem.dt, problem.exact, job.how, job.size)).encode()
    )
    trees = problem.models, problem.readings, job.starts, job.who, job.frozen, job.how
    for leaf in jax.tree.leaves(trees):
        seen.update(np.ascontiguousarray(leaf).tobytes())
    return seen.hexdigest()


__all__ = ["Chunks"]
