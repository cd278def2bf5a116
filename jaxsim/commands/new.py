"""`gearlash new`: a commented study to start from."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    path: Annotated[Path, typer.Argument(help="File to write, e.g. my_drive.toml.")],
    base: Annotated[
        str, typer.Option("--from", help="Shipped study, or study file, to start from.")
    ] = "bench_switched",
) -> None:
    """Write a commented study file to start from."""
    from rich.console import Console

    from jaxsim.errors import InputError
    from jaxsim.study import load

    if path.suffix != ".toml":
        raise InputError("path", "must end in .toml", str(path), f"e.g. {path.stem}.toml")
    if path.exists():
        raise InputError("path", "must not exist yet", str(path), "choose another name")
    path.write_text(commented(load(base), path.stem), "utf-8")
    Console().print(f"Wrote {path}. Next: gearlash simulate {path}")


def commented(study: Any, name: str) -> str:
    """The study in full, every parameter with its unit, meaning and rule."""
    import tomlkit

    from jaxsim.components import dump

    document = tomlkit.document()
    for line in _head():
        document.add(tomlkit.comment(line))
    document.add("name", tomlkit.item(name))
    document.add("about", tomlkit.item(study.table.get("about", "")))
    document.add("drive", tomlkit.item(dump(study.drive, _explained)))
    document.add("law", tomlkit.item(dump(study.law, _explained)))
    if "scenarios" in study.table:
        every = {name: _scenario(one) for name, one in study.scenarios.items()}
        document.add("scenarios", tomlkit.item(every))
    else:
        document.add("scenario", tomlkit.item(_scenario(study.scenario)))
    for section in ("run", "objective", "tune"):
        given = study.table.get(section) or ({"dt": study.run.dt} if section == "run" else None)
        if given is not None:
            document.add(section, tomlkit.item(given))
    return document.as_string()


def _scenario(scenario: Any) -> dict[str, Any]:
    import tomlkit

    from jaxsim.components import dump

    table = {"duration": tomlkit.item(scenario.duration).comment("s")}
    for key in ("reference", "load_torque", "start"):
        parts = getattr(scenario, key)
        table[key] = dump(parts if len(parts) > 1 else parts[0], _explained)
    return table


def _explained(value: Any, field: Any) -> Any:
    import tomlkit

    item = tomlkit.item(value)
    if "doc" not in field.metadata:
        return item
    rule = field.metadata["rule"].text.removeprefix("must be ")
    rule = "" if rule == "finite" else f" ({rule})"
    unit = "" if field.metadata["unit"] == "1" else f"{field.metadata['unit']}: "
    return item.comment(f"{unit}{field.metadata['doc']}{rule}")


def _head() -> list[str]:
    from jaxsim.catalog import DRIVES, LAWS, METRICS, SIGNALS

    values = [v for group in METRICS.all().values() for v in group.values]
    return [
        'A study of gearlash. Numbers are in SI units; text may carry others: "0.45 deg",',
        '"26 arcmin", "8.78 kg cm^2", "400 us", "20 Hz". half_gap is HALF of the play, load side.',
        "",
        f"drive presets (instead of motor, transmission, load): {', '.join(DRIVES.names())}",
        f"laws: {', '.join(LAWS.names())}, sampled; a list of laws is their sum",
        f"signals: {', '.join(SIGNALS.names())}; a list of signals is their sum",
        "run: dt [s], deadzone (exact, smoothed, plain), max_events, precision (64, 32)",
        *textwrap.wrap(f"metrics for [objective]: {', '.join(values)}", 94),
        "",
    ]
