"""What all groups of the 2018 paper share: its gains, its three laws, its scenarios, its runs."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxsim._simulate import simulate
from jaxsim.batch import stack
from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.findings import Row, measured
from jaxsim.law import Law
from jaxsim.laws.linear_damping import LinearDamping
from jaxsim.laws.pd import PD, place_poles
from jaxsim.laws.prefilter import Prefilter
from jaxsim.laws.switched_damping import SwitchedDamping
from jaxsim.run import Run
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.step import Step

PAPER = "Yamada, Ruderman, Fujimoto 2018"
KINDS = ("none", "linear", "switched")
K_B = -0.80
STEP, ONSET, SECOND = 0.30, 0.010, 0.15
LOADS = (-0.50, 1.0)  # the second ADDS to the first: net +0.50 Nm
DURATION = 1.2
# Values change by 1e-7 of their size when it is halved; 2.5 kHz is four steps.
DT = 1e-4
PERIOD = 1.0 / 2500.0

# Quantity and unit of the metrics that the tables show.
QUANTITIES = {
    "first_contact_s": ("time of the first contact", "s"),
    "entry_speed_rad_s": ("omega_B at the first contact", "rad/s"),
    "first_impact_Nm": ("largest T_s of the first contact", "Nm"),
    "first_separation_s": ("end of the first contact", "s"),
    "braking_contact_s": ("first contact on the other side", "s"),
    "braking_peak_Nm": ("peak T_s of the first contact on the other side", "Nm"),
    "largest_torque_Nm": ("largest |T_s| of the run", "Nm"),
    "theta_max_rad": ("largest theta_L", "rad"),
    "theta_min_rad": ("smallest theta_L", "rad"),
    "overshoot_pct": ("overshoot of theta_L", "%"),
    "t50_s": ("theta_L passes half of the step", "s"),
    "rise_10_90_s": ("rise time of theta_L, 10 to 90 %", "s"),
    "settle_2pct_s": ("settling time of theta_L, 2 %", "s"),
    "iae_rad_s": ("int |e| dt from 0.010 s to 1.2 s", "rad s"),
    "itae_rad_s2": ("int (t - 0.010 s)|e| dt to 1.2 s", "rad s2"),
    "command_max": ("largest T_M", "Nm"),
    "command_min": ("smallest T_M", "Nm"),
    "impact_loss_J": ("energy lost in contacts", "J"),
}
STEP_METRICS = tuple(name for name in QUANTITIES if name != "theta_min_rad")


@functools.cache
def gains() -> PD:
    """The PD law of section III.B: poles at 2 pi 18 rad/s and at 2 pi 15 rad/s, zeta = 0.70."""
    return place_poles(bench_2018(), 2.0 * math.pi * 18.0, 2.0 * math.pi * 15.0, 0.70)


def control(kind: str, gain: float = K_B, pd: PD | None = None) -> Prefilter:
    """One of the three laws, behind the 20 Hz prefilter.

    All three are the sum PD + linear + switched damping, with the gains of the others zero: so
    they are one program, and compiling is what a reproduction spends its time on.
    """
    linear = LinearDamping(gain if kind == "linear" else 0.0)
    switched = SwitchedDamping(gain if kind == "switched" else 0.0)
    return Prefilter((gains() if pd is None else pd) + linear + switched)


def scenario(
    step: float = 0.0, loads: tuple[float, float] = (0.0, 0.0), start: Start | None = None
) -> Scenario:
    """Step of the reference at 0.010 s, load steps at 0.010 and 0.15 s; rest in mid-gap."""
    load = Step(loads[0], ONSET) + Step(loads[1], SECOND)
    return Scenario(Step(step, ONSET), load, start or Start(), duration=DURATION)


_MEMBERS = 8  # every batch is filled up to this, so that all groups share one program


def runs(
    laws: Sequence[Any], scenarios: Sequence[Scenario], drive: Drive | None = None
) -> list[Run]:
    """One run per law and scenario, at the step DT, exact, with all metrics and signals."""
    pairs = list(zip(laws, scenarios, strict=True))
    found: list[Run] = []
    for first in range(0, len(pairs), _MEMBERS):
        some = pairs[first : first + _MEMBERS]
        filled = some + [some[-1]] * (_MEMBERS - len(some))
        batch = simulate(
            bench_2018() if drive is None else drive,
            stack([law for law, _ in filled]),
            stack([asked for _, asked in filled]),
            dt=DT,
        )
        batch = jax.tree.map(np.asarray, batch)  # members of it are then views
        found += [batch.member(i) for i in range(len(some))]
    return found


def three(
    asked: Scenario, drive: Drive | None = None, wrap: Callable[[Law], Any] | None = None
) -> dict[str, Run]:
    """The three laws in one scenario, by kind; `wrap` makes sampled laws of them."""
    laws = [control(kind) if wrap is None else wrap(control(kind)) for kind in KINDS]
    return dict(zip(KINDS, runs(laws, [asked] * len(KINDS), drive), strict=True))


@functools.cache
def step_runs() -> dict[str, Run]:
    """The step of section III under the three laws; several groups look at it."""
    return three(scenario(STEP))


@functools.cache
def disturbance_runs() -> dict[str, Run]:
    """The load steps of section III.C under the three laws."""
    return three(scenario(loads=LOADS))


def metric(run: Run, name: str) -> float:
    """One metric of a run."""
    return float(run.metrics[name])


def rows(prefix: str, found: Mapping[str, Run], names: Sequence[str], note: str) -> list[Row]:
    """`prefix.<law>.<metric>` for metrics that there is nothing to judge against."""
    return [
        measured(f"{prefix}.{kind}.{name}", *QUANTITIES[name], metric(run, name), note)
        for kind, run in found.items()
        for name in names
    ]


def sampled_rows(prefix: str, found: Mapping[str, Run], note: str) -> list[Row]:
    """As `rows`, with a warning where numbers of the sampled switched law are not to be trusted.

    How a contact falls between two samples decides what its damping does; near rest one contact
    multiplies a difference by about a hundred until the next one. Steps of 2e-4, 1e-4 and 5e-5 s
    give an ITAE of 4.0e-4, 3.3e-4 and 3.6e-4 rad s2, while peaks agree to 1e-6.
    """
    warning = "known to 20 % (ITAE) or 1 % (IAE) only: contacts near rest fall between samples"
    return [
        row._replace(note=f"{warning}; {row.note}")
        if row.id.endswith(("switched.itae_rad_s2", "switched.iae_rad_s"))
        else row
        for row in rows(prefix, found, STEP_METRICS, note)
    ]


def reduction_row(prefix: str, found: Mapping[str, Run], reference: float, note: str) -> Row:
    """`prefix.linear.impact_reduction_pct`, judged against an event-accurate percentage."""
    value = reduction(found, "linear")
    return measured(
        f"{prefix}.linear.impact_reduction_pct",
        "first impact, conventional against none: less by",
        "%",
        value,
        f"reference {reference:g}, event-accurate; {note}",
    )._replace(
        tolerance="within 0.005 % of the reference (half its last digit)",
        ok=abs(value - reference) <= 0.005,
    )


def reduction(found: Mapping[str, Run], kind: str, name: str = "first_impact_Nm") -> float:
    """By how many percent a law makes a metric smaller than it is without damping."""
    return 100.0 * (1.0 - metric(found[kind], name) / metric(found["none"], name))
