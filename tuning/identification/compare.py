"""Structures against each other: fitted to the same logs, judged by those held out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxsim.components import read_toml
from jaxsim.errors import InputError
from jaxsim.study import Study, from_table, locate
from tuning.identification.estimator import Fit, fit
from tuning.identification.session import Outcome, Tell, identify
from tuning.identification.spec import Spec, read_spec


class Rival(NamedTuple):
    """One structure.

    train, test: half the mean square residual per reading, in the noise of the study's own
    structure; nan where nothing was held out or the fit failed (`remark` says why).
    """

    name: str
    unknowns: int
    train: float
    test: float
    remark: str


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
    rivals = [_scored("this study", own, noise)]
    for name, file in spec.structures.items():
        try:
            other = _other(study, file)
            found = identify(other, read_spec(other), tell, fitted)
            rivals.append(_scored(name, found, noise))
        except InputError as error:
            rivals.append(Rival(name, 0, float("nan"), float("nan"), str(error)))
    return sorted(rivals, key=lambda r: (np.isnan(r.test), r.test, r.train))


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


def _scored(name: str, outcome: Outcome, noise: np.ndarray) -> Rival:
    own = outcome.problem.readings.noise / noise
    r = outcome.evaluation.residuals[0] * own[..., None]
    used = outcome.problem.readings.used

    def loss(rows: np.ndarray) -> float:
        count = used[rows].sum()
        return 0.5 * float((r[rows] ** 2).sum()) / count if count else float("nan")

    return Rival(name, len(outcome.shown), loss(outcome.train), loss(outcome.test), "")
