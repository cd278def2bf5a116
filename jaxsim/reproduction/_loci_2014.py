"""Root loci drawn as in the 2014 paper: crosses where they start, circles for the zeros."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxsim.findings import Draw
from jaxsim.linear.joints import JointSystem, transmission_zeros
from jaxsim.linear.stability import Roots, root_locus
from jaxsim.linear.torque_loop import TorqueLaw, characteristic
from jaxsim.plots import locus
from jaxsim.reproduction._panel import panel


class View(NamedTuple):
    """Limits of the axes, 1/s: real and imaginary."""

    real: tuple[float, float]
    imag: tuple[float, float]


def over_gain(system: JointSystem, law: TorqueLaw) -> Roots:
    """k_o -> poles of Lemma 6."""
    return lambda k: characteristic(system, law.scaled(k)).roots()


def over_alpha(system: JointSystem, law: TorqueLaw) -> Roots:
    """alpha -> poles of Lemma 6, one weight for all three terms."""
    return lambda alpha: characteristic(system, law.weighted(alpha)).roots()


def loci(
    roots: Callable[[float], np.ndarray], values: np.ndarray, system: JointSystem, view: View,
    name: str, title: str, caption: str,
) -> Draw:  # fmt: skip
    """Draws the branches over a parameter; the system gives the zeros."""

    def draw(path: Path) -> None:
        with panel(path, title, caption, size=(6.6, 4.6)) as ax:
            branches = root_locus(roots, values)
            locus(ax, branches, values, name)
            found = transmission_zeros(system)
            ax.plot(
                np.real(found), np.imag(found), "o", markerfacecolor="none", color="C1",
                markersize=8, label="transmission zeros",
            )  # fmt: skip
            ax.axvline(0.0, color="0.35", linewidth=0.9)
            ax.set(xlabel="real [1/s]", ylabel="imaginary [1/s]", xlim=view.real, ylim=view.imag)
            ax.legend(loc="best")

    return draw
