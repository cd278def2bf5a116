"""A Pareto front: what does a lower torque in the gear cost in speed?

Seven laws between the fastest and the softest one, each found under the study's limits on all eight
drives. No law that was looked at beats one of them in both goals; the paper's gains lie beside the
fast end.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from tuning.commands.pareto import command

STUDY = """
name = "front"
drive.preset = "bench_2018"
law.file = "bench_switched"
scenario.duration = 0.3
scenario.reference = { type = "step", size = 0.30, at = 0.010 }

[objective.minimise]
itae_rad_s2 = 1.0

[objective.limits]
overshoot_pct = 3.0

[tune]
iterations = 25
free.K_B = { lower = -3.0, upper = 0.0 }
free.K_P = { lower = 2.0, upper = 20.0 }

[tune.drives]
count = 8
spread = { half_gap = "20 %", K = "20 %" }
"""


def main(out: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        study, found = Path(folder) / "front.toml", Path(folder) / "found"
        study.write_text(STUDY, "utf-8")
        # As a command: gearlash pareto front.toml --between ... --and ... --out found
        command(str(study), "itae_rad_s2", "largest_torque_Nm", found, points=7, starts=1)
        out.mkdir(parents=True, exist_ok=True)
        shutil.copy(found / "pareto.png", out / "pareto_front.png")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/examples"))
