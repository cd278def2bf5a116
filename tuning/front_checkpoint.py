"""The state of a front on disk: the laws looked at, and the searches that are done."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxsim.errors import InputError
from jaxsim.provenance import write_json
from tuning.spec import describe

if TYPE_CHECKING:
    from tuning.pareto import Tracer

_PLAIN = ("stage", "done", "bounds", "left_out")


def write(tracer: Tracer, points: int, file: Path) -> None:
    """Everything that `read` needs; an interrupt leaves the file of the iteration before."""
    plain = {name: getattr(tracer, name) for name in _PLAIN}
    arrays = {"starts": tracer.starts, "every": tracer.every, "drives": tracer.drives}
    seen = [[*s.z.tolist(), s.first, s.second, s.violation] for s in tracer.seen]
    write_json(file, {"problem": _fingerprint(tracer, points), **plain, **arrays, "seen": seen})


def read(tracer: Tracer, points: int, file: Path) -> None:
    """Put a tracer where its file left it.

    Raises: InputError where there is no such file, it is damaged, or belongs to another front.
    """
    from tuning.pareto import Seen

    try:
        found: dict[str, Any] = json.loads(file.read_text("utf-8"))
        rows = np.array(found["seen"], float).reshape(len(found["seen"]), -1)
        seen = [Seen(row[:-3], *map(float, row[-3:])) for row in rows]
        values = {name: found[name] for name in _PLAIN}
        arrays = {k: np.array(found[k], kind) for k, kind in _ARRAYS.items()}
    except FileNotFoundError:
        fix = "leave --resume out for a new front"
        raise InputError("--resume", "needs a checkpoint", f"no {file}", fix) from None
    except (ValueError, KeyError, TypeError) as error:
        fix = "start anew without --resume"
        raise InputError(str(file), "must be a whole checkpoint", repr(error), fix) from None
    if found["problem"] != _fingerprint(tracer, points):
        fix = "give the same study, goals, points and seed, or start anew without --resume"
        raise InputError(str(file), "must belong to this front", "another one", fix)
    values["left_out"] = {int(k): why for k, why in values["left_out"].items()}
    for name, value in {**values, **arrays, "seen": seen}.items():
        setattr(tracer, name, value)


_ARRAYS = {"starts": float, "every": int, "drives": int}


def _fingerprint(tracer: Tracer, points: int) -> str:
    """A digest of the study as it was read, the specification, both goals and their points."""
    problem = tracer.problem
    parts = {k: v for k, v in problem.study.table.items() if k not in ("name", "about", "tune")}
    pair = [g._asdict() for g in tracer.pair]
    text = json.dumps([parts, describe(problem.spec), pair, points], sort_keys=True, default=str)
    return hashlib.sha256(text.encode() + problem.spec.drives.tobytes()).hexdigest()
