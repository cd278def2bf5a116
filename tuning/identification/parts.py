"""Do all parts of a record say the same? Every log, signal by signal and third by third."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from tuning.identification import uncertainty
from tuning.identification.residuals import Evaluation, Problem
from tuning.identification.robust import Loss
from tuning.identification.uncertainty import Covariance

_THIRDS = ("the first third", "the middle", "the last third")
# A part that has less than this share of what is known of an unknown is not heard about it.
_HEARD = 1e-3


class Pulled(NamedTuple):
    """One unknown, and what the parts of the record would make of it.

    p: the chance that they differ so much if the model is right. spread: their rms distance from
    the fit, weighted, in SI units. furthest: the part that speaks most clearly against the fit, in
    words; to: what it alone would make of the unknown.
    """

    name: str
    p: float
    spread: float
    furthest: str
    to: float


class _Blocks(NamedTuple):
    """Gauss-Newton matrices (B, P, P), gradients (B, P), variances of residuals (B,), and names."""

    matrix: np.ndarray
    gradient: np.ndarray
    variance: np.ndarray
    names: tuple[str, ...]


def pulled(
    problem: Problem, seen: Evaluation, values: np.ndarray, known: Covariance, loss: Loss,
    who: np.ndarray,
) -> tuple[Pulled, ...]:  # fmt: skip
    """How far the parts of the record agree about each unknown at a fit's end.

    Part b with Gauss-Newton matrix A_b and gradient g_b (which sum to A and to 0) moves unknown i
    along v = A^-1 e_i/(A^-1)_ii, the others following, by d_b = -g_b v/(v A_b v). Its variance is
    kappa_b/(v A_b v), kappa_b the mean square of the signal's residuals times their inflation. If
    the model is right, the squares of d_b in standard errors sum to a chi^2.

    seen: an evaluation of the experiments `who` with derivatives by SI values, of one fit.
    """
    scale = uncertainty.sizes(problem, values)
    b = _blocks(problem, seen, scale, known, loss, who)
    inverse = uncertainty.inverse(b.matrix.sum(axis=0))
    along = inverse / np.maximum(np.diag(inverse), 1e-300)  # a column per unknown
    told = np.einsum("pi,bpq,qi->bi", along, b.matrix, along)
    moved = -(b.gradient @ along) / np.maximum(told, 1e-300)
    shown = sorted(set(problem.unknowns.columns()[who].ravel().tolist()))
    return tuple(
        _one(problem.unknowns.names[i], values[i], scale[i], moved[:, i], told[:, i], b)
        for i in shown
    )


def _blocks(
    problem: Problem, seen: Evaluation, scale: np.ndarray, known: Covariance, loss: Loss,
    who: np.ndarray,
) -> _Blocks:  # fmt: skip
    r, used = seen.residuals[0], problem.readings.used[who]
    J = uncertainty.by_columns(problem, seen.jacobian[0], who) * scale
    weight = loss.weight(r)
    found = []
    for e, s in np.ndindex(r.shape[:2]):
        test = known.whiteness[e][s]
        where = f"{problem.signals[s]} of {problem.experiments[int(who[e])].name}"
        for third, at in zip(_THIRDS, np.array_split(np.flatnonzero(used[e, s]), 3), strict=True):
            weighted = J[e, s][at] * weight[e, s][at, None]
            found.append(
                (
                    weighted.T @ J[e, s][at],
                    weighted.T @ r[e, s][at],
                    max(test.rms, 1e-300) ** 2 * test.inflation,
                    f"{third} of {where}",
                )
            )
    matrices, gradients, variances, names = zip(*found, strict=True)
    return _Blocks(np.array(matrices), np.array(gradients), np.array(variances), names)


def _one(
    name: str, value: Any, scale: Any, moved: np.ndarray, told: np.ndarray, blocks: _Blocks
) -> Pulled:
    weight = told / blocks.variance
    heard = weight > _HEARD * weight.sum()
    if heard.sum() < 2:
        return Pulled(name, 1.0, 0.0, "", float(value))
    moved, weight = moved[heard], weight[heard]
    mean = float(np.sum(weight * moved) / weight.sum())
    squares = weight * (moved - mean) ** 2
    p = float(stats.chi2.sf(squares.sum(), heard.sum() - 1))
    far = int(np.argmax(squares))
    furthest = blocks.names[int(np.flatnonzero(heard)[far])]
    spread = float(scale * np.sqrt(squares.sum() / weight.sum()))
    return Pulled(name, p, spread, furthest, float(value + scale * moved[far]))
