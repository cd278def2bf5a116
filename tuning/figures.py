"""Plots of a tuning run."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim import batch, plots
from jaxsim._simulate import simulate
from tuning import space
from tuning.result import Result, Scores
from tuning.session import FULL, Session

_TITLE = 52  # characters of a title that a panel has room for
_SIGNALS = ("theta_L", "T_s", "T_M")
_WHEN = ("before", "after")


def draw(session: Session, result: Result, out: Path) -> None:
    """responses.png, spread.png and convergence.png."""
    _responses(session, result, out / "responses.png")
    _spread(session, result, out / "spread.png")
    _convergence(session, out / "convergence.png")


def _worst(session: Session, result: Result) -> tuple[int, int]:
    """Row of the drive and scenario that decide: worst of the first limit, or goal, when tuned."""
    objective = session.spec.objective
    first = (*objective.limits, *objective.goals)[0].metric
    return result.after.worst(first)[1:]


def _responses(session: Session, result: Result, path: Path) -> None:
    """Time responses as the study is and in the worst case, before and after."""
    chosen = list(dict.fromkeys([(0, 0), _worst(session, result)]))
    cases = [(int(result.drives[row]), scenario) for row, scenario in chosen]
    shape = (len(_SIGNALS), len(cases))
    with plots.figure(path, *shape, sharex="col", sharey="row", squeeze=False) as axes:
        for column, case in enumerate(cases):
            run = _both(session, result, *case)
            for row, name in enumerate(_SIGNALS):
                for k, when in enumerate(_WHEN):
                    signal = np.asarray(run.signals[name][k])
                    one = signal.reshape(len(signal), -1)
                    time = 1e3 * np.asarray(run.time[0])
                    axes[row, column].plot(time, one[:, 0], label=when, color=plots.COLOURS[when])
                axes[row, 0].set_ylabel(plots.LABELS[name])
            axes[0, column].set_title(_heading(session.problem.label(*case)))
            axes[-1, column].set_xlabel("time [ms]")
        _draw_bounds(session, axes)
        axes[0, 0].legend(loc="lower right")


def _both(session: Session, result: Result, index: int, scenario: int) -> Any:
    """The run of a drive in a scenario under the study's law and the tuned one."""
    study, free = session.study, session.spec.free
    laws = [space.with_gains(study.law, free, g) for g in (result.initial, result.gains)]
    return simulate(
        session.problem.drive(index),
        batch.stack(laws),
        study.scenarios[session.problem.scenarios[scenario]],
        dt=study.run.dt,
        deadzone=study.run.deadzone,
        metrics=(),
        throw=False,
    )


def _heading(label: str) -> str:
    named = label.replace("drive", "worst drive", 1) if label.startswith("drive") else label
    return textwrap.fill(named, _TITLE)


def _draw_bounds(session: Session, axes: Any) -> None:
    """The limit on the torque, where there is one."""
    for limit in session.spec.objective.limits:
        if limit.metric == "largest_torque_Nm":
            for ax in axes[_SIGNALS.index("T_s")]:
                for sign in (1.0, -1.0):
                    ax.axhline(sign * limit.most, color=plots.COLOURS["limit"], ls="--", lw=1.0)


def _spread(session: Session, result: Result, path: Path) -> None:
    """Share of the drives below a value, per metric of the objective: before and after."""
    names = session.problem.metrics
    bounds = {x.metric: x.most for x in session.spec.objective.limits}
    with plots.figure(
        path, 1, len(names), squeeze=False, size=(3.6 * len(names) + 0.8, 3.4)
    ) as axes:
        for ax, name in zip(axes[0], names, strict=True):
            for when, scores in zip(_WHEN, (result.before, result.after), strict=True):
                _draw_shares(ax, scores, name, when)
            if name in bounds:
                colour = plots.COLOURS["limit"]
                ax.axvline(bounds[name], color=colour, ls="--", lw=1.2, label="limit")
            ax.set_xlabel(name)
            ax.locator_params(axis="x", nbins=5)
            ax.ticklabel_format(axis="x", scilimits=(-2, 4))
            ax.margins(x=0.08)
        axes[0, 0].set_title("triangle: mean, dot: worst")
        axes[0, 0].set_ylabel(f"share of {result.after.status.size} runs below")
        axes[0, -1].legend(loc="lower right")


def _draw_shares(ax: Any, scores: Scores, name: str, when: str) -> None:
    values = np.sort(scores.values[name].reshape(-1))
    values = values[np.isfinite(values)]
    if len(values):
        shares = np.arange(1, len(values) + 1) / len(values)
        colour = plots.COLOURS[when]
        ax.step(values, shares, where="post", color=colour, label=when)
        ax.plot(values[-1], 1.0, "o", color=colour, ms=4)
        ax.plot([values.mean()], [0.0], "^", color=colour, ms=7, clip_on=False)


def _convergence(session: Session, path: Path) -> None:
    """Cost of every start over the iterations; open marks exceed a limit."""
    stages = list(dict.fromkeys(row["stage"] for row in session.history))
    size = (4.6 * len(stages) + 1.0, 3.6)
    with plots.figure(path, 1, len(stages), squeeze=False, size=size) as axes:
        for ax, stage in zip(axes[0], stages, strict=True):
            rows = [row for row in session.history if row["stage"] == stage]
            for start in sorted({row["start"] for row in rows}):
                _draw_start(ax, [row for row in rows if row["start"] == start])
            drives = session.spec.count if stage == FULL else session.spec.screen
            ax.set_title(f"{drives} drives" if drives > 1 else "one drive")
            ax.set_xlabel("iteration (open marks: a limit is exceeded)")
            costs = [row["cost"] for row in rows]
            ax.set_yscale("log" if 0.0 < 3.0 * min(costs) < max(costs) else "linear")
        axes[0, 0].set_ylabel("cost")


def _draw_start(ax: Any, rows: list[dict[str, Any]]) -> None:
    x, y = ([row[k] for row in rows] for k in ("iteration", "cost"))
    (line,) = ax.plot(x, y, lw=1.0)
    for kept in (True, False):
        chosen = [i for i, row in enumerate(rows) if (row["violation"] <= 0.0) == kept]
        face = line.get_color() if kept else "white"
        xs, ys = [x[i] for i in chosen], [y[i] for i in chosen]
        ax.plot(xs, ys, "o", ms=3.5, mfc=face, mec=line.get_color(), ls="none")
