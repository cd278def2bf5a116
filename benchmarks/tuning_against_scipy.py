"""One tuning problem twice, in one run: gearlash, and SciPy on a numba simulation with differences.

The problem is the shipped study `bench_switched`: least mean ITAE over 64 drives with largest |T_s|
<= 1.4 Nm and overshoot <= 3 % on every one, four gains, the same eight starts, bounds, scales and
drives, and the same two stages (all starts on 8 drives, the best two and the study's law on all).
SciPy gets what a careful user would give it: compiled runs over all cores, laws of a difference in
one call, limits as one constraint per drive, results of a point kept. Compile times are apart.

Every law that either has looked at is scored afterwards by runs of the exact model; only those
that really keep the limits count. So a coarse simulation may be as fast as it likes: what counts
is when a law was found whose true cost is as low.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import jax
import numpy as np
from numba_tuning import measure_all
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize

import jaxsim
from jaxsim.provenance import provenance, write_json
from jaxsim.study import load
from tuning import space
from tuning.problem import Problem
from tuning.scoring import score
from tuning.session import Session
from tuning.spec import Spec, read_spec

OUT = Path("results/bench/tuning_against_scipy.json")
COLUMNS = {"K": 2, "J_L": 4, "half_gap": 6}  # of a plant in `numba_loop`
PLANT = (8.78e-4, 9.30e-2, 3.00e2, 1.00e-1, 8.78e-4, 3.60e-2, 7.80e-3)
# Steps of the hand-written simulation, s, and of the differences, on the unit cube of the bounds.
# Measured against the exact model: ITAE within 3e-3 at 2e-4 s, 2e-4 at 5e-5 s; torque 3e-4.
VARIANTS = ((2e-4, 1e-2), (2e-4, 1e-3), (5e-5, 1e-3))
RESERVE = 5e-4  # of each limit, for what the simulation is off by
# A target is the lowest true cost that anyone has found, plus this share; the last one is that
# which both have reached.
SHARES = (0.1, 0.03, 0.001)


class Seen(NamedTuple):
    """A law that was looked at (unit cube), and when, s after the start."""

    z: np.ndarray
    when: float


class Simulation:
    """The numba simulation on some drives as SciPy wants it; `seen` is shared by all."""

    def __init__(
        self,
        spec: Spec,
        plants: np.ndarray,
        dt: float,
        difference: float,
        note: Callable[[np.ndarray], None],
    ) -> None:
        self.spec, self.plants, self.note = spec, plants, note
        self.dt, self.difference = dt, difference
        limits = {x.metric: x.bound for x in spec.objective.limits}
        self.most = np.array([limits["largest_torque_Nm"], limits["overshoot_pct"]])
        self.unit, self.at, self.known = 1.0, np.zeros(0), np.zeros(0)
        self.slopes_at, self.slopes = np.zeros(0), np.zeros(0)

    def terms(self, points: np.ndarray) -> np.ndarray:
        """Mean ITAE, then the slack of both limits drive by drive (n, 1 + 2 d)."""
        found = measure_all(space.to_gains(self.spec.free, points), self.plants, self.dt)
        slack = 1.0 - RESERVE - found[..., 1:] / self.most
        cost = found[..., 0].mean(axis=1) / self.unit
        return np.concatenate([cost[:, None], slack.reshape(len(points), -1)], axis=1)

    def values(self, z: np.ndarray) -> np.ndarray:
        if not np.array_equal(z, self.at):
            self.at, self.known = z.copy(), self.terms(z[None])[0]
            self.note(z)
        return self.known

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Forward differences, backward ones at an upper bound."""
        if not np.array_equal(z, self.slopes_at):
            h = np.where(z + self.difference <= 1.0, self.difference, -self.difference)
            moved = self.terms(z + np.diag(h))
            self.slopes_at, self.slopes = z.copy(), ((moved - self.values(z)) / h[:, None]).T
        return self.slopes

    def minimise(self, start: np.ndarray, most: int) -> Any:
        self.unit = 1.0
        self.unit = float(self.terms(start[None])[0, 0])
        self.at = self.slopes_at = np.zeros(0)
        kept = {
            "type": "ineq",
            "fun": lambda z: self.values(z)[1:],
            "jac": lambda z: self.jacobian(z)[1:],
        }
        return minimize(
            lambda z: self.values(z)[0],
            start,
            jac=lambda z: self.jacobian(z)[0],
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(start),
            constraints=kept,
            options={"maxiter": most},
        )


def plants_of(problem: Problem, rows: Any) -> np.ndarray:
    plants = np.tile(PLANT, (len(problem.drives), 1))
    for k, s in enumerate(problem.spec.spreads):
        plants[:, COLUMNS[s.name]] = problem.drives[:, k]
    return plants[rows]


def with_scipy(problem: Problem, dt: float, difference: float) -> tuple[list[Seen], float]:
    """All laws looked at, and the seconds of the whole search."""
    spec, seen = problem.spec, []
    begun = time.perf_counter()

    def note(z: np.ndarray) -> None:
        seen.append(Seen(z.copy(), time.perf_counter() - begun))

    few = plants_of(problem, space.spanning(problem.drives, spec.screen))
    starts = space.starting_points(problem.study.law, spec)
    screen = Simulation(spec, few, dt, difference, note)
    ends = [screen.minimise(z, -(-spec.iterations // 2)).x for z in starts]
    screen.unit = 1.0
    terms = screen.terms(np.clip(ends, 0.0, 1.0))
    rank = np.lexsort((terms[:, 0], np.maximum(-terms[:, 1:], 0.0).max(axis=1)))
    full = Simulation(spec, plants_of(problem, slice(None)), dt, difference, note)
    for z in (*(ends[k] for k in rank[: spec.finalists]), starts[0]):
        full.minimise(np.clip(z, 0.0, 1.0), spec.iterations)
    return seen, time.perf_counter() - begun


def with_gearlash(problem: Problem) -> tuple[list[Seen], float]:
    """The same for the search of `gearlash tune`, compiled before."""
    seen: list[Seen] = []
    with TemporaryDirectory() as folder:
        session = Session(problem.study, problem.spec, Path(folder) / "checkpoint.json")
        session.problem = problem
        begun = time.perf_counter()

        def note(_: Any) -> None:
            best = session.best().best
            if best is not None:
                seen.append(Seen(best, time.perf_counter() - begun))

        session.search(note)
        return seen, time.perf_counter() - begun


def true_costs(problem: Problem, seen: list[Seen]) -> np.ndarray:
    """Of every law on all drives by the exact model; inf where a limit is exceeded."""
    gains = [space.to_gains(problem.spec.free, s.z) for s in seen]
    drives, objective = np.arange(problem.spec.count), problem.spec.objective
    costs = []
    for part in (gains[k : k + 256] for k in range(0, len(gains), 256)):
        padded = [*part, *part[-1:] * (256 - len(part))]  # one shape, one compilation
        for s in score(problem, padded, drives, problem.study.run.dt, problem.metrics)[: len(part)]:
            kept = all(x.excess(s.limited(x)) <= 0.0 for x in objective.limits)
            costs.append(s.cost(objective) if kept and not s.status.any() else np.inf)
    return np.array(costs)


def reached(seen: list[Seen], costs: np.ndarray, target: float) -> float:
    """When a law with a true cost of at most the target was first looked at, s."""
    return next((s.when for s, c in zip(seen, costs, strict=True) if c <= target), np.inf)


def compiling(call: Callable[[], Any]) -> float:
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def main() -> None:
    jaxsim.configure()
    jax.config.update("jax_enable_compilation_cache", False)  # the first call ever, for both
    study = load("bench_switched")
    spec = read_spec(study)
    problem = Problem(study, spec)
    starts = space.starting_points(study.law, spec)
    ours_first = compiling(lambda: problem.evaluate(starts, np.arange(1)))
    gains, plants = space.to_gains(spec.free, starts), plants_of(problem, slice(1))
    numba_first = compiling(lambda: measure_all(gains, plants, 1e-3))
    ours, ours_total = with_gearlash(problem)
    runs = [(*variant, *with_scipy(problem, *variant)) for variant in VARIANTS]
    own_costs = true_costs(problem, ours)
    their_costs = [true_costs(problem, seen) for *_, seen, _ in runs]
    lowest = min(float(c.min()) for c in (own_costs, *their_costs))
    rows = []
    for (dt, difference, seen, total), costs in zip(runs, their_costs, strict=True):
        both = max(float(costs.min()), float(own_costs.min()))
        targets = [(1.0 + share) * lowest for share in SHARES] + [(1.0 + SHARES[-1]) * both]
        rows.append(
            {
                "dt": dt,
                "difference": difference,
                "laws": len(seen),
                "best_true_cost": float(costs.min()),
                "seconds_in_all": total,
                "targets": targets,
                "seconds": [reached(seen, costs, t) for t in targets],
                "gearlash_seconds": [reached(ours, own_costs, t) for t in targets],
            }
        )
    content = {
        "gearlash": {"best_true_cost": float(own_costs.min()), "seconds_in_all": ours_total},
        "first_call": {"gearlash": ours_first, "numba": numba_first},
        "scipy": rows,
        "shares": SHARES,
        "reserve": RESERVE,
    }
    write_json(OUT, content | provenance(seed=spec.seed))
    Console().print(table(content))


def _told(theirs: float, own: float) -> str:
    """Seconds of SciPy and of gearlash, and their ratio."""
    if not np.isfinite(theirs):
        return f"never : {own:.2f} s"
    return f"{theirs:.2f} : {own:.2f} s = {theirs / own:.1f}"


def table(content: dict[str, Any]) -> Table:
    own = content["gearlash"]
    first = content["first_call"]
    title = (
        f"gearlash: best true cost {own['best_true_cost']:.5g}, in all "
        f"{own['seconds_in_all']:.2f} s; first call {first['gearlash']:.1f} s, numba "
        f"{first['numba']:.1f} s"
    )
    shown = Table(title=title, title_justify="left")
    columns = ("dt", "difference", "laws", "best true cost", "in all")
    for name in (*columns, *(f"+{100 * s:g} %" for s in SHARES), "reached by both"):
        shown.add_column(name, justify="right")
    for row in content["scipy"]:
        pairs = zip(row["seconds"], row["gearlash_seconds"], strict=True)
        shown.add_row(
            f"{row['dt']:g}",
            f"{row['difference']:g}",
            str(row["laws"]),
            f"{row['best_true_cost']:.4g}",
            f"{row['seconds_in_all']:.1f} s",
            *(_told(theirs, own) for theirs, own in pairs),
        )
    return shown


if __name__ == "__main__":
    main()
