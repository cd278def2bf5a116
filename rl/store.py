"""The folder of a training: what a person reads, and what a resumed training needs.

training.toml    the spec: algorithm, task, seed and every number of the preset
policy.json      the best policy on the validation episodes, as a table of `Policy`
law.toml         the same as a law: `gearlash simulate STUDY --law FOLDER/law.toml`
progress.csv     one line per validation
result.json      training cost, scores on the test episodes, provenance
learning.png     the learning curve
state.json       names the folder of the last checkpoint; `checkpoint-N` holds it
"""

from __future__ import annotations

import csv
import functools
import io
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from envs.environment import Environment
from envs.task import Task
from jaxsim import components, tree
from jaxsim.components import read_json, read_toml
from jaxsim.errors import InputError
from jaxsim.law import Control
from jaxsim.laws.policy import Network, Policy, Trained
from jaxsim.provenance import provenance, replace_text, write_json, write_toml
from jaxsim.status import Status
from rl.episodes import Scores
from rl.spec import APGSpec, SB3Spec, from_table
from rl.trainer import Trainer

# Episodes that are looked at for the range of the drives, and the age of a drive that is worn out.
_DRAWN, _WORN = 256, 10**6


class Row(NamedTuple):
    """One validation.

    loss: mean objective of the training episodes before it; validation: the same of the policy on
    the validation episodes; cost: its median cost there; cpu: seconds so far.
    """

    done: int
    steps: int
    loss: float
    validation: float
    cost: float
    best: float
    cpu: float


def law_of(env: Environment, network: Network) -> Policy:
    """A network as a law: the law at work, channels, actions and sensors of its environment.

    Raises: InputError where the network was trained for other observations or actions.
    """
    task = env.task
    return Policy(
        task.law(),
        network,
        task.channels,
        task.actions,
        task.period,
        task.duration,
        env.sensors,
        drives_of(task),
    )  # type: ignore[arg-type]


@functools.cache
def drives_of(task: Task) -> tuple[Trained, ...]:
    """The range of every parameter over episodes of new drives and of worn ones."""
    keys = jax.random.split(jax.random.key(0), _DRAWN)
    one = task.draw(keys[0], 0).drive
    drawn = [jax.vmap(lambda key, age=age: task.draw(key, age).drive)(keys) for age in (0, _WORN)]
    values = {p: np.asarray([tree.get(d, p) for d in drawn], float) for p in tree.numbers(one)}
    return tuple(Trained(p, float(v.min()), float(v.max())) for p, v in values.items())


def write_policy(folder: Path, policy: Policy, about: str) -> None:
    """policy.json and law.toml."""
    write_json(folder / "policy.json", components.dump(policy))
    write_toml(folder / "law.toml", {"law": {"type": "policy", "weights": "policy.json"}}, about)


def read_policy(folder: Path) -> Policy:
    """The policy of a training. Raises: InputError where there is none or it is not complete."""
    table = read_json(folder / "policy.json")
    return components.build(Control, table, str(folder / "policy.json"))


def write_spec(folder: Path, spec: APGSpec | SB3Spec) -> None:
    write_toml(folder / "training.toml", spec.model_dump(mode="json"))


def read_spec_of(folder: Path) -> APGSpec | SB3Spec:
    """The spec of the training in a folder."""
    return from_table(read_toml(folder / "training.toml"))


def check_same(folder: Path, spec: APGSpec | SB3Spec) -> None:
    """Raises: InputError where the folder holds a training of another spec."""
    there = read_spec_of(folder)
    if there != spec:
        old, new = there.model_dump(), spec.model_dump()
        other = {k: (old.get(k), v) for k, v in new.items() if old.get(k) != v}
        rule, fix = "must hold the training asked for", "name another --out, or remove it"
        raise InputError(str(folder), rule, f"others (there, asked): {other}", fix)


def read_rows(folder: Path) -> list[Row]:
    """The validations of a training so far."""
    return _rows_of(read_json(folder / "state.json"), folder)


def _rows_of(state: dict[str, Any], folder: Path) -> list[Row]:
    try:
        return [Row(**row) for row in state["rows"]]
    except (KeyError, TypeError) as error:
        where = str(folder / "state.json")
        raise InputError(where, "must be as it was written", str(error), "train anew") from None


def write_checkpoint(folder: Path, trainer: Trainer, rows: Sequence[Row]) -> None:
    """Write beside and switch over: a kill at any moment leaves one that is whole."""
    name = f"checkpoint-{trainer.done}"
    shutil.rmtree(folder / name, ignore_errors=True)
    (folder / name).mkdir()
    trainer.save(folder / name)
    write_json(folder / "state.json", {"checkpoint": name, "rows": [r._asdict() for r in rows]})
    for old in folder.glob("checkpoint-*"):
        if old.name != name:
            shutil.rmtree(old, ignore_errors=True)


def read_checkpoint(folder: Path, trainer: Trainer) -> list[Row]:
    """Take a training up. Raises: InputError where there is none, or it is not whole."""
    if not (folder / "state.json").exists():
        found = f"none in {folder}: it ended before the first one"
        raise InputError("--resume", "needs a checkpoint", found, "leave out --resume")
    state = read_json(folder / "state.json")
    rows = _rows_of(state, folder)
    trainer.load(folder / str(state.get("checkpoint")))
    return rows


def write_progress(folder: Path, rows: Sequence[Row]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row._fields)
    writer.writerows(rows)
    replace_text(folder / "progress.csv", text.getvalue())


def best_of(rows: Sequence[Row]) -> float:
    return min((row.best for row in rows), default=float("inf"))


def write_result(
    folder: Path, spec: APGSpec | SB3Spec, rows: Sequence[Row], scores: Scores
) -> dict[str, Any]:
    """result.json: what a comparison wants to know of a training."""
    last = rows[-1]
    failed = int(np.sum(scores.status != Status.OK.value))
    content = {
        **{"task": spec.task, "algo": spec.algo, "steps": last.steps, "cpu_s": last.cpu},
        "validation_loss": last.best,
        "test_cost_median": float(np.median(scores.cost)),
        "test_loss_mean": float(np.mean(scores.loss)),
        "test_failed": failed,
        **provenance(seed=spec.seed, dtype="float32"),
    }
    write_json(folder / "result.json", content)
    return content


__all__ = [
    "Row",
    "best_of",
    "check_same",
    "drives_of",
    "law_of",
    "read_checkpoint",
    "read_policy",
    "read_rows",
    "read_spec_of",
    "write_checkpoint",
    "write_policy",
    "write_progress",
    "write_result",
    "write_spec",
]
