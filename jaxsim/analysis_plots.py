"""Figures of a linear analysis: pole-zero map, root loci, Bode, stability region."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.analysis import Analysis, Family, Mode, Region
from jaxsim.linear import routh
from jaxsim.linear.frequency import bode
from jaxsim.linear.stability import root_locus
from jaxsim.linear.state_space import StateSpace, per_axis
from jaxsim.plots import figure, locus

_DECADES = 2.0  # of the Bode plots beyond the slowest and fastest pole
_LOCI = {"gain": "loop gain", "K_p": "K_p / its value", "alpha": "alpha / its value"}


def draw(analysis: Analysis, out: Path) -> list[str]:
    """All figures that an analysis has, into a folder; their names."""
    files = {"pole_zero.png": lambda path: _pole_zero(path, analysis)}
    for kind in _LOCI:
        if getattr(analysis.modes[0], kind) is not None:
            files[f"root_locus_{kind}.png"] = lambda path, kind=kind: _loci(path, analysis, kind)
    files["bode.png"] = lambda path: _bode(path, analysis)
    region = analysis.region
    if region is not None:
        files["stability_region.png"] = lambda path: _region(path, analysis.study, region)
    for name, drawn in files.items():
        drawn(out / name)
    return list(files)


def _panels(path: Path, modes: list[Mode]) -> Any:
    columns = min(2, len(modes))
    rows = -(-len(modes) // columns)
    return figure(path, rows, columns, squeeze=False, size=(4.6 * columns + 1.2, 3.3 * rows + 0.5))


def _symlog(ax: Any, values: np.ndarray) -> None:
    """Poles lie between 0.01 and 10000 1/s: logarithmic on both sides of a linear middle."""
    parts = np.concatenate([np.abs(np.real(values)), np.abs(np.imag(values))])
    least = parts[parts > 1e-6].min(initial=1.0)
    middle = max(10.0 ** np.floor(np.log10(least)), 0.01)
    for set_scale, part in ((ax.set_xscale, np.real(values)), (ax.set_yscale, np.imag(values))):
        set_scale("symlog", linthresh=middle)
        reach = 3.0 * max(float(np.abs(part).max()), middle)
        limits = (-reach, max(3.0 * float(part.max()), 3.0 * middle))
        (ax.set_xlim if set_scale == ax.set_xscale else ax.set_ylim)(*limits)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_major_locator().numticks = 7
    ax.axvline(0.0, color="0.35", linewidth=0.9)
    ax.set(xlabel="real [1/s]", ylabel="imaginary [1/s]")


def _pole_zero(path: Path, analysis: Analysis) -> None:
    with _panels(path, analysis.modes) as axes:
        for ax, mode in zip(axes.flat, analysis.modes, strict=False):
            found = mode.poles
            ax.plot(np.real(found), np.imag(found), "x", label="poles, closed loop")
            ax.plot(
                np.real(mode.zeros), np.imag(mode.zeros), "o", markerfacecolor="none",
                label=f"zeros, command to {analysis.controlled}",
            )  # fmt: skip
            ax.set_title(f"{analysis.study}: {mode.name}", fontsize=9.0)
            _symlog(ax, np.concatenate([found, mode.zeros]))
        _below(axes.flat[len(analysis.modes) - 1])
        _blank(axes, len(analysis.modes))


def _below(ax: Any) -> None:
    """The legend under the last panel: inside it would hide poles."""
    ax.legend(loc="upper left", bbox_to_anchor=(-0.1, -0.2), ncols=3)


def _blank(axes: Any, used: int) -> None:
    for ax in list(axes.flat)[used:]:
        ax.set_axis_off()


def _values(family: Family, kind: str) -> np.ndarray:
    """A share goes from 0 to 1; a gain to past where the loop turns unstable, or to 10."""
    if kind == "alpha":
        return np.linspace(0.0, 1.0, 301)
    finite = [edge for pair in family.intervals() for edge in pair if 1.0 < edge < 1e3]
    return np.concatenate([[0.0], np.geomspace(1e-3, 1.5 * max([*finite, 10.0 / 1.5]), 500)])


def _loci(path: Path, analysis: Analysis, kind: str) -> None:
    modes = [m for m in analysis.modes if getattr(m, kind) is not None]
    with _panels(path, modes) as axes:
        for ax, mode in zip(axes.flat, modes, strict=False):
            family: Family = getattr(mode, kind)
            values = _values(family, kind)
            branches = root_locus(family.roots, values)
            locus(ax, branches, values, _LOCI[kind])
            ax.plot(np.real(mode.zeros), np.imag(mode.zeros), "o", markerfacecolor="none",
                    color="C1", label="zeros")  # fmt: skip
            ax.set_title(f"{analysis.study}: {mode.name}", fontsize=9.0)
            _symlog(ax, np.concatenate([branches.ravel(), mode.zeros]))
        _below(axes.flat[len(modes) - 1])
        _blank(axes, len(modes))


def _lines(analysis: Analysis) -> list[tuple[str, StateSpace, StateSpace]]:
    """Label, cut loop and closed loop: per mode and axis; of several axes in contact only."""
    p = len(analysis.theta_L)
    shown = analysis.modes if p == 1 else analysis.modes[:1]
    outputs, inputs = per_axis(analysis.controlled, p), per_axis("reference", p)
    return [
        (mode.name if p == 1 else f"{mode.name}, axis {i}", mode.loops[i],
         mode.system.channel([outputs[i]], [inputs[i]]))
        for mode in shown for i in range(p)
    ]  # fmt: skip


def _bode(path: Path, analysis: Analysis) -> None:
    rates = np.abs(np.concatenate([m.poles for m in analysis.modes]))
    rates = rates[rates > 1e-6 * rates.max()]
    edge = 10.0**_DECADES
    omega = np.geomspace(max(rates.min() / edge, 1e-3), rates.max() * edge, 1500)
    with figure(path, 2, 2, sharex=True, size=(9.6, 6.0)) as axes:
        for label, loop, closed in _lines(analysis):
            for column, system in zip(axes.T, (loop, closed), strict=True):
                data = bode(system, omega)
                seen = data.magnitude[:, 0, 0] > 1e-12
                hertz = omega[seen] / (2.0 * np.pi)
                column[0].loglog(hertz, data.magnitude[seen, 0, 0], label=label)
                column[1].semilogx(hertz, np.degrees(data.phase[seen, 0, 0]))
        axes[0, 0].set(title=f"{analysis.study}: loop cut at the command", ylabel="magnitude")
        axes[0, 1].set_title(f"closed loop, reference to {analysis.controlled}")
        axes[0, 0].axhline(1.0, color="0.5", linestyle=":")
        axes[0, 0].legend()
        axes[1, 0].set_ylabel("phase [deg]")
        for ax in axes[0]:
            ax.set_ylim(1e-6, None)
        for ax in axes[1]:
            ax.set_xlabel("frequency [Hz]")


def _region(path: Path, study: str, region: Region) -> None:
    K_p, K_i = routh.stability_region(region.joints, 400)
    with figure(path, size=(6.4, 4.0)) as ax:
        for i in range(K_p.shape[1]):
            ax.plot(K_p[:, i], K_i[:, i], color=f"C{i}", label=f"edge, axis {i}",
                    linestyle=("-", "--")[i % 2])  # fmt: skip
            ax.plot(region.K_p[i], region.K_i[i], "o", color=f"C{i}", label=f"gains, axis {i}")
        ax.fill_between(K_p[:, 0], 1e-3, K_i.min(axis=1), alpha=0.12, color="C0")
        low = 0.3 * min(float(region.K_i.min()), float(K_i.max()))
        ax.set(
            title=f"{study}: stable PI gains, full positive feedback", xlabel="K_p [V/Nm]",
            ylabel="K_i [1/s]", yscale="log", ylim=(max(low, 1e-2), None),
        )  # fmt: skip
        ax.legend()
