"""Which limits are in each other's way: how far each can be met while all the others hold."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxsim.objective import Limit
from tuning import space
from tuning.local import RESERVE, Local, size
from tuning.session import Session, excess_columns
from tuning.solver import RUNNING, State
from tuning.solvers.sqp import Sqp

_SOLVER = Sqp()


class Attained(NamedTuple):
    """The best that one limit comes to, goals set aside.

    value: of its metric; share: by what share of the bound it is exceeded, < 0 where it is kept;
    others: whether all the other limits hold there.
    """

    limit: Limit
    value: float
    share: float
    others: bool


def attained(session: Session, best: State) -> tuple[Attained, ...]:
    """Per limit a search for its least excess under all the others, on the drives looked at.

    From the best law of the session and from the law met that comes nearest to the limit, all in
    one batch.
    """
    limits = session.spec.objective.limits
    pairs = [(k, z) for k in range(len(limits)) for z in _starts(session, best, k)]
    which = [k for k, _ in pairs]

    def look(points: np.ndarray, running: list[int]) -> list[Local | str]:
        found = session.look(points)
        return [
            x if isinstance(x, str) else _alone(x, which[i])
            for x, i in zip(found, running, strict=True)
        ]

    first = look(np.array([z for _, z in pairs]), list(range(len(pairs))))
    states = [_SOLVER.begin(State(z), x) for (_, z), x in zip(pairs, first, strict=True)]
    most = session.spec.iterations
    while any(s.status == RUNNING for s in states):
        states = _SOLVER.advance(states, look, session.spec.tolerance, most)
    return tuple(
        _best_of(limit, [s for s, own in zip(states, which, strict=True) if own == k])
        for k, limit in enumerate(limits)
    )


def _starts(session: Session, best: State, k: int) -> list[np.ndarray]:
    assert best.best is not None
    column = excess_columns(session.spec.objective)[k]
    nearest = min(session.history, key=lambda row: row[column])
    gains = np.array([nearest[f.name] for f in session.spec.free])
    return [best.best, space.to_unit(session.spec.free, gains)]


def _alone(local: Local, k: int) -> Local:
    """The excess of a limit as the only goal."""
    own = local.limits[k]._replace(factor=1.0)
    return Local((own,), (*local.limits[:k], *local.limits[k + 1 :]))


def _best_of(limit: Limit, states: list[State]) -> Attained:
    state = min(states, key=lambda s: s.rank)
    local = state.best_local
    if local is None:
        return Attained(limit, np.nan, np.nan, False)
    share = local.cost - RESERVE
    value = limit.bound + limit.sign * share * size(limit)
    return Attained(limit, value, share, local.violation <= 0.0)
