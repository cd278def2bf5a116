"""Many trainings: one after the other here, or one task each on workers."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim import scale
from rl import store
from rl.session import Session
from rl.spec import APGSpec, SB3Spec
from rl.store import Row

Spec = APGSpec | SB3Spec
Named = tuple[str, Spec]
# Told after a validation; row None where the training is there already.
Tell = Callable[[str, Spec, Row | None], None]


def train_all(
    trainings: Sequence[Named], folder: Path, tell: Tell, team: scale.Team | None = None
) -> None:
    """Every training that is not complete yet, each into its own folder by name.

    Here, one that was stopped goes on. A worker trains from the start to the end and its folder,
    without the checkpoint, comes back: one that is lost costs the trainings it was at.

    Raises: InputError where a folder holds a training of another spec.
    """
    todo = []
    for name, spec in trainings:
        if (folder / name / "state.json").exists():
            store.check_same(folder / name, spec)
        if (folder / name / "result.json").exists():
            tell(name, spec, None)
        else:
            todo.append((name, spec))
    if team is not None and not team.here:
        _spread(team, todo, folder, tell)
        return
    for name, spec in todo:
        train(spec, folder / name, lambda row, name=name, spec=spec: tell(name, spec, row))


def train(spec: Spec, folder: Path, tell: Callable[[Row], None]) -> None:
    """One training to its end and its result; goes on where it was stopped."""
    folder.mkdir(parents=True, exist_ok=True)
    session = Session(spec, folder, resume=(folder / "state.json").exists())
    session.run(tell)
    store.write_result(folder, spec, session.rows, session.test())


def work(todo: Sequence[Named], k: int) -> scale.Arrays:
    """One training: the files of its folder, as bytes."""
    import jaxsim

    jaxsim.configure(x64=False)
    with tempfile.TemporaryDirectory() as folder:
        own = Path(folder)
        train(todo[k][1], own, lambda row: None)
        files = sorted(file for file in own.iterdir() if file.is_file())
        return {file.name: np.frombuffer(file.read_bytes(), np.uint8) for file in files}


def _spread(team: scale.Team, todo: list[Named], folder: Path, tell: Tell) -> None:
    chunks = folder / "chunks"
    shutil.rmtree(chunks, ignore_errors=True)  # what was finished is in folders of its own
    chunks.mkdir(parents=True)
    waiting = set(range(len(todo)))

    def put(_: Any) -> None:
        for k in [k for k in waiting if scale.is_there(chunks, k)]:
            waiting.remove(k)
            name, spec = todo[k]
            _unpack(scale.read(chunks, k), folder / name)
            tell(name, spec, store.read_rows(folder / name)[-1])

    team.compute(work, todo, len(todo), chunks, tell=put)
    shutil.rmtree(chunks)


def _unpack(files: scale.Arrays, folder: Path) -> None:
    """result.json last: a training that has it is whole."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in sorted(files, key=lambda name: name == "result.json"):
        (folder / name).write_bytes(files[name].tobytes())


__all__ = ["train", "train_all"]
