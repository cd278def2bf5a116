"""The quadratic model of one step, with the limits as an exact penalty."""

from __future__ import annotations

from typing import NamedTuple

import clarabel  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import scipy.sparse as sparse

from tuning.local import Local, Rows

# Clarabel stops at 1e-8 by default; the active rows are found more sharply at this.
_ACCURACY = 1e-10


class Step(NamedTuple):
    """A step d (P,), the model's merit there (see `merit`) and the multipliers of the rows.

    goal_weights, limit_weights: one array (k,) per goal and limit: d cost/d row. They sum to the
    goal's factor, and to at most the penalty. excess: (limits,), what the model says remains.
    """

    d: np.ndarray
    merit: float
    goal_weights: tuple[np.ndarray, ...]
    limit_weights: tuple[np.ndarray, ...]
    excess: np.ndarray
    penalty: float


def merit(local: Local, penalty: float) -> float:
    """cost + penalty*(sum over limits of the excess): exact for a penalty that is large enough."""
    return local.cost + penalty * float(np.maximum(local.excess, 0.0).sum())


def best_step(
    local: Local, hessian: np.ndarray, penalty: float, lower: np.ndarray, upper: np.ndarray
) -> Step | None:
    """min over d of sum_g t_g + penalty*sum_l s_l + d'Hd/2, with

        t_g >= factor_g*(value + slope.d) for every row of goal g,
        s_l >= value + slope.d for every row of limit l, s_l >= 0, lower <= d <= upper.

    Every drive is a row of its own, so the worst case has no kink in this model.
    Solved by Clarabel (interior point): SciPy's SLSQP took 3 times as long on such problems and
    stopped short of the optimum in half of them; NNLS (least distance) lost all digits at large
    penalties.

    Returns: None where the solver fails (an infinite slope, say).
    """
    P, terms = len(lower), (*local.goals, *local.limits)
    n = P + len(terms)
    H = np.zeros((n, n))
    H[:P, :P] = hessian
    linear = np.zeros(n)
    linear[P : P + len(local.goals)] = 1.0
    linear[P + len(local.goals) :] = penalty
    A, b = _rows(local, lower, upper)
    if not (np.isfinite(A).all() and np.isfinite(b).all() and np.isfinite(H).all()):
        return None
    settings = clarabel.DefaultSettings()  # pyright: ignore[reportAttributeAccessIssue]
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _ACCURACY
    cones = [clarabel.NonnegativeConeT(len(b))]  # pyright: ignore[reportAttributeAccessIssue]
    solver = clarabel.DefaultSolver(  # pyright: ignore[reportAttributeAccessIssue]
        sparse.csc_matrix(np.triu(H)), linear, sparse.csc_matrix(A), b, cones, settings
    )
    found = solver.solve()
    if str(found.status) not in ("Solved", "AlmostSolved"):
        return None
    return _read(local, hessian, penalty, np.array(found.x)[:P], np.array(found.z))


def _rows(local: Local, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A, b of A (d, t, s) <= b."""
    P, terms = len(lower), (*local.goals, *local.limits)
    blocks, right = [], []
    for k, rows in enumerate(terms):
        factor = rows.factor if k < len(local.goals) else 1.0
        block = np.zeros((len(rows.values), P + len(terms)))
        block[:, :P] = factor * rows.slopes
        block[:, P + k] = -1.0
        blocks.append(block)
        right.append(-factor * rows.values)
    kept = np.zeros((len(local.limits), P + len(terms)))
    kept[:, P + len(local.goals) :] = -np.eye(len(local.limits))
    box = np.eye(P, P + len(terms))
    return np.vstack([*blocks, kept, box, -box]), np.concatenate(
        [*right, np.zeros(len(kept)), upper, -lower]
    )


def _read(
    local: Local, hessian: np.ndarray, penalty: float, d: np.ndarray, duals: np.ndarray
) -> Step:
    weights, at = [], 0
    for rows in (*local.goals, *local.limits):
        weights.append(np.maximum(duals[at : at + len(rows.values)], 0.0))
        at += len(rows.values)
    there = Local(
        tuple(_moved(r, d) for r in local.goals), tuple(_moved(r, d) for r in local.limits)
    )
    goals = len(local.goals)
    own = tuple(w * g.factor for w, g in zip(weights[:goals], local.goals, strict=True))
    value = merit(there, penalty) + 0.5 * float(d @ hessian @ d)
    return Step(d, value, own, tuple(weights[goals:]), there.excess, penalty)


def _moved(rows: Rows, d: np.ndarray) -> Rows:
    return rows._replace(values=rows.values + rows.slopes @ d)
