"""What `gearlash analyse` says and leaves: facts per contact mode, figures, one page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.analysis import Analysis, Mode, Region
from jaxsim.analysis_plots import draw
from jaxsim.html import Picture, Section, Summary, Table, write_html
from jaxsim.linear.frequency import Margins
from jaxsim.provenance import provenance, write_json

_CAPTIONS = {
    "pole_zero.png": "Poles of the closed loop and zeros from the command, mode by mode; "
    "logarithmic on both sides of a linear middle.",
    "root_locus_gain.png": "Poles as all commands are scaled from 0 on; crosses begin.",
    "root_locus_K_p.png": "Poles as all PI torque gains are scaled from 0 on; crosses begin.",
    "root_locus_alpha.png": "Poles as all shares of positive feedback grow from 0 to 1.",
    "bode.png": "Left: the loop cut at the command; right: from the reference to what is "
    "controlled.",
    "stability_region.png": "Stable PI gains under full positive feedback; (21) and (22) of the "
    "2014 paper.",
}


def facts(mode: Mode) -> dict[str, str]:
    """What is told of a mode, by the words of its lines."""
    found = {
        "": mode.verdict,
        "rightmost pole, 1/s": f"{mode.rightmost:.5g}",
        "bandwidth, Hz": numbers([w / (2.0 * math.pi) for w in mode.bandwidth]),
        **_margins("at the command", mode.margins),
        "stable loop gains": _intervals(mode.gain),
    }
    if mode.K_p is not None:
        found |= _margins("at the PI", mode.pi_margins)
        found["stable K_p, of its value"] = _intervals(mode.K_p)
    return found


def _margins(where: str, margins: list[Margins | None]) -> dict[str, str]:
    """Gain up, gain down, phase; per axis."""
    if not margins:
        return {}
    nan = math.nan
    return {
        f"gain margin {where}": numbers([m.gain if m else nan for m in margins]),
        f"least gain {where}": numbers([m.gain_below if m else nan for m in margins]),
        f"phase margin {where}, deg": numbers(
            [math.degrees(m.phase) if m else nan for m in margins]
        ),
    }


def bounds(region: Region) -> dict[str, str]:
    """Routh-Hurwitz bounds, by the words of their lines; per axis."""
    most = {"K_p max (21), V/Nm": region.K_p_max, "K_i max (22), 1/s": region.K_i_max}
    return {name: numbers(values) for name, values in most.items()}


def numbers(values: Any) -> str:
    return "  ".join("-" if math.isnan(v) else f"{v:.5g}" for v in values)


def _intervals(family: Any) -> str:
    return " ".join(f"({low:.5g}, {high:.5g})" for low, high in family.intervals()) or "none"


def roots(values: Any) -> str:
    """Poles or zeros, upper halves."""
    return ", ".join(
        f"{v.real:.5g}" + (f"+-{v.imag:.5g}j" if v.imag > 0.0 else "")
        for v in np.asarray(values, dtype=complex) if v.imag >= 0.0
    )  # fmt: skip


def where(found: Analysis) -> str:
    """Where the loop was linearised, in words."""
    return f"theta_L = ({', '.join(f'{v:g}' for v in found.theta_L)}) rad"


def write(out: Path, found: Analysis) -> None:
    """analysis.json, the figures, report.html."""
    figures = draw(found, out)
    content = {
        "study": found.study,
        "theta_L_rad": found.theta_L,
        "controlled": found.controlled,
        "modes": [_mode(mode) for mode in found.modes],
        "notes": found.notes,
        "figures": figures,
        **provenance(),
    }
    if found.region is not None:
        names = ("K_p_V_Nm", "K_i_1_s", "K_p_max_V_Nm", "K_i_max_1_s")
        content["routh_hurwitz"] = dict(zip(names, found.region[1:], strict=True))
    write_json(out / "analysis.json", content)
    _page(out, found, figures)


def _page(out: Path, found: Analysis, figures: list[str]) -> None:
    tables = [_facts(found), _roots(found)]
    if found.region is not None:
        rows = [list(item) for item in bounds(found.region).items()]
        tables.append(Table("Bounds of the PI gains, axis by axis.", ["", "at most"], rows))
    sections = [
        Section("Contact by contact", tables),
        Section("Figures", [Picture(_CAPTIONS[name], out / name) for name in figures]),
    ]
    title = f"Linear analysis of {found.study}"
    write_html(out / "report.html", title, summary(found), sections, provenance())


def summary(found: Analysis) -> Summary:
    """Which modes are stable."""
    notes = [f"Linearised at rest at {where(found)}.", *found.notes]
    bad = [m.name for m in found.modes if m.verdict == "unstable"]
    if bad:
        return Summary(f"Unstable: {'; '.join(bad)}.", notes, "bad")
    edge = [m.name for m in found.modes if m.verdict == "marginal"]
    if edge and all(name.startswith("gap") for name in edge):
        told = "Stable in contact; in the gap nothing holds the load, which gives a pole at 0."
        return Summary(told, notes, "good")
    if edge:
        told = f"Stable, but with poles on the imaginary axis: {'; '.join(edge)}."
        return Summary(told, notes, "plain")
    return Summary("Stable in every contact mode.", notes, "good")


def _facts(found: Analysis) -> Table:
    columns = [facts(mode) for mode in found.modes]
    rows = [[name or "loop", *(column[name] for column in columns)] for name in columns[0]]
    head = ["", *(mode.name for mode in found.modes)]
    caption = "Margins are factors of the gain; axis by axis where there are several."
    return Table(caption, head, rows)


def _roots(found: Analysis) -> Table:
    head = ["mode", "poles of the closed loop", f"zeros, command to {found.controlled}"]
    rows = [[m.name, roots(m.poles), roots(m.zeros)] for m in found.modes]
    return Table("Poles and zeros, 1/s; of each pair the upper one.", head, rows)


def _mode(mode: Mode) -> dict[str, Any]:
    pairs = {
        key: [[v.real, v.imag] for v in getattr(mode, key).astype(complex)]
        for key in ("poles", "zeros")
    }
    families = {name: getattr(mode, name) for name in ("gain", "K_p", "alpha")}
    return {
        "name": mode.name,
        "verdict": mode.verdict,
        "poles_1_s": pairs["poles"],
        "zeros_1_s": pairs["zeros"],
        "bandwidth_Hz": [w / (2.0 * math.pi) for w in mode.bandwidth],
        "margins_at_command": [None if m is None else m._asdict() for m in mode.margins],
        "margins_at_pi": [None if m is None else m._asdict() for m in mode.pi_margins],
        "stable": {k: f.intervals() for k, f in families.items() if f is not None},
    }
