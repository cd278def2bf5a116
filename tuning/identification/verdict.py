"""What a log says about each unknown, in words, and what would have to be recorded to know more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tuning.identification.doubts import Doubt
from tuning.identification.residuals import Problem
from tuning.identification.uncertainty import Covariance
from tuning.identification.unknowns import Free

# An unknown counts as determined when its standard error is below this share of its size.
_KNOWN = 0.1
# What takes part in a direction that leaves no trace, as a share of its largest part.
_PART = 0.25
# Exponents nearer to each other than this are told as a plain product or ratio.
_EQUAL = 0.1

KINDS = ("determined", "contradicted", "combination", "not visible")

_ADVICE = {
    "half_gap": "reverse the joint torque slowly and softly (a sine of some mNm and below 1 Hz), "
    "so that the play is crossed again and again and both walls are touched",
    "K": "press the spring: larger joint torques, or impacts sampled fast enough to see it ring",
    "D_B": "let the contact ring: impacts, sampled ten times faster than the ringing",
    "J_L": "accelerate the load: a chirp or multisine that reaches higher frequencies",
    "J_M": "accelerate the motor, also inside the play: fast reversals of the torque",
    "D_M": "run at several speeds for a longer time",
    "D_L": "run at several speeds for a longer time",
    "Fc": "reverse slowly at several amplitudes",
    "Fs": "start from rest many times, with slowly rising torque",
    "ws": "creep: speeds below and around the Stribeck speed",
    "delay": "give steps and fast chirps: slow inputs look the same a little later",
}
_CONTRADICTED = "look at what is left of each log, and try other structures"
_ELSE = "excite it more: more amplitude, more frequencies, another load"


class Verdict(NamedTuple):
    """One unknown. kind: one of `KINDS`; why and advice in words."""

    name: str
    kind: str
    why: str
    advice: str


def verdicts(
    problem: Problem, values: np.ndarray, seen: Covariance, contact: np.ndarray
) -> list[Verdict]:
    """A verdict on each unknown at a fit's end.

    An unknown is determined if its standard error is below 10 % of its size. If it would be with
    all others known, a combination is determined: the direction in which the loss hardly rises
    names it. Else the log does not show it.

    contact: (E, 2) of the evaluation there.
    """
    frees = [problem.unknowns.free[i] for i in problem.unknowns.of]
    sizes = sizes_of(problem, values)
    joint = seen.deviation / sizes
    alone = _alone(seen) / sizes
    found = []
    for i, name in enumerate(problem.unknowns.names):
        advice = _advice(frees[i])
        if frees[i].name.endswith("half_gap") and not crosses(contact).any():
            why = "the record never crosses the play: what is seen of it hangs on the assumed start"
            found.append(Verdict(name, "not visible", why, advice))
        elif joint[i] < _KNOWN:
            words = f"standard error {_percent(joint[i])} of its size"
            found.append(Verdict(name, "determined", words, ""))
        elif alone[i] < _KNOWN:
            why = _direction(i, problem.unknowns.names, frees, seen, sizes)
            found.append(Verdict(name, "combination", why, advice))
        else:
            why = f"even with all else known it would be uncertain by {_percent(alone[i])}"
            found.append(Verdict(name, "not visible", why, advice))
    return found


def contradicted(
    found: Sequence[Verdict], doubts: Sequence[Doubt], bounds: Mapping[str, tuple[float, float]]
) -> list[Verdict]:
    """The verdicts, with those taken back against which the record itself speaks.

    An interval holds if the model is right. Where the record says that it is not, or drives an
    unknown to a bound, neither it nor a combination of it is called determined.
    """
    judged = []
    for v in found:
        why = [d.short for d in doubts if not d.names or v.name in d.names]
        if v.name in bounds:
            why.append(f"it lies on its bound, {bounds[v.name]}")
        if why and v.kind in ("determined", "combination"):
            v = Verdict(v.name, "contradicted", "; ".join(why), _CONTRADICTED)
        judged.append(v)
    return judged


def sizes_of(problem: Problem, values: np.ndarray) -> np.ndarray:
    """(P,) what an error is compared with: the value, or for those about zero their bounds."""
    frees = [problem.unknowns.free[i] for i in problem.unknowns.of]
    spans = np.array([0.5 * (f.upper - f.lower) for f in frees])
    signed = np.array([f.lower < 0.0 < f.upper for f in frees])
    return np.where(signed, spans, np.maximum(np.abs(values), 1e-300))


def _alone(seen: Covariance) -> np.ndarray:
    """Standard errors if all other unknowns were known, inflated as the joint ones are."""
    with np.errstate(divide="ignore"):
        plain = 1.0 / np.sqrt(np.maximum(np.diag(seen.information), 0.0))
    inflation = seen.deviation / np.sqrt(np.maximum(np.diag(seen.naive), 1e-300))
    return plain * np.maximum(inflation, 1.0)


def crosses(contact: np.ndarray) -> np.ndarray:
    """(E,) whether both walls of the play are touched in an experiment."""
    return (contact[..., 0] > 0.0) & (contact[..., 1] > 0.0)


def _direction(
    index: int, names: Sequence[str], frees: list[Free], seen: Covariance, sizes: np.ndarray
) -> str:
    """The direction in which an unknown moves without a trace, and what is determined instead."""
    relative = seen.matrix / (sizes[:, None] * sizes[None, :])
    _, vectors = np.linalg.eigh(relative)
    # Of the loose directions, the one that moves this unknown most.
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(relative), 0.0)) * np.abs(vectors[index])
    loose = vectors[:, int(np.argmax(spread))]
    loose = loose / loose[np.argmax(np.abs(loose))]
    parts = [i for i in np.argsort(-np.abs(loose)) if abs(loose[i]) >= _PART]
    if len(parts) == 1:
        return "it can move alone without a trace beside the others' errors"
    told = " and ".join(f"{names[i]} by {loose[i]:+.2g} %" for i in parts)
    signed = any(frees[i].lower < 0.0 < frees[i].upper for i in parts)
    if len(parts) == 2 and not signed:
        a, b = parts
        if abs(abs(loose[b]) - 1.0) < _EQUAL:
            one = f"{names[a]} / {names[b]}" if loose[a] * loose[b] > 0.0 else None
            one = one or f"{names[a]} * {names[b]}"
            return f"only {one} is determined: {told} together leave no trace"
    return f"only a combination is determined: {told} together leave no trace"


def _advice(free: Free) -> str:
    tail = free.paths[0].rpartition(".")[2]
    return _ADVICE.get(tail, _ELSE)


def _percent(share: float) -> str:
    return "more than its size" if not share < 1.0 else f"{100.0 * share:.2g} %"
