"""Tune under hard limits: 64 drives, least ITAE, no more than 1.4 Nm in the gear on any of them.

The paper's gains exceed that on the worst drive. The tuned ones hold it on all of them and are
faster as well; the last lines say which limit holds the law back and what it costs.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import jaxsim
from jaxsim import plots
from tuning.result import conclude
from tuning.session import Session
from tuning.spec import read_spec
from tuning.words import sentences


def main(out: Path) -> None:
    jaxsim.configure()
    study = jaxsim.load("bench_switched")
    with tempfile.TemporaryDirectory() as folder:
        session = Session(study, read_spec(study), Path(folder) / "checkpoint.json")
        session.search(lambda _: None)
    result = conclude(session)
    for line in sentences(session, result):
        print(line)
    drive = session.problem.drive(result.worst.drive)
    laws = {"before": study.law, "after": result.law}
    runs = {name: jaxsim.simulate(drive, law, study.scenario) for name, law in laws.items()}
    signals = ("theta_L", "T_s", "T_M")
    plots.responses(out / "tune_under_limits.png", runs, signals, "The drive that decides")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/examples"))
