"""The certificate of a gradient: against finite differences of the located run, per parameter.

Differences of a plain run would not do: it is smooth in between, so its wrong gradients agree with
its own wrong differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import batch, tree
from jaxsim.errors import InputError
from jaxsim.hybrid import Deadzone, Exact
from jaxsim.study import Study, owner_of

# Relative steps of the central differences: large ones cut off, small ones drown in rounding and
# in the O(dt^4) jumps of a fixed-step run, so a right gradient agrees with one in between.
# 1e-6 is for runs near instability: the share of velocity feedback of the 2014 arm, unstable from
# 1.027 on, bends its error by 3 % within 1e-4.
STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
# A component counts as right within this share of its own size, or of the whole gradient's norm.
OWN, NORM = 1e-2, 1e-4


class Row(NamedTuple):
    """One metric with respect to one parameter.

    scale: |value|, or 1 SI unit where the value is 0. forward, reverse: d metric/d parameter, SI.
    differences: central differences, one per step of `STEPS`, SI. error: the smallest
    |forward - difference| that two neighbouring steps keep, times scale. verdict: right, zero,
    jumps or wrong.
    """

    metric: str
    parameter: str
    unit: str
    value: float
    scale: float
    forward: float
    reverse: float
    differences: tuple[float, ...]
    error: float
    verdict: str


class _Gradients(NamedTuple):
    """Arrays (metrics, parameters), differences with a leading axis of steps."""

    forward: np.ndarray
    reverse: np.ndarray
    differences: np.ndarray


def certify(study: Study, parameters: Sequence[str], metrics: Sequence[str]) -> list[Row]:
    """Compare the gradients of the study's run with finite differences of the located run.

    parameters: names or paths in the law or the drive. metrics: names of numbers of a run.

    Returns: a row per metric and parameter, metric by metric. A metric is `right` in a parameter
    where scale*|forward - difference| is within 1e-2 of its own size or 1e-4 of the norm of the
    scaled gradient for two neighbouring steps, and forward = reverse; `jumps` where the differences
    grow as the step shrinks (the metric itself is discontinuous here), else `wrong`.

    Raises: InputError for unknown names, or where the study's run itself does not complete.
    """
    owners = [owner_of(study, name) for name in parameters]
    if not owners or not metrics:
        raise InputError("certify", "needs a parameter and a metric", "none", "name one of each")
    values = np.array([_scalar(tree.get(getattr(study, o), path), path) for o, path in owners])
    scales = np.where(values == 0.0, 1.0, np.abs(values))
    gradients = _gradients(study, owners, values, scales, tuple(metrics))
    rows = []
    for i, metric in enumerate(metrics):
        norm = float(np.linalg.norm(gradients.forward[i] * scales))
        for j, (owner, path) in enumerate(owners):
            unit = tree.unit(getattr(study, owner), path)
            rows.append(_row(metric, path, unit, values[j], scales[j], gradients, (i, j), norm))
    return rows


def _scalar(value: Any, path: str) -> float:
    if np.ndim(value):
        shape = np.shape(value)
        raise InputError(path, "must be one number to be certified", shape, "leave it out")
    return float(value)


def _gradients(
    study: Study, owners: Any, values: np.ndarray, scales: np.ndarray, metrics: tuple[str, ...]
) -> _Gradients:
    def run(p: Any) -> Any:
        law, drive = (_replaced(study, owner, owners, p) for owner in ("law", "drive"))
        return _numbers(study, drive, law, metrics)

    at = jnp.asarray(values)
    _need_finite(run(at), metrics)
    forward = np.asarray(eqx.filter_jit(jax.jacfwd(run))(at))
    reverse = np.asarray(eqx.filter_jit(jax.jacrev(run))(at))
    return _Gradients(forward, reverse, _differences(study, owners, values, scales, metrics))


def _replaced(study: Study, owner: str, owners: Any, p: Any) -> Any:
    """The law or drive of the study with its share of the values p."""
    own = {path: p[i] for i, (o, path) in enumerate(owners) if o == owner}
    return tree.replace(getattr(study, owner), own)


def _numbers(study: Study, drive: Any, law: Any, metrics: tuple[str, ...]) -> Any:
    """(metrics,), or (metrics, members) for a batch; of several axes, the sum."""
    run = study.measure(metrics, drive=drive, law=law)
    numbers = jnp.stack([run.metrics[name] for name in metrics])
    return numbers.sum(axis=-1) if study.drive.axes > 1 else numbers


def _need_finite(numbers: Any, metrics: tuple[str, ...]) -> None:
    for name, value in zip(metrics, np.asarray(numbers), strict=True):
        if not np.isfinite(value):
            raise InputError(
                name, "must be finite to have a gradient", value, "choose another metric"
            )


def _differences(
    study: Study, owners: Any, values: np.ndarray, scales: np.ndarray, metrics: tuple[str, ...]
) -> np.ndarray:
    """(steps, metrics, parameters), all runs in one batch."""
    moves = [
        (sign * step * scales[j], j)
        for step in STEPS
        for j in range(len(values))
        for sign in (1.0, -1.0)
    ]
    table = np.tile(values, (len(moves), 1))
    for k, (move, j) in enumerate(moves):
        table[k, j] += move
    trees = []
    for owner in ("drive", "law"):
        own = {path: table[:, j] for j, (o, path) in enumerate(owners) if o == owner}
        base = getattr(study, owner)
        trees.append(batch.spread(base, **own) if own else base)
    located = study._replace(run=study.run._replace(deadzone=_located(study.run.deadzone)))
    numbers = np.asarray(_numbers(located, trees[0], trees[1], metrics))
    pairs = numbers.reshape(len(metrics), len(STEPS), len(values), 2)
    widths = 2.0 * np.array(STEPS)[:, None] * scales
    return np.moveaxis((pairs[..., 0] - pairs[..., 1]) / widths, 1, 0)


def _located(deadzone: Deadzone) -> Deadzone:
    return deadzone if deadzone.located else Exact()


def _row(
    metric: str,
    path: str,
    unit: str,
    value: float,
    scale: float,
    g: _Gradients,
    at: tuple[int, int],
    norm: float,
) -> Row:
    forward, reverse = float(g.forward[at]), float(g.reverse[at])
    differences = tuple(float(d[at]) for d in g.differences)
    same = abs(forward - reverse) * scale <= 1e-6 * max(norm, 1e-30)
    error, verdict = judge(forward, differences, scale, norm, same)
    return Row(
        metric,
        path,
        unit,
        float(value),
        float(scale),
        forward,
        reverse,
        differences,
        error,
        verdict,
    )


def judge(
    gradient: float, differences: Sequence[float], scale: float, norm: float, same: bool = True
) -> tuple[float, str]:
    """The error and the verdict of one component, both as in `Row`.

    differences: one per step of `STEPS`. norm: of the scaled gradient. same: whether another way
    to the gradient agrees.
    """
    found = np.asarray(differences, float)
    errors = scale * np.abs(found - gradient)
    # Two neighbouring steps must agree: one alone may hit by chance where the metric jumps.
    pairs = np.maximum(errors[:-1], errors[1:])
    error = float(np.min(np.where(np.isfinite(pairs), pairs, np.inf)))
    allowed = max(OWN * scale * abs(gradient), NORM * norm)
    return error, _verdict(error <= allowed and same, norm, found, allowed / scale)


def _verdict(agrees: bool, norm: float, differences: np.ndarray, allowed: float) -> str:
    if agrees:
        return "right" if norm > 0.0 else "zero"
    growth = np.abs(np.diff(differences))
    grows = len(growth) > 1 and growth[-1] > 3.0 * growth[0] and growth[-1] > allowed
    return "jumps" if grows or not np.all(np.isfinite(differences)) else "wrong"
