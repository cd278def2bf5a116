"""The limit cycle of section III.B of the 2018 paper, and when it vanishes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.findings import Draw, Findings, Group, Row, below, claim, measured, near
from jaxsim.reproduction import _bench_2018 as bench
from jaxsim.reproduction._draw_2018 import LINES, METHOD
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run
from jaxsim.scenario import Start

READING = "step of section III, last 40 % of 1.2 s"
# The paper prints none of these; event-accurate, two independent methods, to these digits.
REFERENCE = {"frequency_Hz": (9.766, 5e-4), "peak_to_peak_rad": (8.669e-3, 5e-7)}
TORQUE = (0.1618, 5e-5)
METRICS = {
    "frequency_Hz": ("limit_cycle_Hz", "frequency of the limit cycle", "Hz"),
    "peak_to_peak_rad": ("limit_cycle_rad", "theta_L, peak to peak", "rad"),
    "torque_Nm": ("limit_cycle_Nm", "largest |T_s|", "Nm"),
    "growth": ("limit_cycle_growth", "peak to peak, last 20 % over the 20 % before", "1"),
}
OFFSET = 1e-6  # rad; the return map is the same for 1e-4
RANGE = (-0.4, 0.0)  # Nm s/rad, where the thresholds are looked for
ROUNDS = 4  # each makes the bracket 7 times shorter; the rest is interpolated


class LimitCycle(Group):
    """The cycle that the step leaves without damping, and the K_B that is enough against it."""

    paper = bench.PAPER
    title = "limit cycle after the step, and the K_B at which it vanishes (Fig. 3(b))"
    figures = ("limit_cycle",)

    def find(self) -> Findings:
        found = bench.step_runs()
        ratios = {kind: contraction(kind, [bench.K_B, 0.0]) for kind in ("linear", "switched")}
        numbers = [*_cycle(found), *_thresholds(), *_ratios(ratios)]
        figures = {"limit_cycle": _map_figure()}
        return Findings([*numbers, *_claims(found, ratios)], figures)


def contraction(kind: str, values: list[float] | np.ndarray) -> np.ndarray:
    """How much of a small error of theta_L one half cycle leaves, for each K_B.

    Near rest the load stands at a small error e, and the motor crosses the gap at its terminal
    speed K_P e/(D_M - K_B) before it touches. From there on everything is proportional to e (the
    gap is long against it): one contact, or a few, then the load coasts to a stop at
    -contraction * e. Rest attracts if that is below 1, and repels if it is above.

    Started just before the touch. The load still coasts AWAY from the motor, by a trace: it does
    so after every half cycle, and the switched law is off for that reason during the crossing.
    """
    drive, P = bench_2018(), float(bench.gains().K_P)
    motor, half_gap = drive.motor[0], float(drive.transmission[0].half_gap)  # type: ignore[attr-defined]
    starts = []
    for value in values:
        damping = float(motor.D_M) - (value if kind == "linear" else 0.0)  # type: ignore[attr-defined]
        speed = P * OFFSET / damping
        starts.append(Start(-OFFSET, -1e-9 * OFFSET, half_gap - 1e-3 * OFFSET, speed))
    laws = [bench.control(kind, value) for value in values]
    found = bench.runs(laws, [bench.scenario(start=s) for s in starts])
    return np.array([run.signals["theta_L"][-1] / OFFSET for run in found])


def threshold(kind: str) -> float:
    """The weakest K_B at which rest attracts: where the contraction is 1, Nm s/rad."""
    (low, high), (below, above) = RANGE, (np.nan, np.nan)
    for _ in range(ROUNDS):
        values = np.linspace(low, high, 8)
        ratio = contraction(kind, values)
        first = int(np.argmax(ratio > 1.0))
        if first == 0:
            raise RuntimeError(f"no threshold of the {kind} law between {low} and {high}")
        low, high = values[first - 1], values[first]
        below, above = ratio[first - 1], ratio[first]
    return float(low + (1.0 - below) / (above - below) * (high - low))


def _cycle(found: Mapping[str, Run]) -> list[Row]:
    rows = []
    for name, (metric, quantity, unit) in METRICS.items():
        row = measured(
            f"limit_cycle.{name}", quantity, unit, bench.metric(found["none"], metric), READING
        )
        rows.append(_judged(row, name))
    return rows + [
        measured(
            f"limit_cycle.{kind}.peak_to_peak_rad",
            *METRICS["peak_to_peak_rad"][1:],
            bench.metric(found[kind], "limit_cycle_rad"),
            f"still dying out; {READING}",
        )
        for kind in ("linear", "switched")
    ]


def _judged(row: Row, name: str) -> Row:
    known = {**REFERENCE, "torque_Nm": TORQUE}
    if name not in known:
        return row
    value, within = known[name]
    return row._replace(
        tolerance=f"within {within:g} {row.unit} of the reference (half its last digit)",
        ok=abs(row.value - value) <= within,
        note=f"reference {value:g}, event-accurate; {row.note}",
    )


def _thresholds() -> list[Row]:
    note = (
        "return map of small errors = 1, found by exact runs from theta_L = -1 urad, the motor at "
        "the wall; the same at -0.1 mrad. Just beyond it the large oscillation after the step "
        "dies out, too"
    )
    return [
        measured(
            f"limit_cycle.threshold_kb.{kind}",
            "K_B at which rest becomes stable",
            "Nm s/rad",
            threshold(kind),
            note,
        )
        for kind in ("linear", "switched")
    ]


def _ratios(ratios: Mapping[str, np.ndarray]) -> list[Row]:
    note = "below 1 rest attracts; the time between contacts grows as the error shrinks, so ~ 1/t"
    values = {"none": ratios["linear"][1], **{kind: r[0] for kind, r in ratios.items()}}
    return [
        measured(
            f"limit_cycle.contraction.{kind}",
            "small error left after half a cycle",
            "1",
            value,
            note,
        )
        for kind, value in values.items()
    ]


def _claims(found: Mapping[str, Run], ratios: Mapping[str, np.ndarray]) -> list[Row]:
    growth = bench.metric(found["none"], "limit_cycle_growth")
    left = {kind: float(r[0]) for kind, r in ratios.items()}
    return [
        claim(
            "limit_cycle_none",
            "peak to peak, last 20 % of 1.2 s over the 20 % before",
            "1",
            growth,
            near(1.0, 0.001),
            "III.B: 'stable limit cycle is induced in the response without damping'",
        ),
        claim(
            "no_limit_cycle_linear",
            "small error left after half a cycle",
            "1",
            left["linear"],
            below(1.0),
            "III.B: 'while not seen in Conventional method thanks to the damping addition'",
        ),
        claim(
            "no_limit_cycle_switched",
            "small error left after half a cycle",
            "1",
            left["switched"],
            below(1.0),
            "III.C.2, Fig. 3(b): none with the proposed law either",
        ),
    ]


def _map_figure() -> Draw:
    values = np.concatenate([np.linspace(bench.K_B, -0.16, 12), np.linspace(-0.14, 0.0, 12)])
    maps = {kind: contraction(kind, values) for kind in ("linear", "switched")}

    def draw(path: Path) -> None:
        told = (
            "Not in the paper. Share of a small error of the load angle that is left, on the other "
            "side, after one crossing of the gap: below 1 the drive comes to rest, above 1 it ends "
            f"in the limit cycle. The paper's K_B is -0.80 Nm s/rad. {METHOD}"
        )
        with panel(path, "Damping needed against the limit cycle", told) as ax:
            for kind, ratio in maps.items():
                ax.plot(values, ratio, **LINES[kind])
            ax.axhline(1.0, color="0.45", linewidth=1.0)
            ax.text(bench.K_B, 1.02, "rest repels", color="0.35", va="bottom")
            ax.text(bench.K_B, 0.98, "rest attracts", color="0.35", va="top")
            ax.set(xlabel=r"$K_B$ [Nm s/rad]", ylabel="error left after half a cycle [1]")
            ax.legend(loc="upper left", bbox_to_anchor=(0.0, 0.95))

    return draw
