"""`gearlash analyse`: the linear loop of a study."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE for law or drive; repeat.")
    ] = None,
    at: Annotated[
        str | None, typer.Option(help="Load angles, rad, comma between axes; default: the study's.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for analysis.json and the figures.")
    ] = None,
) -> None:
    """Linearise a study: poles, zeros, bandwidth, margins, stability; figures in a folder."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim.analysis import analyse
    from jaxsim.options import opened
    from jaxsim.provenance import keep_results, make_folder

    what = opened(study, law=law, change=change)
    if out is not None:
        keep_results("--out", out / "analysis.json")
        make_folder("--out", out)
    found = analyse(what, None if at is None else _angles(at))
    console = Console()
    for first in range(0, len(found.modes), _COLUMNS):
        console.print(_summary(found, found.modes[first : first + _COLUMNS]))
    console.print(_roots(found))
    for note in found.notes:
        console.print(f"Note: {note}", markup=False)
    if out is not None:
        _write(out, found)
        console.print(f"Wrote analysis.json and the figures to {out}")


def _angles(text: str) -> list[float]:
    from jaxsim.errors import InputError

    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--at", "must be numbers", repr(text), "e.g. --at 0,0.5") from None


_COLUMNS = 3  # modes side by side, to fit a narrow screen


def _summary(found: Any, modes: list[Any]) -> Any:
    """One column per mode."""
    from rich.table import Table

    where = ", ".join(f"{v:g}" for v in found.theta_L)
    shown = Table(title=f"{found.study} at theta_L = ({where}) rad", title_justify="left")
    shown.add_column("")
    for mode in modes:
        shown.add_column(mode.name, justify="right")
    rows = [_facts(mode) for mode in modes]
    for name in rows[0]:
        shown.add_row(name, *(row[name] for row in rows))
    if found.region is not None and modes[0] is found.modes[0]:
        for name, values in _bounds(found.region).items():
            shown.add_row(name, _numbers(values), *[""] * (len(rows) - 1))
    return shown


def _facts(mode: Any) -> dict[str, str]:
    """What the table says of a mode, by the words of its lines."""
    facts = {
        "": mode.verdict,
        "rightmost pole, 1/s": f"{mode.rightmost:.5g}",
        "bandwidth, Hz": _numbers([w / (2.0 * math.pi) for w in mode.bandwidth]),
        **_margins("at the command", mode.margins),
        "stable loop gains": _intervals(mode.gain),
    }
    if mode.K_p is not None:
        facts |= _margins("at the PI", mode.pi_margins)
        facts["stable K_p, of its value"] = _intervals(mode.K_p)
    return facts


def _margins(where: str, margins: list[Any]) -> dict[str, str]:
    """Gain up, gain down, phase; per axis."""
    if not margins:
        return {}
    nan = math.nan
    return {
        f"gain margin {where}": _numbers([m.gain if m else nan for m in margins]),
        f"least gain {where}": _numbers([m.gain_below if m else nan for m in margins]),
        f"phase margin {where}, deg": _numbers(
            [math.degrees(m.phase) if m else nan for m in margins]
        ),
    }


def _bounds(region: Any) -> dict[str, Any]:
    return {"K_p max (21), V/Nm": region.K_p_max, "K_i max (22), 1/s": region.K_i_max}


def _numbers(values: Any) -> str:
    return "  ".join("-" if math.isnan(v) else f"{v:.5g}" for v in values)


def _intervals(family: Any) -> str:
    return " ".join(f"({low:.5g}, {high:.5g})" for low, high in family.intervals()) or "none"


def _roots(found: Any) -> Any:
    """Poles and zeros, upper halves."""
    from rich.table import Table

    shown = Table(title="Poles and zeros, 1/s", title_justify="left")
    for column in ("mode", "poles of the closed loop", f"zeros, command to {found.controlled}"):
        shown.add_column(column)
    for mode in found.modes:
        shown.add_row(mode.name, _listed(mode.poles), _listed(mode.zeros))
    return shown


def _listed(values: Any) -> str:
    import numpy as np

    return ", ".join(
        f"{v.real:.5g}" + (f"+-{v.imag:.5g}j" if v.imag > 0.0 else "")
        for v in np.asarray(values, dtype=complex) if v.imag >= 0.0
    )  # fmt: skip


def _write(out: Path, found: Any) -> None:
    from jaxsim.analysis_plots import draw
    from jaxsim.provenance import provenance, write_json

    content = {
        "study": found.study,
        "theta_L_rad": found.theta_L,
        "controlled": found.controlled,
        "modes": [_mode(mode) for mode in found.modes],
        "notes": found.notes,
        "figures": draw(found, out),
        **provenance(),
    }
    if found.region is not None:
        names = ("K_p_V_Nm", "K_i_1_s", "K_p_max_V_Nm", "K_i_max_1_s")
        content["routh_hurwitz"] = dict(zip(names, found.region[1:], strict=True))
    write_json(out / "analysis.json", content)


def _mode(mode: Any) -> dict[str, Any]:
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
