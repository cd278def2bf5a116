"""Section III.C.3 of the 2018 paper: free responses from the cells of the state space, Fig. 8."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxsim.findings import Draw, Findings, Group, Row, below, claim, measured
from jaxsim.laws.pd import PD
from jaxsim.plots import COLOURS
from jaxsim.reproduction import _bench_2018 as bench
from jaxsim.reproduction._draw_2018 import METHOD
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run
from jaxsim.scenario import Start

SPEEDS = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))  # omega_B, omega_L, rad/s
DEFLECTIONS = {"a": 0.0, "b": 0.010}  # Fig. 8(a): in the gap; Fig. 8(b): in positive contact
# 1..4 as the paper lists them.
CASES = {
    f"{part}{i + 1}": Start(0.0, omega_L, theta_B, omega_B)
    for part, theta_B in DEFLECTIONS.items()
    for i, (omega_B, omega_L) in enumerate(SPEEDS)
}
METRICS = ("theta_max_rad", "theta_min_rad", "largest_torque_Nm")
FINAL = {
    "theta_L": "rad",
    "theta_B": "rad",
    "omega_L": "rad/s",
    "omega_B": "rad/s",
}
LOOPS = {
    "": "PD to reference 0 and switched damping",
    "_damping_only": "switched damping alone, no position loop",
}
STYLES = (
    (COLOURS["none"], "-"),
    (COLOURS["linear"], "--"),
    (COLOURS["switched"], "-."),
    (COLOURS["limit"], (0, (1, 1))),
)


class Free(Group):
    """Eight starts, with the position loop and without."""

    paper = bench.PAPER
    title = "free responses from eight cells, simulation (section III.C.3, Fig. 8)"
    figures = ("fig_8a", "fig_8b")

    def find(self) -> Findings:
        found = {
            suffix: dict(zip(CASES, _runs(pd), strict=True))
            for suffix, pd in (("", bench.gains()), ("_damping_only", _no_position_loop()))
        }
        numbers = [
            row
            for suffix, runs in found.items()
            for case, run in runs.items()
            for row in _numbers(f"free.{case}{suffix}", run, _reading(case, suffix))
        ]
        figures = {f"fig_8{part}": _figure(part, found[""]) for part in DEFLECTIONS}
        return Findings([*numbers, *_claims(found)], figures)


def _no_position_loop() -> PD:
    """Gains 0 in place of no PD: the same program, and T_M = T_B."""
    return PD(0.0, 0.0, bench.gains().tau_D)


def _runs(pd: PD) -> list[Run]:
    laws = [bench.control("switched", pd=pd)] * len(CASES)
    return bench.runs(laws, [bench.scenario(start=start) for start in CASES.values()])


def _reading(case: str, suffix: str) -> str:
    start = CASES[case]
    return (
        f"start theta_B = {1e3 * float(start.theta_B):g} mrad, omega_B = {float(start.omega_B):+g}"
        f", omega_L = {float(start.omega_L):+g} rad/s, theta_L = 0; {LOOPS[suffix]}; 1.2 s"
    )


def _numbers(prefix: str, run: Run, note: str) -> list[Row]:
    rows = [
        measured(f"{prefix}.{name}", *bench.QUANTITIES[name], bench.metric(run, name), note)
        for name in METRICS
    ]
    return rows + [
        measured(
            f"{prefix}.final_{name}_{unit.replace('/', '_')}",
            f"{name} at 1.2 s",
            unit,
            run.signals[name][-1],
            note,
        )
        for name, unit in FINAL.items()
    ]


def _largest(runs: Mapping[str, Run], name: str, after: float) -> float:
    return max(float(np.max(np.abs(r.signals[name][r.time >= after]))) for r in runs.values())


def _claims(found: Mapping[str, Mapping[str, Run]]) -> list[Row]:
    position, alone = found[""], found["_damping_only"]
    shares = {
        name: _largest(position, name, 0.9) / _largest(position, name, 0.0)
        for name in ("theta_L", "omega_L", "omega_B")
    }
    speed = max(_largest(alone, name, 0.9) for name in ("omega_L", "omega_B"))
    inside = _largest(position, "theta_B", 0.9)
    quote = "III.C.3: 'Figure 8 indicate the convergence of the typical trajectories'"
    return [
        claim(
            "free_convergence",
            "largest |theta_L|, |omega_L|, |omega_B| from 0.9 s on over that of the run, all cases",
            "1",
            max(shares.values()),
            below(0.1),
            f"{quote}. True, but slowly: as about 1/t, to theta_L = 0",
        ),
        claim(
            "free_gap_undetermined",
            "largest |theta_B| from 0.9 s on",
            "rad",
            inside,
            below(0.00788),
            "reading: theta_B stays anywhere inside the gap, so the limit is a set, not a point",
        ),
        claim(
            "free_convergence_damping_only",
            "largest |omega_L| or |omega_B| from 0.9 s on, all cases",
            "rad/s",
            speed,
            below(1e-6),
            f"{quote}, with the damping law alone: the speeds die out exponentially, theta_L does "
            "not return (nothing asks it to)",
        ),
    ]


def _figure(part: str, runs: Mapping[str, Run]) -> Draw:
    where = "backlash mode" if part == "a" else "contact mode"
    caption = (
        f"2018 paper, Fig. 8({part}): start at θ_B = {1e3 * DEFLECTIONS[part]:g} mrad (circles), "
        "θ_L = 0; legend: (ω_B, ω_L) at the start in rad/s. Reading: PD to reference 0 and "
        "switched damping, K_B = -0.80. The shaded band is the gap. The paper's axes are not in "
        f"its text: these phase planes are our choice. {METHOD}"
    )

    def draw(path: Path) -> None:
        size = (9.6, 4.3)
        title = f"Free responses, start in {where}"
        with panel(path, title, caption, columns=2, size=size) as axes:
            cases = [name for name in runs if name.startswith(part)]
            for case, (colour, style) in zip(cases, STYLES, strict=True):
                _trajectory(axes, runs[case], case, colour, style)
            _finish(axes)

    return draw


def _trajectory(axes: np.ndarray, run: Run, case: str, colour: str, style: object) -> None:
    start = CASES[case]
    label = f"({float(start.omega_B):+g}, {float(start.omega_L):+g})"
    for ax, x, scale in ((axes[0], "omega_L", 1.0), (axes[1], "theta_B", 1e3)):
        horizontal, vertical = scale * run.signals[x], run.signals["omega_B"]
        ax.plot(horizontal, vertical, color=colour, linestyle=style, linewidth=1.2, label=label)
        ax.plot(
            horizontal[0], vertical[0], "o", color=colour, markerfacecolor="white", markersize=6
        )


def _finish(axes: np.ndarray) -> None:
    speed = r"torsional speed $\omega_B$ [rad/s]"
    axes[0].set(xlabel=r"load-side speed $\omega_L$ [rad/s]", ylabel=speed)
    axes[1].set(xlabel=r"torsional angle $\theta_B$ [mrad]")
    axes[1].axvspan(-7.8, 7.8, color="0.93", zorder=0)
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
    for ax in axes:
        ax.plot(0.0, 0.0, "+", color="black", markersize=8)
