"""One computation in chunks: here, in processes of this machine, or on a cluster of Dask.

A chunk is numbered, its seed depends on its number alone, and its result is a file. So the result
is the same to the bit whatever the number of workers, a lost worker costs the chunks it was at,
and a computation that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import itertools
import json
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsim.errors import InputError
from jaxsim.provenance import keep_results, write_json

Arrays = dict[str, np.ndarray]
_PLAN = "plan.json"


class Where(NamedTuple):
    """Who computes: a Dask scheduler by its address, so many local processes, or (0) this one."""

    scheduler: str | None = None
    workers: int = 0


class Progress(NamedTuple):
    """Chunks that are done, those found on disk among them, and of how many."""

    done: int
    total: int


class Team:
    """Those who compute, for as many computations as there are; a context manager.

    Workers are started, or the scheduler is asked, when the first chunk is to be computed.
    """

    def __init__(self, where: Where | None = None) -> None:
        self.where = where or Where()
        self._client: Any = None
        self._open = contextlib.ExitStack()

    @property
    def here(self) -> bool:
        """Whether this process computes by itself."""
        return self.where.scheduler is None and self.where.workers == 0

    def compute(
        self,
        work: Callable[[Any, int], Arrays],
        job: Any,
        chunks: int,
        folder: Path,
        *,
        tell: Callable[[Progress], None] = lambda progress: None,
    ) -> None:
        """`work(job, k)` for every chunk k, each result kept in `folder` as soon as it is there.

        work: a function of a module, named arrays from the job and the number of a chunk alone; on
        workers it is imported, so they need the same version of everything. job: anything that can
        be pickled. Chunks in the folder are not computed again: `prepare` says whose they are.

        Raises: InputError where the scheduler does not answer or the extra `scale` is missing.
        """
        missing = [k for k in range(chunks) if not is_there(folder, k)]
        tell(Progress(chunks - len(missing), chunks))
        with contextlib.closing(self._results(work, job, missing)) as results:
            for done, (k, arrays) in enumerate(results, chunks - len(missing) + 1):
                _write(_file(folder, k), arrays)
                tell(Progress(done, chunks))

    def _results(
        self, work: Callable[[Any, int], Arrays], job: Any, missing: list[int]
    ) -> Generator[tuple[int, Arrays], None, None]:
        """Number and arrays of each chunk, in the order in which they are ready."""
        if self.here:
            for k in missing:
                yield k, work(job, k)
        elif missing:
            if self._client is None:
                self._client = self._open.enter_context(_client(self.where))
            yield from _spread(self._client, work, job, missing)

    def __enter__(self) -> Team:
        return self

    def __exit__(self, *_: object) -> None:
        self._client = None
        self._open.close()


def prepare(folder: Path, plan: Any, *, resume: bool) -> None:
    """Make a folder for the chunks of a plan, or check that it holds those of this very plan.

    Raises: InputError for chunks without `resume`, and for those of another plan.
    """
    folder.mkdir(parents=True, exist_ok=True)
    mark = hashlib.sha256(json.dumps(plan, sort_keys=True, default=_listed).encode()).hexdigest()
    file = folder / _PLAN
    if file.exists():
        if not resume:
            keep_results("--out", file, resumes=True)
        if json.loads(file.read_text("utf-8"))["mark"] != mark:
            rule = "must go on with the same study, values and seed"
            raise InputError("--resume", rule, str(folder.parent), "name another folder")
    write_json(file, {"mark": mark, "plan": json.loads(json.dumps(plan, default=_listed))})


def is_there(folder: Path, k: int) -> bool:
    """Whether a chunk is finished."""
    return _file(folder, k).exists()


def read(folder: Path, k: int) -> Arrays:
    """The named arrays of one chunk."""
    with np.load(_file(folder, k)) as stored:
        return dict(stored)


def gather(folder: Path, chunks: int, name: str) -> np.ndarray:
    """One named array of all chunks, in their order."""
    parts = []
    for k in range(chunks):
        with np.load(_file(folder, k)) as stored:
            parts.append(stored[name])
    return np.concatenate(parts)


def _listed(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _file(folder: Path, k: int) -> Path:
    return folder / f"{k:06d}.npz"


def _write(path: Path, arrays: Arrays) -> None:
    """Beside and renamed: a chunk that is there is whole."""
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    beside = path.with_suffix(".part")
    beside.write_bytes(content.getvalue())
    beside.replace(path)


def _spread(
    client: Any, work: Callable[[Any, int], Arrays], job: Any, missing: list[int]
) -> Iterator[tuple[int, Arrays]]:
    """Over the workers. Dask gives the chunks of a lost worker to others.

    At most a few chunks per worker are under way, so that a result waits in the memory of a
    worker, where it could be lost, for as short as can be.
    """
    from distributed import as_completed

    waiting = iter(missing)
    numbers: dict[Any, int] = {}

    def submit(k: int) -> Any:
        future = client.submit(work, job, k, pure=False, retries=2)
        numbers[future.key] = k
        return future

    abreast = 2 * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    ready = as_completed(map(submit, itertools.islice(waiting, abreast)), with_results=True)
    for future, arrays in ready:
        following = next(waiting, None)
        if following is not None:
            ready.add(submit(following))
        k = numbers.pop(future.key)
        future.release()  # Dask computes again what a lost worker held and somebody still wants
        yield k, arrays


@contextlib.contextmanager
def _client(where: Where) -> Iterator[Any]:
    """A client of the scheduler, or of a cluster of this machine that ends with it."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        fix = 'pip install "gearlash[scale]"'
        raise InputError("--workers", "needs Dask", "not installed", fix) from None
    if where.scheduler is not None:
        try:
            client = Client(where.scheduler, timeout=10)
        except (OSError, ValueError, TimeoutError):
            fix = "is `dask scheduler` running there?"
            raise InputError("--scheduler", "must answer", where.scheduler, fix) from None
        with client:
            yield client
        return
    # One thread each: JAX brings its own. No dashboard: nothing listens that nobody asked for.
    options: Any = {"threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with LocalCluster(n_workers=where.workers, **options) as cluster, Client(cluster) as client:
        yield client


__all__ = ["Progress", "Team", "Where", "gather", "is_there", "prepare", "read"]
