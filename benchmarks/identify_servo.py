"""What each part of the servo's model is worth: left out, the rest fitted anew.

    python benchmarks/identify_servo.py FOLDER [--out FILE]

FOLDER holds raw_100hz.npz. The whole model is `gearlash identify sts3215_servo --logs FOLDER`. Here
all models without a part are fitted side by side from what that found: a part that is left out is
an unknown that stands where it does nothing. The fitted runs decide what belongs to the model; the
held-out ones are only looked at.
"""

from __future__ import annotations

import argparse
import copy
import json
from pathlib import Path
from typing import Any

import numpy as np

import jaxsim
from jaxsim.hybrid import Exact
from jaxsim.study import from_table
from tuning.identification.estimator import Stage, fit
from tuning.identification.mapping import experiments
from tuning.identification.residuals import Problem
from tuning.identification.spec import read_free, read_spec

STUDY = "sts3215_servo"
# The unknown of each part, where it does nothing, and bounds that reach there.
PARTS: dict[str, tuple[str, float, dict[str, float]]] = {
    "delay of the command": ("reference.delay", 0.0, {"lower": 0.0}),
    "slew limit of the goal": ("slew", 100.0, {"upper": 110.0}),
    "speed-dependent stick (Stribeck)": ("ws", 1e-2, {"lower": 5e-3}),
    "friction that grows with the load": ("share", 0.0, {}),
    "sag at full duty": ("sag", 0.0, {}),
    "half gap": ("half_gap", 0.0, {"lower": 0.0}),
}
ITERATIONS, TOLERANCE = 12, 1e-4


def problem_of(folder: Path) -> tuple[Problem, np.ndarray, np.ndarray]:
    """The study's problem with bounds that reach to where parts do nothing; fitted, held out."""
    table = copy.deepcopy(jaxsim.load(STUDY).table)
    for name, _, bounds in PARTS.values():
        table["identify"]["free"][name] |= bounds
    study = from_table(table, folder, STUDY)
    spec = read_spec(study)
    recorded, dt = experiments(study, spec)
    logs = [r.experiment for r in recorded]
    exact = study.run.deadzone
    assert isinstance(exact, Exact)
    problem = Problem(logs, read_free(spec, logs[0]), dt=dt, exact=exact)
    held_out = np.array([r.use == "test" for r in recorded])
    return problem, np.flatnonzero(~held_out), np.flatnonzero(held_out)


def leave_out(problem: Problem, train: np.ndarray) -> np.ndarray:
    """(1 + parts, P): all parts, then each of them left out, fitted to the same runs."""
    names = problem.unknowns.names
    starts = np.tile(problem.initial(), (1 + len(PARTS), 1))
    frozen = np.zeros(starts.shape, bool)
    for k, (name, nothing, _) in enumerate(PARTS.values(), start=1):
        starts[k, names.index(name)] = nothing
        frozen[k, names.index(name)] = True
    found = fit(
        problem, starts, who=np.tile(train, (len(starts), 1)), stages=(Stage(),), frozen=frozen,
        loss=read_spec(jaxsim.load(STUDY)).search.loss, iterations=ITERATIONS,
        tolerance=TOLERANCE, tell=lambda p: print(f"  {p.iteration}: {p.moving} move", flush=True),
    )  # fmt: skip
    return found.values


def mean_absolute(problem: Problem, values: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """(1 + parts,) over all readings that are used, mrad."""
    who = np.tile(logs, (len(values), 1))
    left = np.abs(problem.evaluate(values, who=who).residuals).sum(axis=(1, 2, 3))
    return 1e3 * problem.readings.noise[0, 0] * left / problem.readings.used[logs].sum()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="of raw_100hz.npz")
    parser.add_argument("--out", type=Path, help="JSON")
    options = parser.parse_args()
    jaxsim.configure()
    problem, train, test = problem_of(options.folder)
    values = leave_out(problem, train)
    errors = [mean_absolute(problem, values, logs) for logs in (train, test)]
    result: dict[str, Any] = {}
    for name, own, fitted, held_out in zip(["nothing", *PARTS], values, *errors, strict=True):
        print(f"without {name}: {fitted:.2f} mrad fitted, {held_out:.2f} mrad held out", flush=True)
        parameters = dict(zip(problem.unknowns.names, own.tolist(), strict=True))
        result[name] = {"fitted": fitted, "held out": held_out, "parameters": parameters}
    if options.out:
        options.out.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
