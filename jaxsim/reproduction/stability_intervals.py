"""Where k_o of (34) is stable under full and partial positive feedback; Figs. 11-14."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxsim.findings import Draw, Findings, Group, Row, above, against_paper, claim, measured, near
from jaxsim.linear.joints import JointSystem
from jaxsim.linear.stability import (
    Interval,
    bisected_intervals,
    stable_gains,
    stable_gains_bisected,
)
from jaxsim.linear.torque_loop import TorqueLaw
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.reproduction._loci_2014 import View, loci, over_alpha, over_gain

GRID = np.geomspace(1e-5, 40.0, 200)


class Setting(NamedTuple):
    """A system and its law at k_o = 1."""

    system: JointSystem
    law: TorqueLaw


class StabilityIntervals(Group):
    """Edges by generalised eigenvalues; by roots of Lemma 6 between grid points as second way."""

    paper = paper.PAPER
    title = "stability under approximate positive feedback (section 3.4.2, Figs. 11-14)"
    figures = (
        "fig14_11a", "fig14_11b", "fig14_12a", "fig14_12b", "fig14_13", "fig14_14a", "fig14_14b",
    )  # fmt: skip

    def find(self) -> Findings:
        settings = cases()
        found = {name: stable_gains(*setting) for name, setting in settings.items()}
        rows = [row for name in found for row in _edges(name, settings[name], found[name])]
        return Findings([*rows, *_claims(found)], _figures(settings))


def cases() -> dict[str, Setting]:
    """All cases of section 3.4.2, and what completes them."""
    arm, ten, free = paper.arm(), paper.arm(more_L=10.0), paper.arm(K_L=False)
    damped, ten_damped = paper.arm(B_L=(0.8, 0.4)), paper.arm(more_L=10.0, B_L=(0.1, 0.1))
    return {
        "full": Setting(arm, paper.FULL),
        "none": Setting(arm, paper.NONE),
        "no_jerk": Setting(arm, paper.NO_JERK),
        "velocity_only": Setting(arm, paper.VELOCITY_ONLY),
        "velocity_only_more_BL": Setting(damped, paper.VELOCITY_ONLY),
        "no_jerk_10L": Setting(ten, paper.NO_JERK),
        "no_jerk_10L_BL0.1": Setting(ten_damped, paper.NO_JERK),
        "full_10L": Setting(ten, paper.FULL),
        "none_10L": Setting(ten, paper.NONE),
        "no_jerk_KL0": Setting(free, paper.NO_JERK),
        "velocity_only_KL0": Setting(free, paper.VELOCITY_ONLY),
    }


PRINTED = {
    ("velocity_only", 1): (0.00073, 5e-6),
    ("velocity_only", 2): (7.5196, 1e-4),  # 7.51953: the last digit is one off
    ("velocity_only", 3): (12.53, 5e-3),
}


def edges(intervals: list[Interval]) -> list[float]:
    """The ends of the intervals but 0 and infinity, ascending."""
    return [edge for pair in intervals for edge in pair if 0.0 < edge < np.inf]


def _edges(name: str, setting: Setting, intervals: list[Interval]) -> list[Row]:
    bisected = [e for e in edges(stable_gains_bisected(*setting, GRID)) if e not in GRID]
    told = ", ".join(f"({low:.6g}, {high:.6g})" for low, high in intervals)
    rows = []
    pairs = zip(edges(intervals), bisected, strict=True)
    for n, (edge, other) in enumerate(pairs, start=1):
        about = f"intervals.{name}.edge{n}", f"k_o at which stability changes, {n}", "1", edge
        note = f"stable on {told}"
        row = measured(*about, note)
        if (name, n) in PRINTED:
            row = against_paper(*about, *PRINTED[name, n], note)
        rows.append(paper.two_ways(row, other))
    return rows


def _claims(found: Mapping[str, list[Interval]]) -> list[Row]:
    alphas = bisected_intervals(
        over_alpha(paper.arm(), paper.FULL.scaled(paper.K_O)), np.linspace(1e-6, 1.0, 201)
    )
    width = sum(high - low for low, high in alphas)
    top = {name: intervals[0][1] for name, intervals in found.items()}
    bounded = above(6.0)
    return [
        claim("stable_all_alpha", "share of alpha in [0, 1] that is stable, k_o = 2", "1", width,
              near(1.0, 1e-5), "3.4.2: 'remains stable for all alpha in [0, 1]'"),
        claim("no_jerk_stable", "stable without jerk up to k_o", "1", top["no_jerk"], bounded,
              "3.4.2: 'ignoring the jerk term does not produce an unstable closed loop', k_o to 6"),
        claim("none_stable", "stable without positive feedback up to k_o", "1", top["none"],
              bounded, "3.1: gains 'selected so that the closed loop system without positive "
              "feedback is also stable', k_o to 6"),
        claim("no_jerk_10L_conditional", "ten times L, no jerk: least stable k_o", "1",
              found["no_jerk_10L"][0][0], near(0.3, 0.2999),
              "3.4.2: 'k_o in the interval [0, 0.6] we arrive at a conditionally stable system'"),
        claim("no_jerk_10L_recovered", "the same with B_L = 0.1: stable from k_o = 0 up to", "1",
              _from_zero(found["no_jerk_10L_BL0.1"]), above(0.6),
              "3.4.2: 'could be recovered if the damping B_L were sufficiently large'"),
        claim("velocity_only_conditional", "velocity only: intervals of stable k_o", "1",
              len(found["velocity_only"]), near(2.0, 0.0),
              "3.4.2: unstable 'in the intervals (0.00073, 7.5196) and k_o > 12.53'", paper=2.0),
        claim("velocity_only_more_BL", "velocity only, B_L = diag(0.8, 0.4): stable up to k_o", "1",
              _from_zero(found["velocity_only_more_BL"]), bounded,
              "3.4.2: 'remains stable as shown in Fig. 14(a)', k_o to 6"),
        claim("no_jerk_KL0_stable", "K_L = 0, no jerk: stable up to k_o", "1",
              _from_zero(found["no_jerk_KL0"]), bounded,
              "3.4.2, conjecture: 'simulations without jerk feedback have not shown stability "
              "problems'; at this pose the edges prove it"),
        claim("velocity_only_KL0_stable", "K_L = 0, velocity only: stable up to k_o", "1",
              _from_zero(found["velocity_only_KL0"]), bounded,
              "3.4.2, conjecture: 'appears to remain stable'; at this pose the edges prove it"),
        _many_poses(),
    ]  # fmt: skip


def _from_zero(intervals: list[Interval]) -> float:
    """How far the stable interval that begins at zero reaches; 0 where none does."""
    return intervals[0][1] if intervals and intervals[0][0] == 0.0 else 0.0


def _many_poses() -> Row:
    """The conjecture for K_L = 0 at other elbow angles; M_L depends on no other angle."""
    least = min(
        _from_zero(stable_gains(paper.arm((0.0, q2), K_L=False), law))
        for q2 in np.linspace(0.0, np.pi, 9).tolist()
        for law in (paper.NO_JERK, paper.VELOCITY_ONLY)
    )
    return claim(
        "KL0_stable_at_all_elbows", "K_L = 0, nine elbow angles 0..pi: least upper edge of k_o",
        "1", least, above(6.0), "3.4.2, both conjectures for K_L = 0, at nine elbow angles",
    )  # fmt: skip


def _figures(settings: Mapping[str, Setting]) -> dict[str, Draw]:
    arm = paper.arm()
    alpha, gains = np.linspace(0.0, 1.0, 401), np.concatenate([[0.0], np.geomspace(1e-4, 6.0, 900)])
    weighted = over_alpha(arm, paper.FULL.scaled(paper.K_O))
    near_zeros, overall = View((-0.8, 0.4), (-9.0, 9.0)), View((-2300.0, 300.0), (-900.0, 900.0))

    def over(name: str, view: View, title: str, caption: str) -> Draw:
        system, law = settings[name]
        return loci(over_gain(system, law), gains, system, view, "k_o", title, caption)

    def fig_11(view: View, part: str) -> Draw:
        title = f"Root locus over alpha, {part}"
        told = f"2014 paper, Fig. 11, k_o = 2: {part}. Crosses: alpha = 0; triangles: alpha = 1."
        return loci(weighted, alpha, arm, view, "alpha", title, told)

    jerk, only = "without jerk feedback", "with velocity feedback only"
    return {
        "fig14_11a": fig_11(View((-0.8, 0.2), (-9.0, 9.0)), "near the transmission zeros"),
        "fig14_11b": fig_11(overall, "all poles"),
        "fig14_12a": over("no_jerk", near_zeros, f"Root locus over k_o {jerk}",
                          "2014 paper, Fig. 12(a), k_o from 0 (crosses) to 6 (triangles)."),
        "fig14_12b": over("no_jerk", View((-0.22, -0.02), (7.38, 7.56)),
                          f"Root locus over k_o {jerk}, near one zero",
                          "2014 paper, Fig. 12(b): the branch leaves towards the right and comes "
                          "to the zero; k_o from 0 (crosses) to 6 (triangles)."),
        "fig14_13": over("velocity_only", View((-2.0, 2.0), (-9.0, 9.0)),
                         f"Root locus over k_o {only}",
                         "2014 paper, Fig. 13: unstable on (0.00073, 7.5196); k_o from 0 (crosses) "
                         "to 6 (triangles)."),
        "fig14_14a": over("velocity_only_more_BL", View((-20.0, 4.0), (-12.0, 12.0)),
                          f"Root locus over k_o {only}, more B_L",
                          "2014 paper, Fig. 14(a), B_L = diag(0.8, 0.4): stable; k_o from 0 "
                          "(crosses) to 6 (triangles)."),
        "fig14_14b": over("velocity_only_more_BL", overall,
                          f"Root locus over k_o {only}, more B_L, all",
                          "2014 paper, Fig. 14(b), B_L = diag(0.8, 0.4); k_o from 0 (crosses) "
                          "to 6 (triangles)."),
    }  # fmt: skip
