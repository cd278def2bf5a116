"""Section II.A of the 2018 paper: how harmless it is to neglect the exact backlash model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.findings import Draw, Findings, Group, Row, below, claim, measured, near
from jaxsim.reproduction import _bench_2018 as bench
from jaxsim.reproduction._draw_2018 import AXES, LINES, METHOD
from jaxsim.reproduction._panel import panel
from jaxsim.run import Run
from jaxsim.transmissions.nordin import Nordin as NordinModel

READING = "step of section III with the exact model of Nordin (1997) as transmission, same K, D_B"
COMPARED = ("first_impact_Nm", "braking_peak_Nm", "theta_max_rad", "itae_rad_s2")
HARMLESS = 1.0  # %


class Nordin(Group):
    """The step of section III on both backlash models."""

    paper = bench.PAPER
    title = "the exact backlash model against deadzone and linear damping (section II.A)"
    figures = ("nordin",)

    def find(self) -> Findings:
        exact = bench.three(bench.scenario(bench.STEP), drive=_drive())
        simple = bench.step_runs()
        numbers = bench.rows("nordin", exact, bench.STEP_METRICS, READING)
        changes = [_change(kind, name, exact, simple) for kind in exact for name in COMPARED]
        figures = {"nordin": _figure(exact, simple)}
        return Findings([*numbers, *changes, *_claims(exact, simple)], figures)


def _drive() -> Drive:
    plain = bench_2018()
    simple = plain.transmission[0]
    transmission = NordinModel(simple.K, simple.half_gap, simple.D_B)  # type: ignore[attr-defined]
    return Drive(plain.motor, transmission, plain.load)


def _percent(kind: str, name: str, exact: Mapping[str, Run], simple: Mapping[str, Run]) -> float:
    return 100.0 * (bench.metric(exact[kind], name) / bench.metric(simple[kind], name) - 1.0)


def _change(kind: str, name: str, exact: Mapping[str, Run], simple: Mapping[str, Run]) -> Row:
    words = f"{bench.QUANTITIES[name][0]}: exact model over deadzone model, minus 1"
    change = _percent(kind, name, exact, simple)
    return measured(f"nordin.{kind}.change_{name}", words, "%", change, READING)


def _claims(exact: Mapping[str, Run], simple: Mapping[str, Run]) -> list[Row]:
    names = ("first_impact_Nm", "braking_peak_Nm", "theta_max_rad")
    worst = max(abs(_percent(kind, name, exact, simple)) for kind in exact for name in names)
    cycle = _percent("none", "limit_cycle_rad", exact, simple)
    quote = "II.A: 'our simulation studies also confirmed that the effect can be neglected'"
    return [
        claim(
            "exact_model_negligible",
            "largest change of first impact, braking peak or largest theta_L, all laws",
            "%",
            worst,
            below(HARMLESS),
            quote,
        ),
        claim(
            "exact_model_negligible_cycle",
            "change of the limit cycle's amplitude",
            "%",
            cycle,
            near(0.0, HARMLESS),
            f"{quote}. Less so near rest: the exact model ends a contact before T_s pulls, and its "
            "cycle is larger",
        ),
    ]


def _figure(exact: Mapping[str, Run], simple: Mapping[str, Run]) -> Draw:
    told = (
        "Not in the paper: its claim of section II.A. Lines: deadzone and linear damping, (5); "
        f"grey: exact model with its own state. Reading: {READING}. {METHOD}"
    )

    def draw(path: Path) -> None:
        with panel(path, "Joint torque with both backlash models", told) as ax:
            for run in exact.values():
                label = "exact model" if run is exact["none"] else None
                ax.plot(run.time, run.signals["T_s"], color="0.75", linewidth=4.0, label=label)
            for kind, run in simple.items():
                ax.plot(run.time, run.signals["T_s"], **LINES[kind])
            ax.set(xlabel="time [s]", ylabel=AXES["T_s"], xlim=(0.0, 0.1))
            ax.legend()

    return draw
