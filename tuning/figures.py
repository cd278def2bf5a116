"""Plots of a tuning run."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim import batch, plots
from jaxsim._simulate import simulate
from jaxsim.objective import Objective
from tuning.certificate import Case
from tuning.result import Result
from tuning.scoring import Scores
from tuning.session import Session

_TITLE = 52  # characters of a title that a panel has room for
_SIGNALS = ("theta_L", "T_s", "T_M")
_WHEN = ("before", "after")
FILES = ("responses.png", "spread.png", "convergence.png", "sensitivities.png")


def draw(session: Session, result: Result, out: Path) -> None:
    """Each of `FILES`."""
    _responses(session, result, out / "responses.png")
    _spread(session, result, out / "spread.png")
    _convergence(session, out / "convergence.png")
    _sensitivities(session, result, out / "sensitivities.png")


def _responses(session: Session, result: Result, path: Path) -> None:
    """Time responses as the study is and in the worst case, before and after."""
    shape = (len(_SIGNALS), len(result.cases))
    alike = len({case.scenario for case in result.cases}) == 1
    options = {"sharex": "col", "sharey": "row" if alike else False, "squeeze": False}
    with plots.figure(path, *shape, **options) as axes:
        for column, case in enumerate(result.cases):
            run = _both(session, result, *case)
            time = 1e3 * np.asarray(run.time[0])
            _draw_reference(session, axes[:, column], run, time)
            for row, name in enumerate(_SIGNALS):
                for k, when in enumerate(_WHEN):
                    colour, label = plots.COLOURS[when], when
                    axes[row, column].plot(time, _first(run, name, k), label=label, color=colour)
                several = ", axis 0" if session.study.drive.axes > 1 else ""
                axes[row, 0].set_ylabel(plots.LABELS[name] + several)
            axes[0, column].set_title(_heading(session.problem.label(*case)))
            axes[-1, column].set_xlabel("time [ms]")
        _draw_bounds(session, axes)
        axes[_SIGNALS.index(_follows(session)), 0].legend(loc="lower right")


def _first(run: Any, name: str, member: int) -> np.ndarray:
    """A signal of the first axis."""
    signal = np.asarray(run.signals[name][member])
    return signal.reshape(len(signal), -1)[:, 0]


def _draw_reference(session: Session, column: Any, run: Any, time: np.ndarray) -> None:
    """The reference, under the signal that follows it."""
    ax, colour = column[_SIGNALS.index(_follows(session))], plots.COLOURS["reference"]
    ax.plot(time, _first(run, "reference", 0), color=colour, lw=0.9, ls=":", label="reference")


def _follows(session: Session) -> str:
    """The signal that follows the reference."""
    return "T_s" if session.study.law.reference_unit == "Nm" else "theta_L"


def _both(session: Session, result: Result, index: int, scenario: int) -> Any:
    """The run of a drive in a scenario under the study's law and the tuned one."""
    study = session.study
    laws = [session.problem.law(index, g) for g in (result.initial, result.gains)]
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
    colour = plots.COLOURS["limit"]
    for limit in session.spec.objective.limits:
        if limit.metric == "largest_torque_Nm":
            for ax in axes[_SIGNALS.index("T_s")]:
                for sign in (1.0, -1.0):
                    ax.axhline(sign * limit.bound, color=colour, ls="--", lw=1.0)
                place = {"transform": ax.get_yaxis_transform(), "ha": "right", "va": "bottom"}
                ax.text(0.99, limit.bound, "limit", color=colour, **place)


def _spread(session: Session, result: Result, path: Path) -> None:
    """Share of the runs below a value, per metric of the objective: before and after."""
    names, objective = session.problem.metrics, session.spec.objective
    bounds = {x.metric: x.bound for x in objective.limits}
    columns = 2 if len(names) in (2, 4) else min(len(names), 3)
    rows = -(-len(names) // columns)
    size = (3.8 * columns + 0.8, 3.0 * rows + 0.6)
    with plots.figure(path, rows, columns, squeeze=False, size=size) as axes:
        panels = list(axes.ravel())
        for ax in panels[len(names) :]:
            ax.set_axis_off()
        for ax, name in zip(panels, names, strict=False):
            for when, scores in zip(_WHEN, (result.before, result.after), strict=True):
                _draw_shares(ax, scores, objective, name, when)
            if name in bounds:
                colour = plots.COLOURS["limit"]
                ax.axvline(bounds[name], color=colour, ls="--", lw=1.2, label="limit")
            ax.set_xlabel(name)
            ax.locator_params(axis="x", nbins=5)
            ax.ticklabel_format(axis="x", scilimits=(-2, 4))
            ax.margins(x=0.08)
        for ax in axes[:, 0]:
            ax.set_ylabel(f"share of {result.after.status.size} runs below")
        keys = {label: line for ax in panels for line, label in zip(*_legend(ax), strict=True)}
        place = {"loc": "outside lower center", "ncols": len(keys)}
        panels[0].figure.legend(keys.values(), keys.keys(), **place)


def _legend(ax: Any) -> tuple[list[Any], list[str]]:
    return ax.get_legend_handles_labels()


def _draw_shares(ax: Any, scores: Scores, objective: Objective, name: str, when: str) -> None:
    values = np.sort(scores.values[name].reshape(-1))
    values = values[np.isfinite(values)]
    if len(values):
        shares = np.arange(1, len(values) + 1) / len(values)
        colour = plots.COLOURS[when]
        ax.step(values, shares, where="post", color=colour, label=when)
        more = objective.sign(name) == 1.0
        worst = (values[-1], 1.0) if more else (values[0], shares[0])
        ax.plot(*worst, "o", color=colour, ms=5, ls="none", label=f"worst {when}")
        mean = {"color": colour, "ms": 7, "clip_on": False, "ls": "none"}
        ax.plot([values.mean()], [0.0], "^", label=f"mean {when}", **mean)


def _convergence(session: Session, path: Path) -> None:
    """Cost of every start over the iterations: the best start in colour, open marks exceed."""
    stages = list(dict.fromkeys(row["stage"] for row in session.history))
    size = (4.6 * len(stages) + 1.0, 3.6)
    power = _power([row["cost"] for row in session.history])
    goals = session.spec.objective.goals
    what = goals[0].metric if len(goals) == 1 else "sum of the goals"
    with plots.figure(path, 1, len(stages), squeeze=False, size=size) as axes:
        for ax, stage in zip(axes[0], stages, strict=True):
            rows = [row for row in session.history if row["stage"] == stage]
            _draw_stage(ax, rows, 10.0**-power)
            ax.set_title(stage)
            ax.set_xlabel("iteration")
            ax.xaxis.get_major_locator().set_params(integer=True)
        axes[0, 0].set_ylabel(f"cost: {what}" + (f" [$10^{{{power}}}$]" if power else ""))
        axes[0, -1].legend(loc="upper right")


def _power(costs: list[float]) -> int:
    """The power of ten by which costs are written; 0 where they need none."""
    most = max(map(abs, costs))
    power = int(np.floor(np.log10(most))) if most > 0.0 else 0
    return power if abs(power) > 2 else 0


def _draw_stage(ax: Any, rows: list[dict[str, Any]], scale: float) -> None:
    """All starts in grey but the one that ends best, by violation, then cost."""
    starts = sorted({row["start"] for row in rows})
    own = {k: [row for row in rows if row["start"] == k] for k in starts}
    rank = {k: min((r["violation"], r["cost"]) for r in v) for k, v in own.items()}
    best = min(starts, key=lambda k: rank[k])
    others = [k for k in starts if k != best]
    for k in (*others, best):
        colour = plots.COLOURS["after" if k == best else "before"]
        name = "best start" if k == best else "other starts" if k == others[0] else None
        y = scale * np.array([row["cost"] for row in own[k]])
        x = np.arange(len(y))  # a start that is taken up counts its iterations anew
        ax.plot(x, y, lw=1.6 if k == best else 0.8, color=colour, label=name)
        kept = np.array([row["violation"] <= 0.0 for row in own[k]])
        ax.plot(x[kept], y[kept], "o", ms=3.5, color=colour, ls="none")
        open_ = "exceeds a limit" if k == best and not kept.all() else None
        at = x[~kept], y[~kept]
        ax.plot(*at, "o", ms=3.5, mfc="white", mec=colour, ls="none", label=open_)
    costs = [scale * row["cost"] for row in rows]
    if 0.0 < 3.0 * min(costs) < max(costs):
        plots.logarithmic(ax, "y")


def _sensitivities(session: Session, result: Result, path: Path) -> None:
    """Per cent of each metric of the objective per per cent of each gain, case by case."""
    names = [f.name for f in session.spec.free]
    size = (4.6 * len(result.cases) + 1.0, 1.0 + 0.2 * len(names) * len(session.problem.metrics))
    options = {"squeeze": False, "sharey": True, "size": size}
    with plots.figure(path, 1, len(result.cases), **options) as axes:
        for ax, case in zip(axes[0], result.cases, strict=True):
            _draw_case(ax, session, result, case)
            ax.set_axisbelow(True)
            ax.set_title(_heading(session.problem.label(*case)))
            ax.set_xlabel("% of the metric per % of the gain")
        axes[0, 0].set_yticks(range(len(names)), names)
        axes[0, 0].invert_yaxis()
        axes[0, -1].legend(loc="best")


def _draw_case(ax: Any, session: Session, result: Result, case: Case) -> None:
    told = {(x.metric, x.gain): x.share for x in result.certificate.sensitivities if x.case == case}
    metrics, free = session.problem.metrics, session.spec.free
    height = 0.8 / len(metrics)
    for k, metric in enumerate(metrics):
        places = np.arange(len(free)) + height * (k - 0.5 * (len(metrics) - 1))
        ax.barh(places, [told[metric, f.name] for f in free], height=0.9 * height, label=metric)
    ax.axvline(0.0, color="0.3", lw=0.8)
