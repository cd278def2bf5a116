"""`gearlash export`: from a study to the machine, or to another simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    kind: Annotated[str, typer.Argument(help="c: the law as C99; mjcf: the drive for MuJoCo.")],
    study: Annotated[str, typer.Argument(help="Study file, or the name of a shipped study.")],
    out: Annotated[Path, typer.Option(help="c: folder for law.c and law.h; mjcf: file.")],
    law: Annotated[str | None, typer.Option(help="File to take the law from.")] = None,
    period: Annotated[str | None, typer.Option(help='Of a continuous law, e.g. "400 us".')] = None,
    single: Annotated[bool, typer.Option("--float", help="float instead of double.")] = False,
) -> None:
    """Write a law as C99 for its target, or a drive as a MuJoCo model."""
    import jaxsim

    jaxsim.configure()
    from rich.console import Console

    from jaxsim.errors import InputError
    from jaxsim.options import opened

    if kind not in ("c", "mjcf"):
        raise InputError.unknown("kind", kind, ("c", "mjcf"))
    what = opened(study, law=law)
    words = _c(what, out, period, single) if kind == "c" else _mjcf(what, out)
    Console().print("\n".join(words), soft_wrap=True)


def _c(study: Any, out: Path, period: str | None, single: bool) -> list[str]:
    from jaxsim.export.c_code import sampled_at, write_c
    from jaxsim.provenance import keep_results, make_folder, provenance
    from jaxsim.quantity import to_si

    every = None if period is None else float(to_si(_number(period), "s", "--period"))
    law = sampled_at(study.law, every)
    keep_results("--out", out / "law.c", out / "law.h")
    make_folder("--out", out)
    ratios = tuple(float(t.ratio) for t in study.drive.transmission)
    about = {"study": study.name, **_limits(study.drive)}
    about |= provenance(dtype="float32" if single else "float64")
    step = write_c(out, law, ratios, about, single=single)
    return [
        f"Wrote law.h and law.c to {out}: one step every {law.period:g} s",
        f"readings: {', '.join(step.readings)}",
        f"memory: {len(step.memory)} numbers; gains: {', '.join(g.name for g in step.gains)}",
    ]


def _limits(drive: Any) -> dict[str, str]:
    """What the amplifiers of the study can give, for the head of the file."""
    found = {}
    for axis, motor in enumerate(drive.motor):
        if (supply := getattr(motor, "supply", None)) is not None:
            name = f"limit of command_{axis}" if drive.axes > 1 else "limit of command"
            found[name] = f"{float(supply.limit):g} V of either sign, at the study's supply"
    return found


def _number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _mjcf(study: Any, out: Path) -> list[str]:
    from jaxsim.export.mjcf import write_mjcf
    from jaxsim.provenance import keep_results, make_folder, provenance

    keep_results("--out", out)
    make_folder("--out", out.parent)
    remarks = write_mjcf(out, study.drive, {"study": study.name, **provenance()})
    return [f"Wrote {out}", *(f"not the same in MuJoCo: {words}" for words in remarks)]
