"""All metrics of all drives under many laws at once, with or without their Jacobians."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import batch, tree
from jaxsim.parameters import violations
from jaxsim.run import Run
from jaxsim.status import Status
from jaxsim.study import Study
from jaxsim.tree import cast
from tuning import space
from tuning.drive_set import DELAY, with_delay
from tuning.spec import Spec

# Runs that one compiled call makes. A search changes its number of starts and drives as it goes;
# calls of one size compile once (7 s), and a call of 64 is as fast per run as one of 256.
LANES = 64
# Runs without slopes in a call, which keeps both cores at work from here on.
ROWS = 256


class Outcome(NamedTuple):
    """What laws do on drives.

    values (points, drives, cases, metrics), a case being an axis in a scenario, scenario by
    scenario; slopes (points, drives, cases, metrics, P), with respect to unit coordinates;
    status (points, drives, scenarios): `Status` codes.
    """

    values: np.ndarray
    slopes: np.ndarray
    status: np.ndarray


class Share(Protocol):
    """Who makes the calls of an evaluation: values, slopes and status of each, in their order."""

    def __call__(
        self, problem: Problem, points: np.ndarray, drives: np.ndarray, *, slopes: bool
    ) -> list[list[np.ndarray]]: ...


class Part(NamedTuple):
    """Runs that one call makes: the law by its place among `laws`, and their places (lanes,)."""

    law: int
    rows: np.ndarray


class Problem:
    """The runs that a study is tuned on.

    drives: (count, spreads), values of the uncertain parameters; the first is the study's drive.
    scenarios: names. metrics: those of the objective. share: who makes the calls of an evaluation.
    laws: the study's, once per delay that drives have; law_of (count,): the place of each drive's.
    """

    def __init__(self, study: Study, spec: Spec, share: Share | None = None) -> None:
        self.study, self.spec = study, spec
        self.share = share or in_threads
        self.drives = spec.drives
        self.scenarios = tuple(study.scenarios)
        self.metrics = spec.objective.metrics()
        most = max(spec.count, spec.screen * spec.starts)
        self._lanes = min(LANES, most)
        self._own = [i for i, s in enumerate(spec.spreads) if s.path != DELAY]
        self.laws, self.law_of = self._delayed()

    def _delayed(self) -> tuple[tuple[Any, ...], np.ndarray]:
        """A delay decides what is compiled: it is the law that has it, and each has a program."""
        late = [i for i, s in enumerate(self.spec.spreads) if s.path == DELAY]
        if not late:
            return (self.study.law,), np.zeros(len(self.drives), int)
        dt = self.study.run.dt
        steps, places = np.unique(np.round(self.drives[:, late[0]] / dt), return_inverse=True)
        return tuple(with_delay(self.study.law, dt * n) for n in steps), places.reshape(-1)

    def drive(self, index: int) -> Any:
        """The drive of one row of `drives`."""
        return tree.replace(self.study.drive, self._uncertain(self.drives[index]))

    def law(self, index: int, gains: np.ndarray) -> Any:
        """The law of one row of `drives`, with these gains (P,)."""
        return space.with_gains(self.laws[self.law_of[index]], self.spec.free, gains)

    def _uncertain(self, values: Any) -> dict[str, Any]:
        """The parameters of the drive by path that values (..., spreads) set."""
        return {self.spec.spreads[i].path: values[..., i] for i in self._own}

    def label(self, index: int, scenario: int | None = None) -> str:
        """A drive in words, e.g. "drive 17 (half_gap=0.0085, K=270)", and one of its scenarios.

        A single scenario is not named.
        """
        where = ""
        if scenario is not None and len(self.scenarios) > 1:
            where = f" in {self.scenarios[scenario]}"
        if index == 0:
            return f"the study's drive{where}"
        values = zip(self.spec.spreads, self.drives[index], strict=True)
        return f"drive {index} ({', '.join(f'{s.name}={v:.4g}' for s, v in values)}){where}"

    def trouble(self, index: int, status: int) -> str:
        """Why a run failed: the broken rule of the drive, or the status in words."""
        broken = violations(self.drive(index)) if status == Status.INVALID.value else []
        return "; ".join(broken) or Status(status).words

    @cached_property
    def _runs(self) -> dict[tuple[int, int], Callable[..., Any]]:
        """Per scenario and law the compiled call on (lanes, P) gains and (lanes, spreads) drives.

        Scenarios of one structure (kinds of signals, duration) share it.
        """
        gains = jnp.zeros((self._lanes, len(self.spec.free)))
        drives = jnp.zeros((self._lanes, len(self.spec.spreads)))
        compiled: dict[Any, Any] = {}
        runs = {}
        for at, scenario in enumerate(self.study.scenarios.values()):
            own = cast(scenario, jnp.dtype(self.study.run.dtype))
            for place, law in enumerate(self.laws):
                kind = jax.tree.structure(own), place
                if kind not in compiled:
                    call = jax.jit(jax.vmap(partial(self._one, law), in_axes=(0, 0, None)))
                    compiled[kind] = call.lower(gains, drives, own).compile()
                runs[at, place] = partial(_call, compiled[kind], own)
        return runs

    def _one(self, law: Any, gains: Any, drive: Any, scenario: Any) -> tuple[Any, Any, Any]:
        """Values, Jacobian and status of one run.

        In forward mode: for 64 runs and 4 gains 0.29 s of CPU, against 0.97 s in reverse.
        """

        def numbers(p: Any) -> tuple[Any, Any]:
            run = self.study.measure(
                self.metrics,
                drive=tree.replace(self.study.drive, self._uncertain(drive)),
                law=space.with_gains(law, self.spec.free, p),
                scenario=scenario,
            )
            values = self._columns(run)
            return values, (values, run.status)

        slopes, (values, status) = jax.jacfwd(numbers, has_aux=True)(gains)
        return values, slopes, status

    def _columns(self, run: Run) -> Any:
        """Metrics (..., axes, metrics)."""
        axes = self.study.drive.axes
        found = [jnp.asarray(run.metrics[name]) for name in self.metrics]
        return jnp.stack([v if axes > 1 else v[..., None] for v in found], axis=-1)

    def batch(
        self, place: int, gains: np.ndarray, drives: np.ndarray, scenario: str, **options: Any
    ) -> Run:
        """Runs of one of the `laws` under gains (n, P) on drives (n,) by index, as one batch.

        options: dt, deadzone and metrics other than those of the search.
        """
        options = {"metrics": self.metrics} | options
        law = batch.spread(self.laws[place], **space.leaves(self.spec.free, gains))
        drive, uncertain = self.study.drive, self._uncertain(self.drives[drives])
        if uncertain:
            drive = batch.spread(drive, **uncertain)
        what = self.study.scenarios[scenario]
        return self.study.measure(**options, drive=drive, law=law, scenario=what)

    def evaluate(self, points: np.ndarray, drives: np.ndarray, *, slopes: bool = True) -> Outcome:
        """Laws at unit coordinates (n, P) on drives (d,) by index, each with each.

        Without slopes (their last axis is empty) it costs a twentieth.
        """
        parts = self.share(self, points, drives, slopes=slopes)
        rows = np.concatenate([part.rows for part in self._parts(points, drives, slopes)])
        first = np.unique(rows, return_index=True)[1]  # calls are filled up with the last run
        whole = [np.concatenate([p[k] for p in parts]) for k in range(3)]
        count, shape = len(self.scenarios), (len(points), len(drives))
        values, rates, status = (
            np.moveaxis(a.reshape(count, len(rows), *a.shape[1:])[:, first], 0, 1) for a in whole
        )
        values = values.reshape(*shape, -1, values.shape[-1])
        rates = rates.reshape(*values.shape, rates.shape[-1])
        if slopes:
            rates = rates * space.slope(self.spec.free, points)[:, None, None, None, :]
        return Outcome(values, rates, status.reshape(*shape, count))

    def _parts(self, points: np.ndarray, drives: np.ndarray, slopes: bool) -> list[Part]:
        """All runs of a scenario in calls of one size; the last of each law is filled up."""
        law, width = np.tile(self.law_of[drives], len(points)), self._lanes if slopes else ROWS
        parts = []
        for place in np.unique(law).tolist():
            rows = np.flatnonzero(law == place)
            most = -(-len(rows) // width) * width
            full = rows[np.minimum(np.arange(most), len(rows) - 1)]
            parts += [Part(place, own) for own in full.reshape(-1, width)]
        return parts

    def calls(self, points: np.ndarray, drives: np.ndarray, *, slopes: bool) -> int:
        """How many calls of one size an evaluation takes, scenario by scenario."""
        return len(self.scenarios) * len(self._parts(points, drives, slopes))

    def call(
        self, points: np.ndarray, drives: np.ndarray, k: int, *, slopes: bool
    ) -> list[np.ndarray]:
        """Values, slopes and status of call k."""
        parts = self._parts(points, drives, slopes)
        scenario, at = divmod(k, len(parts))
        point, drive = np.divmod(parts[at].rows, len(drives))
        gains, own = space.to_gains(self.spec.free, points)[point], drives[drive]
        if slopes:
            run = self._runs[scenario, parts[at].law]
            return [np.asarray(v) for v in run(jnp.asarray(gains), jnp.asarray(self.drives[own]))]
        found = self.batch(parts[at].law, gains, own, self.scenarios[scenario])
        values = np.asarray(self._columns(found))
        return [values, np.empty((*values.shape, 0)), np.asarray(found.status)]

    def compile(self) -> None:
        """Once, before threads ask for it."""
        _ = self._runs


def in_threads(
    problem: Problem, points: np.ndarray, drives: np.ndarray, *, slopes: bool
) -> list[list[np.ndarray]]:
    """All calls of an evaluation, over the cores.

    A call of XLA keeps one core busy: 128 runs take 1.45 s in a row and 0.98 s in threads (with 8
    other processes on the 2 cores). A batch of `ROWS` without slopes is over the cores by itself.
    """
    calls = range(problem.calls(points, drives, slopes=slopes))
    call = partial(problem.call, points, drives, slopes=slopes)
    if not slopes:
        return [call(k) for k in calls]
    problem.compile()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(call, calls))


def _call(compiled: Any, scenario: Any, gains: Any, drives: Any) -> Any:
    return compiled(gains, drives, scenario)
