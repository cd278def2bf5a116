"""Which limits are in each other's way: how far each can be met while all the others hold."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxsim.objective import Limit
from tuning import space
from tuning.local import RESERVE, Local, Rows, size
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


class Conflict(NamedTuple):
    """attained: per limit. nearest: the law whose worst limit is broken least, goals set aside."""

    attained: tuple[Attained, ...]
    nearest: State


def conflict(session: Session, best: State) -> Conflict:
    """A search per limit for its least excess under all the others, and one for the worst of all.

    On the drives looked at, from the best law of the session and from the laws met that come
    nearest, all in one batch.
    """
    limits = session.spec.objective.limits
    pairs = [(k, z) for k in range(len(limits) + 1) for z in _starts(session, best, k)]
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
    return Conflict(
        tuple(
            _best_of(limit, [s for s, own in zip(states, which, strict=True) if own == k])
            for k, limit in enumerate(limits)
        ),
        _nearest(session, best, states),
    )


def _starts(session: Session, best: State, k: int) -> list[np.ndarray]:
    """The best law, and the one met that has the least excess of a limit, or of the worst."""
    assert best.best is not None
    columns = excess_columns(session.spec.objective)
    own = columns[k : k + 1] or columns
    nearest = min(session.history, key=lambda row: max(row[c] for c in own))
    gains = np.array([nearest[f.name] for f in session.spec.free])
    return [best.best, space.to_unit(session.spec.free, gains)]


def _alone(local: Local, k: int) -> Local:
    """The excess of a limit as the only goal; after the last limit, that of the worst."""
    if k < len(local.limits):
        own = local.limits[k]._replace(factor=1.0)
        return Local((own,), (*local.limits[:k], *local.limits[k + 1 :]))
    values, slopes, _, source = (
        np.concatenate([np.atleast_1d(v) for v in part]) for part in zip(*local.limits, strict=True)
    )
    return Local((Rows(values, slopes, 1.0, source),), ())


def _nearest(session: Session, best: State, states: list[State]) -> State:
    """The best state with the law that breaks its worst limit least."""
    met = [s for s in states if s.best_local is not None]
    if not met:
        return best
    law = min(met, key=lambda s: max(*s.rank)).best
    assert law is not None
    (local,) = session.look(law[None])
    if isinstance(local, str):
        return best
    return dataclasses.replace(best, best=law, best_local=local, memory=None)


def _best_of(limit: Limit, states: list[State]) -> Attained:
    state = min(states, key=lambda s: s.rank)
    local = state.best_local
    if local is None:
        return Attained(limit, np.nan, np.nan, False)
    share = local.cost - RESERVE
    value = limit.bound + limit.sign * share * size(limit)
    return Attained(limit, value, share, local.violation <= 0.0)
