"""The state of a search on disk: JSON, written beside and renamed, after every iteration."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxsim.errors import InputError
from jaxsim.provenance import write_json
from tuning.solver import SOLVERS, Solver, State
from tuning.spec import describe

if TYPE_CHECKING:
    from tuning.session import Session

_PLAIN = ("radius", "status", "iterations", "reason")


def write(session: Session) -> None:
    """Everything that `read` needs; an interrupt leaves the file of the iteration before."""
    write_json(
        session.file,
        {
            "problem": fingerprint(session),
            "phase": session.at,
            "allowed": session.allowed,
            "drives": session.drives,
            "excluded": session.excluded,
            "unit": session.unit,
            "seconds": session.seconds,
            "states": [_table(s, session.solver) for s in session.states],
            "history": session.history,
        },
    )


def read(session: Session) -> list[State]:
    """Fill a session from its file; returns its states, without their objectives.

    Raises: InputError where there is no such file, it is damaged, or belongs to another problem.
    """
    file = session.file
    try:
        found = json.loads(file.read_text("utf-8"))
        solver = SOLVERS.find(session.phases[found["phase"]].solver)()
        states = [_state(table, solver) for table in found["states"]]
    except FileNotFoundError:
        fix = "leave --resume out for a new run"
        raise InputError("--resume", "needs a checkpoint", f"no {file}", fix) from None
    except (ValueError, KeyError, TypeError, IndexError) as error:
        fix = "start anew without --resume"
        raise InputError(str(file), "must be a whole checkpoint", repr(error), fix) from None
    if found["problem"] != fingerprint(session):
        fix = "give the same study, starts and seed, or start anew without --resume"
        raise InputError(str(file), "must belong to this study", "another problem", fix)
    session.at, session.unit, session.seconds = found["phase"], found["unit"], found["seconds"]
    session.allowed, session.drives = found["allowed"], np.array(found["drives"], int)
    session.excluded = {int(k): v for k, v in found["excluded"].items()}
    session.history = found["history"]
    return states


def fingerprint(session: Session) -> str:
    """A digest of the study as it was read and of the specification, overrides included."""
    parts = {k: v for k, v in session.study.table.items() if k not in ("name", "about", "tune")}
    text = json.dumps([parts, describe(session.spec)], sort_keys=True, default=str)
    # A list of drives may stand in a file of its own: what counts is what was read.
    return hashlib.sha256(text.encode() + session.spec.drives.tobytes()).hexdigest()


def _table(s: State, solver: Solver) -> dict[str, Any]:
    memory = None if s.memory is None else solver.dump(s.memory)
    own = {name: getattr(s, name) for name in _PLAIN}
    return own | {"z": s.z, "best": s.best, "memory": memory}


def _state(table: dict[str, Any], solver: Solver) -> State:
    best, memory = table["best"], table["memory"]
    return State(
        np.array(table["z"], float),
        best=None if best is None else np.array(best, float),
        memory=None if memory is None else solver.restore(memory),
        **{name: table[name] for name in _PLAIN},
    )
