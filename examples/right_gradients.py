"""Why gradients fail at impacts, and how they are right: metrics over the half gap, with tangents.

The true curves come from many exact runs. Plain differentiation of a fixed-step run never sees that
the instants of contact move with the half gap: its slope of the largest torque is half of the true
one, and its slope of ITAE has the wrong sign.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxsim
from jaxsim import plots, tree

METRICS = ("largest_torque_Nm", "itae_rad_s2")
HALF_GAP = 7.8e-3
SPREAD = 0.15
MODES = {"exact": jaxsim.Exact(), "plain": jaxsim.Plain()}


def main(out: Path) -> None:
    jaxsim.configure()
    study = jaxsim.load("bench_switched")

    def metrics(half_gap: jax.Array, deadzone: Any) -> dict[str, jax.Array]:
        drive = tree.replace(study.drive, {"half_gap": half_gap})
        options = {"deadzone": deadzone, "metrics": METRICS, "store": None, "throw": False}
        return jaxsim.simulate(drive, study.law, study.scenario, **options).metrics

    slopes = {name: jax.jacfwd(metrics)(HALF_GAP, mode) for name, mode in MODES.items()}
    half_gaps = HALF_GAP * np.linspace(1.0 - SPREAD, 1.0 + SPREAD, 121)
    drives = jaxsim.spread(study.drive, half_gap=half_gaps)
    curves = jaxsim.simulate(drives, study.law, study.scenario, store=None).metrics
    for name in METRICS:
        difference = np.gradient(curves[name], half_gaps)[60]
        said = ", ".join(f"{mode} {float(slopes[mode][name]):.4g}" for mode in MODES)
        print(f"d({name})/d(half_gap): {said}, differences {difference:.4g} per rad")
    draw(out / "right_gradients.png", half_gaps, curves, slopes)


def draw(path: Path, half_gaps: np.ndarray, curves: Any, slopes: Any) -> None:
    near = HALF_GAP * np.array([-0.06, 0.06])
    looks = (("largest joint torque [Nm]", 1.0), ("ITAE [1e-6 rad s²]", 1e6))
    with plots.figure(path, 1, 2, size=(8.5, 3.4)) as axes:
        for ax, name, (label, scale) in zip(axes, METRICS, looks, strict=True):
            curve = scale * np.asarray(curves[name])
            height = np.interp(HALF_GAP, half_gaps, curve)
            ax.plot(1e3 * half_gaps, curve, color="black", label="exact runs")
            for mode, colour in (("exact", "#009E73"), ("plain", "#D55E00")):
                tangent = height + scale * float(slopes[mode][name]) * near
                ax.plot(1e3 * (HALF_GAP + near), tangent, "--", color=colour, label=f"{mode} slope")
            ax.plot(1e3 * HALF_GAP, height, "o", color="black")
            ax.set_xlabel("half gap [mrad]")
            ax.set_ylabel(label)
            ax.set_ylim(0.99 * curve.min(), 1.01 * curve.max())
        axes[0].legend()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/examples"))
