"""A sampled law as C99: one header with its gains, one file with its step."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.errors import InputError
from jaxsim.export.c_expressions import Printer, literal
from jaxsim.export.step import UNITS, Gain, Step, named, step_of
from jaxsim.law import Decentral
from jaxsim.laws.policy import Policy
from jaxsim.provenance import replace_text
from jaxsim.sampled import Sampled


def sampled_at(law: Any, period: float | None) -> Sampled:
    """The law as the target runs it: as it is where it is sampled, else every `period` s.

    A policy is asked at its own period, which must be a multiple of `period`, its default.

    Raises: InputError where no period is given, or another than the law's own.
    """
    if isinstance(law, Policy):
        every = law.period if period is None else period
        turns = max(1, round(law.period / every))
        if abs(turns * every - law.period) > 1e-9 * law.period:
            rule = f"must divide the policy's period, {law.period:g} s"
            raise InputError("--period", rule, period, "leave it out, or give a part of it")
        return Sampled(law, every, sensors=law.sensors)
    if isinstance(law, Sampled):
        if period is not None and abs(period - law.period) > 1e-9 * law.period:
            rule = f"must be the law's own period, {law.period:g} s"
            raise InputError("--period", rule, period, "leave it out, or change the study")
        return law
    if period is None:
        fix = 'e.g. --period "400 us"'
        raise InputError("--period", "must be given for a continuous law", "none", fix)
    return Sampled(law, period)


def write_c(
    out: Path,
    law: Sampled,
    ratios: tuple[float, ...],
    about: dict[str, Any],
    *,
    single: bool = False,
) -> Step:
    """Write law.h and law.c of a sampled law. ratios: of the gears, per axis.

    single: float instead of double. Raises: InputError for a law that no target can run.
    """
    step = step_of(law, ratios)
    replace_text(out / "law.h", header(step, law, about, single=single))
    replace_text(out / "law.c", source(step, law, single=single))
    return step


def header(step: Step, law: Any, about: dict[str, Any], *, single: bool) -> str:
    """law.h: where it comes from, gains to tune on the target, readings, memory, functions."""
    scalars = [g for g in step.gains if g.values.ndim == 0]
    inputs = [f"law_real {name}; /* {_unit(name)} */" for name in step.readings]
    cells = [f"law_real {c.name};" for c in step.memory]
    commands = [f"law_real {name}; /* {law.command_unit} */" for name in _commands(law)]
    return "\n".join(
        [
            f"/* {_kind(law.law)} of gearlash, run every {law.period:g} s.",
            " *",
            *(f" * {key}: {value}" for key, value in _flat(about)),
            " *",
            *textwrap.wrap(_USE, 96, initial_indent=" * ", subsequent_indent=" * "),
            " */",
            "#ifndef GEARLASH_LAW_H",
            "#define GEARLASH_LAW_H",
            "",
            f"typedef {'float' if single else 'double'} law_real;",
            "",
            f"#define LAW_PERIOD {literal(law.period, single=single)} /* s; fixed */",
            *(_define(g, single) for g in scalars),
            "",
            *_struct("law_input", "Readings, SI units.", [*inputs, *_unless(inputs)]),
            *_struct("law_output", "Commands to the motors.", commands),
            *_struct(
                "law_state",
                "Memory: last_... are readings one period ago; held: commands to repeat.",
                [*cells, f"law_real held[{law.axes}];"],
            ),
            "/* At rest at these readings; call it before the first step and after a reset. */",
            "void law_init(law_state *state, const law_input *in);",
            "",
            "/* One period. Returns 0; or 1 where a reading is nan or inf: then the memory stays",
            "   as it is and the last command is repeated (0 after law_init). */",
            "int law_step(law_state *state, const law_input *in, law_output *out);",
            "",
            "#endif",
            "",
        ]
    )


_USE = (
    "Fixed period, no allocation, no global state: one law_state per drive. The delay of the "
    "target is its own and not in here. Commands are limited where the law limits them, and only "
    "there: clip at the amplifier. Integrators are advanced by Tustin's rule and have no anti-"
    "windup but the law's own. Gains below may be changed and compiled again."
)


def _kind(law: Any) -> str:
    """The class of a law, of one axis where it stands alone."""
    return type(law.laws[0] if isinstance(law, Decentral) and law.axes == 1 else law).__name__


def source(step: Step, law: Any, *, single: bool) -> str:
    """law.c: the first memory, and one period."""
    tables = [g for g in step.gains if g.values.ndim > 0]
    firsts = [c.first for c in step.memory]
    start = Printer(step.graph, firsts, single=single)
    roots = [*(c.following for c in step.memory), *step.commands]
    one = Printer(step.graph, roots, single=single)
    renamed = _values(step, one)
    init = [f"state->{c.name} = {start.text(c.first)};" for c in step.memory]
    init += [f"state->held[{i}] = {literal(0.0, single=single)};" for i in range(law.axes)]
    used = any("in->" in line for line in [*start.lines, *init])
    guard = " || ".join(f"!isfinite(in->{name})" for name in step.readings) or "0"
    commands = _commands(law)
    keep = [f"out->{name} = state->held[{i}];" for i, name in enumerate(commands)]
    set_ = [
        f"const law_real new_{c.name} = {v};" for c, v in zip(step.memory, renamed, strict=True)
    ]
    return "\n".join(
        [
            '#include "law.h"',
            "",
            "#include <math.h>",
            "",
            *(_table(g, single) for g in tables),
            "void law_init(law_state *state, const law_input *in)",
            "{",
            *_indented(start.lines),
            *_indented([] if used else ["(void)in;"]),
            *_indented(init),
            "}",
            "",
            "int law_step(law_state *state, const law_input *in, law_output *out)",
            "{",
            *_indented([f"if ({guard}) {{", *_indented([*keep, "return 1;"]), "}"]),
            *_indented(one.lines),
            *_indented(set_),
            *_indented(f"state->held[{i}] = {one.text(v)};" for i, v in enumerate(step.commands)),
            *_indented(f"state->{c.name} = new_{c.name};" for c in step.memory),
            *_indented(keep),
            *_indented(["return 0;"]),
            "}",
            "",
        ]
    )


def _values(step: Step, printer: Printer) -> list[str]:
    return [printer.text(c.following) for c in step.memory]


def _commands(law: Any) -> list[str]:
    return [name for axis in range(law.axes) for name in named(("command",), axis, law.axes)]


def _unit(reading: str) -> str:
    name = reading if reading in UNITS else reading.rsplit("_", 1)[0]
    return "rad or Nm, what the law follows" if name == "reference" else UNITS[name]


def _unless(lines: list[str]) -> list[str]:
    """A struct without members is not C."""
    return [] if lines else ["char unused;"]


def _define(gain: Gain, single: bool) -> str:
    text = literal(float(gain.values), single=single)
    return f"#define {gain.name} {text} /* {gain.unit}; {gain.doc} */"


def _table(gain: Gain, single: bool) -> str:
    """A parameter with several numbers, row by row."""
    size = "".join(f"[{n}]" for n in gain.values.shape)
    return (
        f"/* {gain.unit}; {gain.doc} */\n"
        f"static const law_real {gain.name}{size} = {_braces(gain.values, single)};\n"
    )


def _braces(values: np.ndarray, single: bool) -> str:
    if values.ndim > 1:
        return "{\n" + ",\n".join(_braces(v, single) for v in values) + "}"
    return "{" + ", ".join(literal(float(v), single=single) for v in values) + "}"


def _struct(name: str, text: str, members: list[str]) -> list[str]:
    return [f"/* {text} */", "typedef struct {", *_indented(members), f"}} {name};", ""]


def _indented(lines: Any) -> list[str]:
    return [f"    {line}" for line in lines]


def _flat(about: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in about.items():
        rows += _flat(value, f"{prefix}{key} ") if isinstance(value, dict) else [
            (prefix + key, str(value).replace("*/", "* /"))
        ]  # fmt: skip
    return rows


__all__ = ["sampled_at", "write_c"]
