"""Poles of the closed loop in every mode of the 2018 paper's piecewise affine form."""

from __future__ import annotations

from jaxsim import pwa
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.findings import Findings, Group, Row, claim, measured, near
from jaxsim.laws.switched_damping import SwitchedDamping
from jaxsim.reproduction import _bench_2018 as bench

READING = (
    "PD and switched damping, K_B = -0.80, without the reference filter (it adds 2 pi 20 rad/s in "
    "every mode); negative contact has the poles of positive contact"
)


class Poles(Group):
    """Each mode by itself is stable but for the free motor angle; the switching is not in them."""

    paper = bench.PAPER
    title = "poles of the closed loop per mode (sections II.B and III.C.3)"

    def find(self) -> Findings:
        form = pwa.closed_loop(bench_2018(), bench.gains() + SwitchedDamping(bench.K_B))
        modes = {
            mode.replace("contact+", "contact").replace(" ", "_"): poles
            for mode, poles in form.poles().items()
            if "contact-" not in mode
        }
        cells = claim(
            "cells",
            "cells of the closed loop",
            "1",
            len(form.cells),
            near(12.0, 0.0),
            "III.C.3: 'the state space divided into 12 cells'",
            paper=12.0,
        )
        return Findings([*(row for mode in modes for row in _rows(mode, modes[mode])), cells], {})


def _rows(mode: str, poles: pwa.Array) -> list[Row]:
    """One row per real pole; real and imaginary part of the upper pole of each pair."""
    rows = []
    for k, pole in enumerate([p for p in poles if p.imag >= 0.0], start=1):
        parts = {"real": pole.real} | ({"imag": pole.imag} if pole.imag > 0.0 else {})
        rows += [
            measured(
                f"poles.{mode}.p{k}_{part}_rad_s", f"pole {k}, {part} part", "rad/s", v, READING
            )
            for part, v in parts.items()
        ]
    return rows
