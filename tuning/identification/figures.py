"""Pictures of an identification: fit over readings, residuals, profiles, logs alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.loop import UNITS
from jaxsim.plots import COLOURS, LABELS, figure
from tuning.identification.report import readings
from tuning.identification.session import Outcome
from tuning.identification.uncertainty import autocorrelation

_MOST = 6  # logs drawn; more would be a wall of pictures
_LAGS = 60


def draw(outcome: Outcome, out: Path) -> list[tuple[str, Path]]:
    """All figures, with captions; returns (caption, path)."""
    made = []
    for e in _chosen(outcome):
        made.append(_fit(outcome, e, out))
    made.append(_residuals(outcome, out))
    made += [_profile(outcome, k, out) for k in range(len(outcome.profiles))]
    if outcome.alone:
        made.append(_alone(outcome, out))
    return made


def _chosen(outcome: Outcome) -> list[int]:
    """Fitted logs first, then held-out ones; the worst of each where there are too many."""
    worst = (outcome.error / outcome.problem.readings.noise).max(axis=1)
    found: list[int] = []
    for group in (outcome.train, outcome.test):
        order = sorted(group.tolist(), key=lambda e: -worst[e])
        found += sorted(order[: _MOST // 2]) if len(order) > _MOST // 2 else order
    return found


def _fit(outcome: Outcome, e: int, out: Path) -> tuple[str, Path]:
    recorded = outcome.recorded[e]
    name = "".join(c if c.isalnum() else "_" for c in recorded.experiment.name)
    path = out / f"fit_{name}.png"
    signals = outcome.problem.signals
    rows = 2 * len(signals)
    ratios = [2.4, 1.0] * len(signals)
    with figure(
        path, rows, sharex=True, squeeze=False, size=(8.4, 2.6 * len(signals) + 0.8),
        gridspec_kw={"height_ratios": ratios},
    ) as axes:  # fmt: skip
        for s, signal in enumerate(signals):
            top, below = axes[2 * s, 0], axes[2 * s + 1, 0]
            _pair(outcome, e, s, top, below)
            top.set_ylabel(LABELS.get(signal, signal))
            below.set_ylabel(f"model - reading\n[{UNITS[signal.partition('[')[0]]}]", fontsize=8)
        use = "fitted" if e in outcome.train else "held out"
        axes[0, 0].set_title(f"{recorded.experiment.name} ({use})")
        axes[0, 0].legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        axes[0, 0].figure.align_ylabels()
        axes[-1, 0].set_xlabel("time [s]")
    return (
        f"Log {recorded.experiment.name} ({use}): readings, the model, and their difference.",
        path,
    )


def _pair(outcome: Outcome, e: int, s: int, top: Any, below: Any) -> None:
    t, value, model, used = readings(outcome, e, s)
    top.plot(t, model, color=COLOURS["after"], linewidth=1.1, label="model")
    top.plot(t, value, ".", markersize=2.2, color="0.1", label="reading")
    raw = outcome.problem.experiments[e].measurements[s].values
    if not used.all():
        low, high = np.nanmin(value), np.nanmax(value)
        inside = np.clip(raw[~used], low - 0.1 * (high - low), high + 0.1 * (high - low))
        top.plot(t[~used], inside, "x", color=COLOURS["limit"], label="masked", markersize=4)
    below.plot(t, model - value, color=COLOURS["linear"], linewidth=0.7)


def _residuals(outcome: Outcome, out: Path) -> tuple[str, Path]:
    """Distribution, autocorrelation and spectrum of what is left, per signal, fitted logs."""
    path = out / "residuals.png"
    signals = outcome.problem.signals
    with figure(
        path, len(signals), 3, squeeze=False, size=(10.0, 2.3 * len(signals) + 0.7)
    ) as axes:
        for s, signal in enumerate(signals):
            series = [
                outcome.evaluation.residuals[0, e, s][outcome.problem.readings.used[e, s]]
                for e in outcome.train
            ]
            _histogram(axes[s, 0], np.concatenate(series), signal)
            _correlation(axes[s, 1], series)
            _spectrum(axes[s, 2], outcome, series)
        for ax, title in zip(axes[0], ("Residuals", "Autocorrelation", "Spectrum"), strict=True):
            ax.set_title(title)
        axes[-1, 0].set_xlabel("standard deviations of the noise")
        axes[-1, 1].set_xlabel("lag [readings]")
        axes[-1, 2].set_xlabel("frequency [Hz]")
    caption = (
        "What is left of the fitted logs. White residuals follow the dashed bell, stay within the "
        "dotted band at all lags, and have a flat spectrum."
    )
    return caption, path


def _histogram(ax: Any, r: np.ndarray, signal: str) -> None:
    reach = max(4.0, float(np.quantile(np.abs(r), 0.995)))
    ax.hist(np.clip(r, -reach, reach), 60, density=True, color=COLOURS["after"], alpha=0.8)
    x = np.linspace(-reach, reach, 200)
    ax.plot(x, np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi), "--", color="0.2")
    ax.set_ylabel(signal)
    ax.set_yticks([])


def _correlation(ax: Any, series: list[np.ndarray]) -> None:
    for r in series[:12]:
        rho = autocorrelation(r)[1 : _LAGS + 1]
        ax.plot(np.arange(1, len(rho) + 1), rho, color=COLOURS["after"], linewidth=0.9, alpha=0.7)
    band = 1.96 / np.sqrt(max(np.median([len(r) for r in series]), 1.0))
    for side in (-band, band):
        ax.axhline(side, color="0.3", linestyle=":")
    ax.set_ylim(-1.05, 1.05)


def _spectrum(ax: Any, outcome: Outcome, series: list[np.ndarray]) -> None:
    from scipy.signal import welch

    times = outcome.problem.experiments[int(outcome.train[0])].measurements[0].times
    rate = 1.0 / float(np.median(np.diff(times)))
    for r in series[:12]:
        if len(r) >= 32:
            f, power = welch(r, rate, nperseg=min(256, len(r) // 2))
            ax.loglog(f[1:], power[1:], color=COLOURS["after"], linewidth=0.9, alpha=0.7)
    ax.axhline(2.0 / rate, color="0.3", linestyle=":")


def _profile(outcome: Outcome, k: int, out: Path) -> tuple[str, Path]:
    p = outcome.profiles[k]
    column = outcome.names.index(p.name)
    path = out / f"profile_{''.join(c if c.isalnum() else '_' for c in p.name)}.png"
    with figure(path, size=(6.0, 3.2)) as ax:
        ax.plot(p.values, p.loss - p.least, "o-", color=COLOURS["after"], label="profile")
        spread = outcome.seen.deviation[column]
        kappa = outcome.seen.matrix[column, column] / outcome.seen.naive[column, column]
        grid = np.linspace(p.values[0], p.values[-1], 200)
        bowl = 0.5 * kappa * ((grid - outcome.values[column]) / spread) ** 2
        ax.plot(grid, bowl, "--", color="0.45", label="from the covariance")
        ax.axhline(p.rise, color=COLOURS["limit"], linestyle=":", label="bound of the interval")
        for end in p.interval:
            if np.isfinite(end):
                ax.axvline(end, color=COLOURS["limit"], linewidth=0.8)
        ax.set(xlabel=f"{p.name} [{outcome.unit(column)}]", ylabel="rise of the loss")
        ax.set_title(f"Profile of {p.name}")
        ax.legend()
    return f"Loss along {p.name}, everything else fitted anew at each point.", path


def _alone(outcome: Outcome, out: Path) -> tuple[str, Path]:
    """What each log says for itself about each shared unknown."""
    path = out / "logs_alone.png"
    columns = min(4, len(outcome.alone))
    rows = -(-len(outcome.alone) // columns)
    with figure(path, rows, columns, squeeze=False, size=(2.6 * columns + 0.6, 2.4 * rows)) as axes:
        for ax in axes.ravel()[len(outcome.alone) :]:
            ax.set_visible(False)
        for ax, a in zip(axes.ravel(), outcome.alone, strict=False):
            where = outcome.names.index(a.name)
            at = np.arange(len(a.values))
            ax.errorbar(at, a.values, 1.96 * a.deviation, fmt="o", markersize=3.5, capsize=2)
            ax.axhline(outcome.values[where], color="0.2", linewidth=0.9)
            ax.axhspan(*outcome.interval[where], color="0.85", zorder=0)
            ax.set_title(f"{a.name} [{outcome.unit(where)}]", fontsize=9)
            ax.set_xticks(at)
            ax.set_xlim(-0.5, len(at) - 0.5)
            ax.set_xlabel("log")
    return "Each log fitted alone (points, 95 %), and all together (line and band).", path
