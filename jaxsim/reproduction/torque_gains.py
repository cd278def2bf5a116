"""Gammas and the Routh-Hurwitz bounds of the 2014 paper, Fig. 2."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxsim.findings import Findings, Group, Row, against_paper, against_reference, claim, near
from jaxsim.linear import routh
from jaxsim.linear.torque_loop import Q_c, TorqueLaw
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.reproduction._panel import panel

UNITS = {"j": "V s^3/rad", "a": "V s^2/rad", "v": "V s/rad"}
LEG = {"j": (3.975e-5, 5e-9), "a": (0.054354, 5e-7), "v": (6.909329, 5e-7)}
ARM = {"j": 1.62380e-5, "a": 0.0337173, "v": 6.198488}


class TorqueGains(Group):
    """What the drives alone decide: (10), (21), (22)."""

    paper = paper.PAPER
    title = "Gammas and the stability region of the PI gains ((10), (21), (22), Fig. 2)"
    figures = ("fig14_2",)

    def find(self) -> Findings:
        return Findings([*_gammas(), *_bounds()], {"fig14_2": _draw})


def _gammas() -> list[Row]:
    arm, leg = paper.arm().gammas(), paper.leg().gammas()
    rows = []
    for name, value in zip("jav", arm, strict=True):
        row = against_reference(
            f"gammas.{name}", f"Gamma_{name} of the arm's drives", UNITS[name], value[0],
            ARM[name], paper.ERRATA,
        )  # fmt: skip
        rows.append(row)
    for name, value in zip("jav", leg, strict=True):
        note = "the drive that gives all three printed Gammas with the R, K_t, N of section 3"
        rows.append(
            against_paper(
                f"gammas.leg_{name}", f"Gamma_{name} of the leg's drive", UNITS[name],
                value[0], *LEG[name], note,
            )
        )  # fmt: skip
    return rows


def _bounds() -> list[Row]:
    arm = paper.arm()
    K_p, K_i = routh.K_p_max(arm)[0], routh.K_i_max(arm, paper.K_O)[0]
    first, second = _edge_K_p(K_p), _edge_K_i(K_i)
    note = "(22) with K_p a_2^2 in the last denominator; the paper prints K_p^2 a_2^2"
    printed = K_i / paper.K_O
    limit = against_paper(
        "routh.kp_max", "largest K_p with a stable K_i", "V/Nm", K_p, 14.0, 0.5, "3.1: 'is 14'"
    )
    at_2 = Row("routh.ki_max_at_kp2", "largest K_i at K_p = 2", "1/s", None, K_i, None, None, note)
    wrong = np.real(Q_c(arm, TorqueLaw(paper.K_O, printed)).roots())[0]
    return [
        paper.two_ways(limit, first),
        paper.two_ways(at_2, second),
        claim(
            "routh_22_as_printed", "rightmost root of Q_c at (22) as printed, K_p = 2", "1/s",
            wrong, near(0.0, 1e-3),
            f"(22) as printed gives K_i < {printed:.4g} 1/s at K_p = 2, but the loop stays stable "
            f"up to {K_i:.4g} 1/s: K_p^2 there should be K_p",
        ),
    ]  # fmt: skip


def _edge_K_p(near_by: float) -> float:
    """Where the roots of Q_c cross for K_i -> 0, bisected; K_i = 1e-9 1/s."""
    return _bisected(lambda K_p: TorqueLaw(K_p, 1e-9), near_by)


def _edge_K_i(near_by: float) -> float:
    return _bisected(lambda K_i: TorqueLaw(paper.K_O, K_i), near_by)


def _bisected(law: Callable[[float], TorqueLaw], near_by: float) -> float:
    """The gain at which the fast pair of Q_c crosses the axis: the second method."""
    from scipy.optimize import brentq

    def height(gain: float) -> float:
        roots = Q_c(paper.arm(), law(gain)).roots()
        return float(np.real(roots[np.abs(np.imag(roots)) > 1.0]).max())

    return float(brentq(height, 0.8 * near_by, 1.2 * near_by, xtol=1e-12))  # type: ignore[arg-type]


def _draw(path: Path) -> None:
    K_p, K_i = routh.stability_region(paper.arm(), 400)
    caption = (
        "2014 paper, Fig. 2, for either joint under full positive feedback: (21) and (22), the "
        "latter with K_p a_2^2 in its last denominator (the paper prints K_p^2 a_2^2). Dots: the "
        "gains of (34) at k_o = 2."
    )
    with panel(path, "Stability region of the PI torque gains", caption) as ax:
        ax.fill_between(K_p[:, 0], 1e-1, K_i[:, 0], alpha=0.15, color="C0", label="stable")
        ax.plot(K_p[:, 0], K_i[:, 0], color="C0")
        ax.plot([paper.K_O] * 2, paper.K_I, "o", color="C1", label="used: joint 1, joint 2")
        ax.axvline(routh.K_p_max(paper.arm())[0], color="0.4", linestyle=":", label="K_p,max")
        ax.set(xlabel="K_p [V/Nm]", ylabel="K_i [1/s]", xlim=(0.0, 15.0), ylim=(1.0, 1e4))
        ax.set_yscale("log")
        ax.legend()
