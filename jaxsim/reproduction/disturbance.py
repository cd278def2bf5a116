"""Section III.C of the 2018 paper: steps of the load torque, Figs. 6 and 7."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jaxsim.findings import Draw, Findings, Group, Row, above, below, claim, measured, near
from jaxsim.reproduction import _bench_2018 as bench
from jaxsim.reproduction._draw_2018 import METHOD, over_time
from jaxsim.run import Run

READING = (
    "d_L = -0.50 Nm from 0.010 s, +1.0 Nm more from 0.15 s (net +0.50 Nm), reference 0, start at "
    "rest in mid-gap, continuous laws"
)
METRICS = (
    "first_contact_s",
    "entry_speed_rad_s",
    "first_impact_Nm",
    "theta_min_rad",
    "theta_max_rad",
    "iae_rad_s",
    "itae_rad_s2",
    "command_max",
    "command_min",
)
PEAKS = {
    "peak_1_Nm": ("T_s_max_Nm", "largest T_s, after the first load step"),
    "peak_2_Nm": ("T_s_min_Nm", "most negative T_s, after the second load step"),
}


class Disturbance(Group):
    """Load steps under the three laws, and what the paper says about them."""

    paper = bench.PAPER
    title = "steps of the load torque, simulation (section III.C, Figs. 6-7)"
    figures = ("fig_6", "fig_7")

    def find(self) -> Findings:
        found = bench.disturbance_runs()
        numbers = bench.rows("disturbance", found, METRICS, READING) + _peaks(found)
        return Findings([*numbers, *_suppression(found), *_impacts(found)], _figures(found))


def _peaks(found: Mapping[str, Run]) -> list[Row]:
    """The extremes of T_s answer one load step each: `_apart` looks."""
    note = f"signed, T_s > 0 pushes the load forward; {READING}"
    return [
        measured(f"disturbance.{kind}.{name}", words, "Nm", bench.metric(run, source), note)
        for kind, run in found.items()
        for name, (source, words) in PEAKS.items()
    ]


def _suppression(found: Mapping[str, Run]) -> list[Row]:
    iae = {kind: bench.metric(run, "iae_rad_s") for kind, run in found.items()}
    reach = {kind: float(np.max(np.abs(run.signals["theta_L"]))) for kind, run in found.items()}
    told = "; largest |theta_L| {:.1f}, {:.1f}, {:.1f} mrad (none, linear, switched)".format(
        *(1e3 * reach[kind] for kind in bench.KINDS)
    )
    return [
        claim(
            "suppression_worse_linear",
            "IAE, conventional over none",
            "1",
            iae["linear"] / iae["none"],
            above(1.0),
            f"III.C.2: conventional 'shows less disturbance suppression performance'{told}",
        ),
        claim(
            "suppression_better_than_linear",
            "IAE, proposed over conventional",
            "1",
            iae["switched"] / iae["linear"],
            below(1.0),
            f"III.C.2: 'Proposed method shows better performance than Conventional method'{told}",
        ),
        claim(
            "suppression_better_than_none",
            "IAE, proposed over none",
            "1",
            iae["switched"] / iae["none"],
            below(1.0),
            "III.C.2: 'Proposed method shows better performance than the method without damping'. "
            f"It does, by little{told}",
        ),
    ]


def _impacts(found: Mapping[str, Run]) -> list[Row]:
    first = {kind: bench.reduction(found, kind, "T_s_max_Nm") for kind in ("linear", "switched")}
    return [
        claim(
            "disturbance_impact_reduced_linear",
            "peak_1, conventional against none: less by",
            "%",
            first["linear"],
            above(0.0),
            "III.C.2: 'the impact torque is reduced in Conventional method'",
        ),
        claim(
            "disturbance_impact_kept_switched",
            "peak_1, proposed against none: less by",
            "%",
            first["switched"],
            near(0.0, 1.0),
            "III.C.2: 'but not reduced in Proposed method'",
        ),
        claim(
            "disturbance_peaks_in_order",
            "peak_2 after peak_1, each in answer to its own step, by",
            "s",
            _apart(found),
            above(0.0),
            "reading: the impacts of Fig. 7 answer one load step each",
        ),
    ]


def _apart(found: Mapping[str, Run]) -> float:
    """The least time between peak 1 and peak 2; negative where one answers the wrong step."""
    least = np.inf
    for run in found.values():
        first, second = (
            float(run.time[pick(run.signals["T_s"])]) for pick in (np.argmax, np.argmin)
        )
        least = min(least, second - first if first < bench.SECOND < second else -1.0)
    return float(least)


def _figures(found: Mapping[str, Run]) -> dict[str, Draw]:
    told = f"Reading: {READING}. {METHOD}"
    window = (0.0, 0.35)
    return {
        "fig_6": over_time(
            found,
            "theta_L",
            window,
            "Load-side angle under steps of the load torque",
            "2018 paper, Fig. 6. A PD law leaves the offset 0.50 Nm/K_P = 48.6 mrad. " + told,
        ),
        "fig_7": over_time(
            found,
            "T_s",
            window,
            "Joint torque under steps of the load torque",
            f"2018 paper, Fig. 7. {told}",
        ),
    }
