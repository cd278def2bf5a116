"""A gain map in files: a table, a plot and one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxsim import plots
from jaxsim.html import Picture, Section, Summary, Table, Text, write_html
from jaxsim.provenance import provenance, write_json
from jaxsim.status import Status
from jaxsim.study import Study
from tuning.gain_map import FINER, Axis, GainMap, Mode
from tuning.report import write_csv
from tuning.words import quantity

_MODE_STYLES = ("-", "--", "-.", ":")
_MARKS = {"study": ("s", "white"), "tuned": ("*", "#E69F00")}
# Colours of a metric that spans more than this are spread in the logarithm.
_WIDE = 20.0


def write(
    study: Study, found: GainMap, marks: dict[str, tuple[float, float]], out: Path
) -> tuple[str, ...]:
    """map.csv, map.json, map.png and report.html; marks: name -> the two gains of a law."""
    out.mkdir(parents=True, exist_ok=True)
    about = provenance(dtype=study.run.dtype)
    write_csv(out / "map.csv", *_rows(found))
    words = sentences(study, found)
    ends = {a.name: a._asdict() for a in (found.x, found.y)}
    content = {
        "study": study.name,
        "words": words,
        "axes": ends,
        "marks": marks,
        "dt": study.run.dt,
    }
    write_json(out / "map.json", content | about)
    draw(study, found, marks, out / "map.png")
    title = f"{study.name}: map of {found.x.name} and {found.y.name}"
    page = sections(found, out)
    write_html(out / "report.html", title, Summary(words[0], words[1:]), page, about)
    return "map.csv", "map.json", "map.png", "report.html"


def sections(found: GainMap, out: Path) -> list[Section]:
    """What a page says of a map, from the plot in its folder."""
    caption = (
        "Colours: the nonlinear runs; grey: the run fails. Lines: where a pole of that contact "
        "mode crosses the imaginary axis; hatched: a mode is unstable. Pink: the study's limit."
    )
    least = Table("Where each metric is least.", ["metric", "least", *_names(found)], _least(found))
    picture = Picture(caption, out / "map.png")
    shown = [Section(f"Map of {found.x.name} and {found.y.name}", [picture, least])]
    if found.modes:
        head = ["mode", "stable at, %", "rightmost pole, least, 1/s", "largest, 1/s"]
        text = "Poles are those of one mode at a time; what switching does, the runs show."
        table = Table("Each mode by itself.", head, _modes(found))
        shown.append(Section("Poles over the map", [table, Text([text])]))
    return shown


def _names(found: GainMap) -> list[str]:
    return [f"{a.name} [{a.unit}]" for a in (found.x, found.y)]


def sentences(study: Study, found: GainMap) -> list[str]:
    """What the plane shows; only of what was run."""
    done, size = int((found.status == Status.OK.value).sum()), found.status.size
    lines = [f"{done} of {size} runs completed, on {study.name}'s own drive and scenario."]
    for code in sorted({int(v) for v in found.status.ravel()} - {Status.OK.value}):
        lines.append(f"{int((found.status == code).sum())} runs: {Status(code).words}.")
    for name, low, *gains in _least(found):
        pairs = zip((found.x, found.y), gains, strict=True)
        where = ", ".join(f"{a.name} = {v:.4g}" for a, v in pairs)
        lines.append(f"Least {name}: {quantity(low, name)} at {where}.")
    lines += [f"{m.name}: stable on {_share(m):.3g} % of the points." for m in found.modes]
    if len(found.modes) > 1:
        lines.append("Poles are those of one mode at a time; what switching does, the runs show.")
    return [*lines, *(f"{note[:1].upper()}{note[1:]}." for note in found.notes)]


def _share(mode: Mode) -> float:
    """Where the mode is stable, % of the points."""
    return 100.0 * float((mode.rightmost < 0.0).mean())


def _least(found: GainMap) -> list[list[Any]]:
    rows = []
    for name, values in found.metrics.items():
        if np.isfinite(values).any():
            row, column = np.unravel_index(int(np.nanargmin(np.abs(values))), values.shape)
            gains = found.x.values[column], found.y.values[row]
            rows.append([name, float(values[row, column]), *map(float, gains)])
    return rows


def _modes(found: GainMap) -> list[list[Any]]:
    return [
        [m.name, _share(m), float(m.rightmost.min()), float(m.rightmost.max())] for m in found.modes
    ]


def _rows(found: GainMap) -> tuple[list[str], Any]:
    """One row per point."""
    head = [found.x.name, found.y.name, *found.metrics, "status"]
    head += [f"rightmost_{m.name.replace(' ', '_')}" for m in found.modes]
    x, y = np.meshgrid(found.x.values, found.y.values)
    coarse = [m.rightmost[::FINER, ::FINER] for m in found.modes]
    columns = [x, y, *found.metrics.values(), found.status, *coarse]
    return head, zip(*(c.ravel().tolist() for c in columns), strict=True)


def draw(study: Study, found: GainMap, marks: dict[str, tuple[float, float]], path: Path) -> None:
    """One panel per metric."""
    count = len(found.metrics)
    columns = 2 if count in (2, 4) else min(count, 3)
    rows = -(-count // columns)
    size = (4.6 * columns + 0.8, 3.9 * rows + (0.9 if found.modes else 0.3))
    limits = {} if study.objective is None else {x.metric: x.bound for x in study.objective.limits}
    with plots.figure(path, rows, columns, squeeze=False, size=size) as axes:
        panels = list(axes.ravel())
        for ax, (name, values) in zip(panels, found.metrics.items(), strict=False):
            _panel(ax, found, name, values, limits.get(name))
            for mark, at in marks.items():
                shape, face = _MARKS[mark]
                ax.plot(*at, shape, mfc=face, mec="black", ms=11, ls="none", label=f"{mark} law")
        for ax in panels[count:]:
            ax.set_axis_off()
        lines, labels = panels[0].get_legend_handles_labels()
        lines, labels = [*_proxies(found, limits), *lines], [*_titles(found, limits), *labels]
        axes[0, 0].figure.legend(
            lines, labels, loc="outside lower center", ncols=min(4, len(lines))
        )


def _panel(ax: Any, found: GainMap, name: str, values: np.ndarray, limit: float | None) -> None:
    from matplotlib.colors import LogNorm, Normalize

    ax.set_facecolor("0.75")
    ax.grid(False)
    if np.isfinite(values).any():
        low, high = _span(found, values)
        norm = LogNorm(low, high) if low > 0.0 and high > _WIDE * low else Normalize(low, high)
        shown = np.where(np.isfinite(values), values, np.nan)
        grid = found.x.values, found.y.values
        image = ax.pcolormesh(*grid, shown, norm=norm, cmap="viridis", shading="nearest")
        beyond = "max" if float(np.nanmax(shown)) > high else "neither"
        bar = ax.figure.colorbar(image, ax=ax, extend=beyond)
        if isinstance(norm, LogNorm):
            plots.plain_labels(bar.ax.yaxis)
        if limit is not None and np.nanmin(shown) < limit < np.nanmax(shown):
            ax.contour(*grid, shown, [limit], colors=plots.COLOURS["limit"], linewidths=2.0)
    _poles(ax, found)
    for axis, which in ((found.x, "x"), (found.y, "y")):
        if axis.log and axis.low > 0.0:
            plots.logarithmic(ax, which)
        getattr(ax, f"set_{which}lim")(axis.low, axis.high)
        getattr(ax, f"set_{which}label")(f"{axis.name} [{axis.unit}]")
    ax.set_title(name)


def _span(found: GainMap, values: np.ndarray) -> tuple[float, float]:
    """Ends of the colours: of the points where every mode is stable, where there are any."""
    own = np.isfinite(values) & (found.stable[::FINER, ::FINER] if found.modes else True)
    chosen = values[own] if own.any() else values[np.isfinite(values)]
    low, high = float(chosen.min()), float(chosen.max())
    return low, high if high > low else low + (abs(low) or 1.0)


def _poles(ax: Any, found: GainMap) -> None:
    """Where each mode turns unstable, hatched beyond; and the bound of the 2014 paper."""
    grid = found.x.fine, found.y.fine
    for k, mode in enumerate(found.modes):
        if mode.rightmost.min() < 0.0 <= mode.rightmost.max():
            style = _MODE_STYLES[k % len(_MODE_STYLES)]
            unstable = np.where(
                mode.rightmost > 0.0, mode.rightmost, np.minimum(mode.rightmost, -1e-9)
            )
            ax.contour(*grid, unstable, [0.0], colors="white", linewidths=1.6, linestyles=style)
    if found.modes and not found.stable.all():
        ax.contourf(*grid, (~found.stable).astype(float), [0.5, 1.5], colors="none", hatches=["//"])
    for edge in found.edges:
        pair = (edge.K_p, edge.K_i) if found.x.path.endswith("K_p") else (edge.K_i, edge.K_p)
        ax.plot(*pair, color="#D55E00", lw=1.6)


def _proxies(found: GainMap, limits: dict[str, float]) -> list[Any]:
    """Handles for lines that contours draw, which have none."""
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color="0.4", ls=_MODE_STYLES[k % 4]) for k in _crossing(found)]
    lines += [Line2D([], [], color="#D55E00") for _ in found.edges]
    shown = any(name in limits for name in found.metrics)
    return lines + ([Line2D([], [], color=plots.COLOURS["limit"], lw=2.0)] if shown else [])


def _titles(found: GainMap, limits: dict[str, float]) -> list[str]:
    titles = [f"edge of {found.modes[k].name} (white)" for k in _crossing(found)]
    titles += [f"(22), axis {edge.axis}" for edge in found.edges]
    return titles + (["limit"] if any(name in limits for name in found.metrics) else [])


def _crossing(found: GainMap) -> list[int]:
    return [k for k, m in enumerate(found.modes) if m.rightmost.min() < 0.0 <= m.rightmost.max()]


def marked(law: Any, x: Axis, y: Axis) -> tuple[float, float]:
    """The two gains of a law."""
    from jaxsim import tree

    return float(tree.get(law, x.path)), float(tree.get(law, y.path))
