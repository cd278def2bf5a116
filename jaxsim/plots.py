"""The one look of all plots. Figures are made without pyplot, so nothing global changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

# Okabe and Ito's palette: told apart by colour-blind readers and in grey print.
COLOURS = {
    "none": "#0072B2",
    "linear": "#D55E00",
    "switched": "#009E73",
    "before": "#7F7F7F",
    "after": "#0072B2",
    "limit": "#CC79A7",
    "reference": "#000000",
}
CYCLE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLE = {
    "figure.dpi": 110,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 150,
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 9.5,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#E5E5E5",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.4,
}
LABELS = {
    "reference": "reference",
    "command": "command",
    "theta_L": "load angle [rad]",
    "omega_L": "load speed [rad/s]",
    "theta_B": "deflection [rad]",
    "omega_B": "deflection speed [rad/s]",
    "theta_M": "motor angle [rad]",
    "omega_M": "motor speed [rad/s]",
    "T_s": "joint torque [Nm]",
    "T_M": "motor torque [Nm]",
    "d_L": "load torque [Nm]",
}


@contextmanager
def figure(path: Path, rows: int = 1, columns: int = 1, **options: Any) -> Iterator[Any]:
    """Axes (rows, columns) to draw on; saved to `path` at the end.

    options: of `Figure.subplots`, and `size` = (width, height) in inches.
    """
    import matplotlib
    from cycler import cycler
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    size = options.pop("size", (4.8 * columns + 1.2, 2.3 * rows + 0.8))
    look: Any = {**STYLE, "axes.prop_cycle": cycler(color=CYCLE)}
    with matplotlib.rc_context(look):
        made = Figure(figsize=size)
        FigureCanvasAgg(made)
        yield made.subplots(rows, columns, **options)
        path.parent.mkdir(parents=True, exist_ok=True)
        made.savefig(path)


def responses(path: Path, runs: Mapping[str, Any], names: tuple[str, ...], title: str) -> None:
    """Signals of stored runs over time, one row per signal and one line per run and axis.

    The reference of the first run is drawn where it belongs: with the load angle in rad, or with
    the joint torque in Nm.
    """
    first = next(iter(runs.values()))
    followed = {"rad": "theta_L", "Nm": "T_s"}.get(first.units["reference"], "")
    size = (8.0, 2.1 * len(names) + 0.6)
    with figure(path, len(names), sharex=True, squeeze=False, size=size) as axes:
        rows = dict(zip(names, axes[:, 0], strict=True))
        for name, ax in rows.items():
            for label, run in runs.items():
                _draw(ax, run, name, label)
            ax.set_ylabel(LABELS.get(name, name))
        legend = rows.get(followed, axes[0, 0])
        if followed in rows:
            _draw(legend, first, "reference", "reference", linestyle=":", color="0.3")
        legend.legend(ncols=min(len(legend.lines), 3))
        axes[0, 0].set_title(title)
        axes[-1, 0].set_xlabel("time [ms]")


def _draw(ax: Any, run: Any, name: str, label: str, **look: Any) -> None:
    """A signal of a run, one line per axis; of several axes in colours of their own."""
    values = np.asarray(run.signals[name]).reshape(len(run.time), -1)
    for axis, column in enumerate(values.T):
        own = {} if values.shape[1] > 1 else {"color": COLOURS.get(label)}
        told = f"{label}, axis {axis}" if values.shape[1] > 1 else label
        ax.plot(1e3 * np.asarray(run.time), column, label=told, **(own | look))


def logarithmic(ax: Any, which: str) -> None:
    """A logarithmic axis, "x" or "y", with plain labels."""
    getattr(ax, f"set_{which}scale")("log")
    plain_labels(getattr(ax, f"{which}axis"))


def plain_labels(axis: Any) -> None:
    """Plain numbers at 1, 2, 5 of each decade on a logarithmic axis or colour bar."""
    for put in (axis.set_major_formatter, axis.set_minor_formatter):
        put(_decimal)


def _decimal(value: float, _: Any) -> str:
    lead = value / 10.0 ** np.floor(np.log10(value) + 1e-9)
    return f"{value:g}" if round(lead, 6) in (1.0, 2.0, 5.0) else ""


def locus(ax: Any, branches: Any, values: Any, name: str) -> None:
    """Root-locus branches (values, poles) of a parameter: crosses begin, triangles end."""
    for branch in np.asarray(branches).T:
        ax.plot(branch.real, branch.imag, color="C0", linewidth=1.2)
    for mark, row, value in (("x", branches[0], values[0]), ("^", branches[-1], values[-1])):
        ax.plot(row.real, row.imag, mark, color="0.15", markersize=5, label=f"{name} = {value:.4g}")
