"""Tuning with exact, plain and smoothed gradients, and by CMA-ES, each scored on the exact model.

The problem is the bench of `bench_switched` for one drive: least ITAE over 0.3 s with largest
|T_s| <= 1.4 Nm and overshoot <= 3 %, four gains, 16 starts. The same search sees the exact, the
plain or the smoothed model. CMA-ES (the library `cma`) sees values of the exact model; each of its
eight runs, from the first eight starts, has the wall time of all sixteen of the exact search,
compiling apart. A law that breaks a limit at all counts as infeasible: our search keeps 1e-4 of
each bound in reserve, CMA-ES does not have to. The column `loose` is the best law where a limit
may be broken by 1e-4 of itself.
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cma
import numpy as np
from rich.console import Console
from rich.table import Table

import jaxsim
from jaxsim.hybrid import Deadzone, Exact, Plain, Smoothed
from jaxsim.provenance import provenance, write_json
from jaxsim.study import Study, load
from tuning import space
from tuning.local import RESERVE, size
from tuning.problem import Problem
from tuning.scoring import fresh
from tuning.session import Session
from tuning.spec import Spec, read_spec

OUT = Path("results/bench/gradients_compared.json")
STARTS, CMA_RUNS = 16, 8
MODELS: dict[str, Deadzone] = {"exact": Exact(), "plain": Plain(), "smoothed": Smoothed()}
PENALTY = 10.0  # of a limit broken by its own size, in units of the study's cost


class Ends(NamedTuple):
    """True cost and share of the worst broken limit per start; wall time without compiling."""

    gains: np.ndarray
    cost: np.ndarray
    broken: np.ndarray
    seconds: float

    def row(self) -> dict[str, Any]:
        """Of the feasible laws the best and the median, infeasible ones counting as infinite."""
        loose = np.where(self.broken <= RESERVE, self.cost, np.inf)
        cost = np.where(self.broken <= 0.0, self.cost, np.inf)
        feasible = int(np.isfinite(cost).sum())
        best = self.gains[int(np.argmin(cost))].tolist()
        median = float(np.median(np.nan_to_num(cost, posinf=np.finfo(float).max)))
        return {
            "feasible": feasible,
            "starts": len(cost),
            "best": float(cost.min()),
            "median": median if median < 1e300 else None,
            "best_loose": float(loose.min()),
            "seconds": self.seconds,
            "gains": best,
        }


def problem() -> tuple[Study, Spec]:
    """`bench_switched` for the study's drive alone, from 16 starts."""
    study = load("bench_switched")
    spec = read_spec(study, starts=STARTS)
    return study, spec._replace(
        spreads=(), drives=spec.drives[:1, :0], screen=1, working=1, finalists=STARTS
    )


def truth(judge: Problem, gains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cost and share of the worst broken limit of each law (n, P), on the exact model."""
    judged = fresh(judge, gains, np.zeros(len(gains), int), judge.study.run.dt, judge.metrics)
    objective = judge.spec.objective
    one = [judged.part(slice(k, k + 1)) for k in range(len(gains))]
    cost = np.array([s.cost(objective) for s in one])
    excess = [[x.excess(s.limited(x)) / size(x) for x in objective.limits] for s in one]
    failed = judged.status.any(axis=1)
    broken = np.where(failed, np.inf, np.maximum(np.array(excess).max(axis=1), 0.0))
    return np.where(failed, np.inf, cost), np.nan_to_num(broken, nan=np.inf)


def by_gradients(deadzone: Deadzone) -> Ends:
    """Our search on one model; every start's best law there, scored on the exact one."""
    study, spec = problem()
    judge = Problem(study, spec)
    study = study._replace(run=study.run._replace(deadzone=deadzone))
    with TemporaryDirectory() as folder:
        session = Session(study, spec, Path(folder) / "checkpoint.json")
        session.problem.evaluate(space.starting_points(study.law, spec), np.array([0]))
        begun = time.perf_counter()
        session.search(lambda progress: None)
        seconds = time.perf_counter() - begun
    kept = [s.best for s in session.states if s.best is not None]
    gains = space.to_gains(spec.free, np.array(kept))
    return Ends(gains, *truth(judge, gains), seconds)


def by_cma(seconds: float) -> Ends:
    """CMA-ES from the first starts, each until the time is over; its best law per run."""
    study, spec = problem()
    judge = Problem(study, spec)
    points = space.starting_points(study.law, spec)
    options = {"bounds": [0.0, 1.0], "verbose": -9, "popsize": STARTS}
    truth(judge, space.to_gains(spec.free, points))  # compiles
    unit = truth(judge, space.to_gains(spec.free, points[:1]))[0][0]
    ends = []
    for k, point in enumerate(points[:CMA_RUNS]):
        begun = time.perf_counter()
        options["seed"] = spec.seed + k + 1
        search = cma.CMAEvolutionStrategy(point, 0.2, options)
        best = (np.inf, np.inf, point)
        while not search.stop() and time.perf_counter() - begun < seconds:
            asked = np.array(search.ask())
            cost, broken = truth(judge, space.to_gains(spec.free, asked))
            merit = np.nan_to_num(cost / unit + PENALTY * broken, posinf=1e6)
            search.tell(list(asked), merit.tolist())
            ranks = list(zip(broken, cost, strict=True))
            i = min(range(len(ranks)), key=ranks.__getitem__)
            best = min(best, (*ranks[i], asked[i]), key=lambda found: found[:2])
        ends.append(best[2])
    gains = space.to_gains(spec.free, np.array(ends))
    return Ends(gains, *truth(judge, gains), seconds)


def main() -> None:
    """Measure, show and write the table."""
    jaxsim.configure()
    rows = {name: by_gradients(model).row() for name, model in MODELS.items()}
    rows["cma"] = by_cma(rows["exact"]["seconds"]).row()
    shown = Table(title="True ITAE, rad s2, of laws that keep the limits on the exact model")
    for column in ("search on", "feasible", "best", "loose", "median", "wall s"):
        shown.add_column(column)
    for name, row in rows.items():
        median = "infeasible" if row["median"] is None else f"{row['median']:.5g}"
        kept = f"{row['feasible']} of {row['starts']}"
        best = (f"{row[key]:.5g}" for key in ("best", "best_loose"))
        shown.add_row(name, kept, *best, median, f"{row['seconds']:.1f}")
    Console().print(shown)
    OUT.parent.mkdir(parents=True, exist_ok=True)
    write_json(OUT, {"rows": rows, **provenance()})


if __name__ == "__main__":
    main()
