"""Structures against each other: fitted to the same logs, judged by those held out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxsim.components import read_toml
from jaxsim.errors import InputError
from jaxsim.study import Study, from_table, locate
from tuning.identification.estimator import Fit, fit
from tuning.identification.session import Outcome, Tell, identify
from tuning.identification.spec import Spec, read_spec
from tuning.identification.uncertainty import whiteness

# A held-out loss is above another if it is so by more standard errors than this, and by this share.
_SURE, _MORE = 3.0, 0.01


class Rival(NamedTuple):
    """One structure.

    train, test: half the mean square residual per reading, in the noise of the study's own
    structure; nan where nothing was held out or the fit failed (`remark` says why). behind: how far
    `test` is above the lowest, in standard errors of the difference. preferred: of those whose
    `test` is not surely above the lowest, the one with the fewest unknowns.
    """

    name: str
    unknowns: int
    train: float
    test: float
    behind: float
    preferred: bool
    remark: str


class _Scored(NamedTuple):
    """A structure and half the square of each held-out residual, one series per log and signal."""

    rival: Rival
    halves: tuple[np.ndarray, ...]


def compare(
    study: Study, spec: Spec, own: Outcome, tell: Tell | None = None, fitted: Fit = fit
) -> list[Rival]:
    """The study's structure and those of [identify.structures], best on held-out logs first.

    A structure is another study file: its drive, law and free parameters are fitted to the logs of
    this study. One that fails is reported; the others are kept.
    """
    if not spec.structures:
        return []
    noise = own.problem.readings.noise[0]
    scored = [_scored("this study", own, noise)]
    for name, file in spec.structures.items():
        try:
            other = _other(study, file)
            found = identify(other, read_spec(other), tell, fitted)
            scored.append(_scored(name, found, noise))
        except InputError as error:
            failed = Rival(name, 0, np.nan, np.nan, np.nan, preferred=False, remark=str(error))
            scored.append(_Scored(failed, ()))
    return ranked(scored)


def ranked(scored: list[_Scored]) -> list[Rival]:
    """All structures, best first, one of them preferred.

    A structure with a part too many predicts as well as one without it, to within chance: so the
    lowest loss alone does not decide.
    """
    order = sorted(scored, key=lambda s: (np.isnan(s.rival.test), s.rival.test, s.rival.train))
    if np.isnan(order[0].rival.test):  # nothing held out: more unknowns always fit better
        return [s.rival for s in order]
    rivals = [s.rival._replace(behind=_behind(s.halves, order[0].halves)) for s in order]
    level = [i for i, r in enumerate(rivals) if not _above(r, rivals[0])]
    best = min(level, key=lambda i: rivals[i].unknowns)
    return [r._replace(preferred=i == best) for i, r in enumerate(rivals)]


def _above(rival: Rival, lowest: Rival) -> bool:
    """Whether a held-out loss is surely and noticeably above the lowest; a failed one is."""
    return not (rival.behind <= _SURE or rival.test <= (1.0 + _MORE) * lowest.test)


def _behind(halves: Sequence[np.ndarray], lowest: Sequence[np.ndarray]) -> float:
    """Mean difference of paired readings over its standard error, by their effective number."""
    pairs = [a - b for a, b in zip(halves, lowest, strict=True)] if halves else [np.array([np.nan])]
    total = float(sum(d.sum() for d in pairs))
    variance = sum(d.size * float(d.var()) * whiteness(d - d.mean()).inflation for d in pairs)
    return 0.0 if total == 0.0 else total / max(float(np.sqrt(variance)), 1e-300)


def sentence(rivals: Sequence[Rival]) -> str:
    """Which structure the held-out logs prefer, in words."""
    chosen = next((r for r in rivals if r.preferred), None)
    if chosen is None:
        return 'Structures: hold out a log (use = "test") to tell which one is right.'
    words = f"Of {len(rivals)} structures the held-out logs prefer {chosen.name}"
    more = [r.name for r in rivals if not r.preferred and not _above(r, rivals[0])]
    if more:
        words += f", as no other with as few unknowns predicts them better ({', '.join(more)})"
    worse = [r for r in rivals if _above(r, rivals[0])]
    told = ", ".join(f"{r.name} ({_times(r, rivals[0])})" for r in worse)
    return words + (f"; they speak against {told}." if told else ".")


def _times(rival: Rival, lowest: Rival) -> str:
    return "no fit" if np.isnan(rival.test) else f"{rival.test / lowest.test:.3g} times the loss"


def _other(study: Study, file: str) -> Study:
    """A structure: the other file's drive, law and free parameters with this study's logs."""
    path = locate(file, study.folder)
    table = read_toml(path)
    free = table.get("identify", {}).get("free")
    if free is None:
        raise InputError(f"{file}: identify.free", "must be given", "nothing", "name its unknowns")
    section = {**study.section("identify"), "free": free, "profile": [], "bootstrap": 0}
    section.pop("structures", None)
    merged = {**study.table, "drive": table.get("drive", study.table["drive"])}
    merged |= {"law": table.get("law", study.table["law"]), "identify": section}
    return from_table(merged, study.folder, path.stem)


def _scored(name: str, outcome: Outcome, noise: np.ndarray) -> _Scored:
    own = outcome.problem.readings.noise / noise
    halves = 0.5 * (outcome.evaluation.residuals[0] * own[..., None]) ** 2
    used = outcome.problem.readings.used

    def loss(rows: np.ndarray) -> float:
        count = used[rows].sum()
        return float(halves[rows].sum()) / count if count else float("nan")

    train, test = loss(outcome.train), loss(outcome.test)
    rival = Rival(name, len(outcome.shown), train, test, np.nan, preferred=False, remark="")
    held_out = ((e, s) for e in outcome.test for s in range(used.shape[1]))
    return _Scored(rival, tuple(halves[e, s][used[e, s]] for e, s in held_out))
