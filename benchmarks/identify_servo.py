"""What each part of the servo's model is worth: left out, the rest fitted anew.

    python benchmarks/identify_servo.py FOLDER [--parts NAME ...] [--out FILE]

FOLDER holds raw_100hz.npz. The whole model is `gearlash identify sts3215_servo --logs FOLDER`; here
the same study is fitted without a part, which stands at the number given below, and without the
profile. The fitted runs decide what belongs to the model; the held-out ones are only looked at.
"""

from __future__ import annotations

import argparse
import copy
import json
from pathlib import Path
from typing import Any

import numpy as np

import jaxsim
from jaxsim.study import Study, from_table
from tuning.identification.session import Outcome, identify
from tuning.identification.spec import read_spec

STUDY = "sts3215_servo"
# What is no longer free, and where it stands.
PARTS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "nothing": ((), {}),
    "delay of the command": (("reference.delay",), {"scenario.reference.delay": 0.0}),
    "slew limit of the goal": (("slew",), {"law.slew": 100.0}),
    "speed-dependent stick (Stribeck)": (("ws",), {"drive.motor.ws": 1e-2}),
    "friction that grows with the load": (
        ("share",), {"drive.motor.driving": 0.0, "drive.motor.driven": 0.0},
    ),
    "sag at full duty": (("sag",), {"law.sag": 0.0}),
    "half gap": (("half_gap",), {"drive.transmission.half_gap": 0.0}),
}  # fmt: skip


def without(study: Study, part: str) -> Study:
    """The study without a part."""
    gone, fixed = PARTS[part]
    table = copy.deepcopy(study.table)
    for name in gone:
        del table["identify"]["free"][name]
    for path, value in fixed.items():
        *owners, field = path.split(".")
        at = table
        for owner in owners:
            at = at[owner]
        at[field] = value
    table["identify"]["profile"] = []
    return from_table(table, study.folder, study.name)


def mean_absolute(outcome: Outcome, logs: np.ndarray) -> float:
    """Over all readings that are used, mrad."""
    left = np.abs(outcome.evaluation.residuals[0][logs]) * outcome.problem.readings.noise[0, 0]
    return float(1e3 * left.sum() / outcome.problem.readings.used[logs].sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="of raw_100hz.npz")
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--out", type=Path, help="JSON; what it holds already is kept")
    options = parser.parse_args()
    jaxsim.configure()
    study = jaxsim.load(STUDY)
    out = options.out
    found: dict[str, Any] = json.loads(out.read_text()) if out and out.exists() else {}
    for part in options.parts:
        own = without(study, part)
        outcome = identify(own, read_spec(own)._replace(folder=options.folder))
        errors = {k: mean_absolute(outcome, getattr(outcome, k)) for k in ("train", "test")}
        shown = zip(outcome.names, outcome.values.tolist(), strict=True)
        found[part] = {**errors, "parameters": dict(shown)}
        print(f"without {part}: {errors['train']:.2f}, {errors['test']:.2f} mrad", flush=True)
        if out:
            out.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
