"""Transmission zeros of the 2014 paper (Lemma 1, section 3.4.1), and what they forbid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jaxsim.findings import (
    Findings,
    Group,
    Row,
    above,
    against_paper,
    below,
    claim,
    measured,
    near,
)
from jaxsim.linear.joints import JointSystem, plant, transmission_zeros
from jaxsim.linear.stability import abscissa, stable_gains, stable_intervals
from jaxsim.linear.state_space import per_axis, poles
from jaxsim.linear.torque_loop import closed_loop, torque_dynamics
from jaxsim.linear.zeros import zeros
from jaxsim.reproduction import _joints_2014 as paper

HALF = 5.1e-5  # half a unit of the fourth decimal, and rounding
STRAIGHT, FOLDED = (0.5 * math.pi, 0.5 * math.pi), (1.8, 2.1)
# Rightmost first, as printed; within: half a unit of the last printed digit.
PRINTED: dict[str, list[tuple[complex, float]]] = {
    "hanging": [(-0.0304 - 3.0036j, HALF), (-0.0304 + 3.0036j, HALF), (-0.2037 - 7.4767j, HALF),
                (-0.2037 + 7.4767j, HALF)],
    "more_BL": [(-0.9408 - 3.3033j, HALF), (-0.9408 + 3.3033j, HALF), (-2.4747, HALF),
                (-17.29, 5e-3)],
    "KL0": [(0.0, HALF), (0.0, HALF), (-0.0186, HALF), (-0.4496, HALF)],
    "straight": [(3.38893, 5e-6), (0.0, HALF), (-0.0919, HALF), (-3.5042, HALF)],
    "folded": [(3.4511, HALF), (2.3118, HALF), (-2.4371, HALF), (-3.5034, HALF)],
}  # fmt: skip
ABOUT = {
    "hanging": "theta_L = (0, 0.5), B_L = 0.01",
    "more_BL": "theta_L = (0, 0.5), B_L = diag(0.8, 0.4)",
    "KL0": "theta_L = (0, 0.5), K_L = 0",
    "straight": "theta_L = (pi/2, pi/2), K_L singular and negative semidefinite",
    "folded": "theta_L = (1.8, 2.1), K_L negative definite",
}
OPEN_LOOP = {"straight": (0.0361,), "folded": (0.0449, 0.0077)}


class TransmissionZeros(Group):
    """Zeros by the roots of det(Lambda_L); the state space's reduction is the second way."""

    paper = paper.PAPER
    title = "transmission zeros of the arm (Lemma 1, section 3.4.1)"

    def find(self) -> Findings:
        systems = cases()
        rows = [row for name, system in systems.items() for row in _zeros(name, system)]
        rows += [row for name in OPEN_LOOP for row in _open_loop(name, systems[name])]
        rows += [row for name in OPEN_LOOP for row in _held(name, systems[name])]
        return Findings([*rows, *_claims(systems)], {})


def cases() -> dict[str, JointSystem]:
    """The operating points of section 3.4.1."""
    return {
        "hanging": paper.arm(),
        "more_BL": paper.arm(B_L=(0.8, 0.4)),
        "KL0": paper.arm(K_L=False),
        "straight": paper.arm(STRAIGHT),
        "folded": paper.arm(FOLDED),
    }


def _zeros(name: str, system: JointSystem) -> list[Row]:
    rows = []
    for n, (zero, (printed, within)) in enumerate(
        zip(transmission_zeros(system), PRINTED[name], strict=True), start=1
    ):
        note = ABOUT[name]
        if printed == 3.38893:
            note += "; the paper prints 3.38893, its own matrices give 3.38931"
        for part in ("real", "imag"):
            rows.append(
                against_paper(
                    f"zeros.{name}.{n}.{part[:2]}", f"transmission zero {n}, {part} part", "1/s",
                    getattr(zero, part), getattr(complex(printed), part), within, note,
                )
            )  # fmt: skip
    return rows


def _open_loop(name: str, system: JointSystem) -> list[Row]:
    found = np.real(poles(plant(system)))
    return [
        against_paper(
            f"open_loop.{name}.unstable_{n}", f"unstable eigenvalue {n} without law", "1/s",
            found[n - 1], printed, HALF, ABOUT[name],
        )
        for n, printed in enumerate(OPEN_LOOP[name], start=1)
    ]  # fmt: skip


def _motor_spring(system: JointSystem) -> tuple[np.ndarray, np.ndarray]:
    """A and the slope of A with K_theta of v = -K_theta theta_M on each motor."""
    s = plant(system).channel(per_axis("theta_M", 2), per_axis("command", 2))
    return s.A, -s.B @ s.C


def _held(name: str, system: JointSystem) -> list[Row]:
    """Where a spring at the motors alone holds the load; laws.motor_position."""
    ((low, high),) = stable_intervals(*_motor_spring(system))
    note = f"v = -K_theta theta_M without torque law, {ABOUT[name]}"
    return [
        measured(f"motor_position.{name}.{edge}_V_rad", f"{words} stable K_theta", "V/rad", value,
                 note)
        for edge, words, value in (("low", "least", low), ("high", "largest", high))
    ]  # fmt: skip


def _claims(systems: dict[str, JointSystem]) -> list[Row]:
    return [
        _lemma_1(systems), *_stiffness(systems), _position(systems["folded"]),
        _cancelled(systems["hanging"]),
    ]  # fmt: skip


def _position(system: JointSystem) -> Row:
    A, slope = _motor_spring(system)
    right = np.real(transmission_zeros(system)).max()
    return claim(
        "motor_position_sufficient", "rightmost pole at K_theta = 0.1 V/rad, (1.8, 2.1)", "1/s",
        abscissa(A + 0.1 * slope), below(0.0),
        "3.4.1: 'a motor position feedback would be sufficient', and 'state feedback does not "
        f"change the system zeros': one stays at {right:.4f} 1/s",
    )  # fmt: skip


def _lemma_1(systems: dict[str, JointSystem]) -> Row:
    """The reduction of the state space knows nothing of Lemma 1."""
    names = per_axis("T_s", 2), per_axis("command", 2)
    worst = max(
        _apart(zeros(plant(s).channel(*names)), transmission_zeros(s)) for s in systems.values()
    )
    quote = "Lemma 1: zeros from voltage to torque are 'the roots of the polynomial det(Lambda_L)'"
    told = "zeros of the state space, largest distance to those of Lemma 1, all cases"
    return claim("lemma_1", told, "1/s", worst, near(0.0, 1e-7), quote)


def _apart(a: Sequence[complex] | np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(np.sort_complex(np.asarray(a)) - np.sort_complex(b)).max())


def _stiffness(systems: dict[str, JointSystem]) -> list[Row]:
    """Where the load stiffness is singular or negative."""
    law = paper.FULL.scaled(paper.K_O)
    hidden = int((np.abs(poles(closed_loop(systems["KL0"], law))) < 1e-9).sum())
    seen = abscissa(torque_dynamics(systems["KL0"], law))
    negative = np.real(poles(closed_loop(systems["folded"], law)))
    intervals = stable_gains(systems["folded"], paper.FULL)
    return [
        claim(
            "internally_unstable_KL0", "eigenvalues at 0 with full feedback, K_L = 0", "1", hidden,
            near(2.0, 0.0), "3.4.1: 'the overall system is not internally stable since there are "
            f"zero eigenvalues'; all that the torque sees decays, slowest at {seen:.4f} 1/s",
            paper=2.0,
        ),
        claim(
            "unstable_negative_KL", "rightmost pole with full feedback, theta_L = (1.8, 2.1)",
            "1/s", negative[0], above(0.0), "3.4.1: 'when K_L <= 0 the positive feedback "
            f"compensation does not seem to be a suitable strategy'; stable k_o: {intervals}, none",
        ),
    ]  # fmt: skip


def _cancelled(system: JointSystem) -> Row:
    loop = poles(closed_loop(system, paper.FULL.scaled(paper.K_O)))
    worst = max(float(np.abs(loop - z).min()) for z in transmission_zeros(system))
    quote = "Lemma 3: 'transmission zeros are cancelled by the load dynamic poles'; Fig. 11"
    told = "full feedback: largest distance of a zero to the next pole"
    return claim("zeros_cancelled", told, "1/s", worst, near(0.0, 1e-7), quote)
