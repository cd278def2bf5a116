"""All metrics of all drives under many laws at once, with their Jacobians."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.parameters import violations
from jaxsim.status import Status
from jaxsim.study import Study
from jaxsim.tree import cast
from tuning import space
from tuning.spec import Spec

# Runs that one compiled call makes. A search changes its number of starts and drives as it goes;
# calls of one size compile once (7 s), and a call of 64 is as fast per run as one of 256.
LANES = 64


class Outcome(NamedTuple):
    """What laws do on drives.

    values (points, drives, cases, metrics), a case being an axis in a scenario, scenario by
    scenario; slopes (points, drives, cases, metrics, P), with respect to unit coordinates;
    status (points, drives, scenarios): `Status` codes.
    """

    values: np.ndarray
    slopes: np.ndarray
    status: np.ndarray


# All calls of an evaluation: values, slopes and status of each, in their order.
Share = Callable[["Problem", np.ndarray, np.ndarray], list[list[np.ndarray]]]


class Problem:
    """The runs that a study is tuned on.

    drives: (count, spreads), values of the uncertain parameters; the first is the study's drive.
    scenarios: names. metrics: those of the objective. share: who makes the calls of an evaluation.
    """

    def __init__(self, study: Study, spec: Spec, share: Share | None = None) -> None:
        self.study, self.spec = study, spec
        self.share = share or in_threads
        self.drives = spec.drives
        self.scenarios = tuple(study.scenarios)
        self.metrics = spec.objective.metrics()
        most = max(spec.count, spec.screen * spec.starts)
        self._lanes = min(LANES, most)

    def drive(self, index: int) -> Any:
        """The drive of one row of `drives`."""
        values = self.drives[index]
        return tree.replace(
            self.study.drive, {s.path: v for s, v in zip(self.spec.spreads, values, strict=True)}
        )

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
    def runs(self) -> list[Callable[..., Any]]:
        """Per scenario the compiled call on (lanes, P) gains and (lanes, spreads) drives.

        Scenarios of one structure (kinds of signals, duration) share it.
        """
        gains = jnp.zeros((self._lanes, len(self.spec.free)))
        drives = jnp.zeros((self._lanes, len(self.spec.spreads)))
        compiled: dict[Any, Any] = {}
        runs = []
        for scenario in self.study.scenarios.values():
            own = cast(scenario, jnp.dtype(self.study.run.dtype))
            kind = jax.tree.structure(own)
            if kind not in compiled:
                call = jax.jit(jax.vmap(self._one, in_axes=(0, 0, None)))
                compiled[kind] = call.lower(gains, drives, own).compile()
            runs.append(partial(_call, compiled[kind], own))
        return runs

    def _one(self, gains: Any, drive: Any, scenario: Any) -> tuple[Any, Any, Any]:
        """Values, Jacobian and status of one run.

        In forward mode: for 64 runs and 4 gains 0.29 s of CPU, against 0.97 s in reverse.
        """

        def numbers(p: Any) -> tuple[Any, Any]:
            values, status = self._values(p, drive, scenario)
            return values, (values, status)

        slopes, (values, status) = jax.jacfwd(numbers, has_aux=True)(gains)
        return values, slopes, status

    def _values(self, gains: Any, drive: Any, scenario: Any) -> tuple[Any, Any]:
        """Metrics (axes, metrics) and status of one run."""
        study, spec = self.study, self.spec
        uncertain = {s.path: drive[i] for i, s in enumerate(spec.spreads)}
        run = simulate(
            tree.replace(study.drive, uncertain),
            space.with_gains(study.law, spec.free, gains),
            scenario,
            dt=study.run.dt,
            deadzone=study.run.deadzone,
            metrics=self.metrics,
            store=None,
            dtype=study.run.dtype,
            throw=False,
        )
        columns = [jnp.atleast_1d(run.metrics[name]) for name in self.metrics]
        return jnp.stack(columns, axis=-1), run.status

    def evaluate(self, points: np.ndarray, drives: np.ndarray) -> Outcome:
        """Laws at unit coordinates (n, P) on drives (d,) by index, each with each."""
        values, slopes, status = self._all(points, drives)
        shape = (len(points), len(drives))
        count, axes = values.shape[1:3]
        values = values.reshape(*shape, count * axes, *values.shape[3:])
        slopes = slopes.reshape(*values.shape, -1)
        scale = space.slope(self.spec.free, points)[:, None, None, None, :]
        return Outcome(values, slopes * scale, status.reshape(*shape, count))

    def _all(self, points: np.ndarray, drives: np.ndarray) -> list[np.ndarray]:
        """Arrays (runs, scenarios, ...) of all calls, without what filled them up."""
        parts = self.share(self, points, drives)
        whole = [np.concatenate([p[k] for p in parts]) for k in range(3)]
        shape, count = (len(self.scenarios), -1), len(points) * len(drives)
        return [np.moveaxis(a.reshape(*shape, *a.shape[1:])[:, :count], 0, 1) for a in whole]

    def calls(self, points: np.ndarray, drives: np.ndarray) -> int:
        """How many calls of one size an evaluation takes, scenario by scenario."""
        return len(self.scenarios) * -(-len(points) * len(drives) // self._lanes)

    def call(self, points: np.ndarray, drives: np.ndarray, k: int) -> list[np.ndarray]:
        """Values, slopes and status of call k; the last of a scenario is filled up."""
        scenario, part = divmod(k, self.calls(points, drives) // len(self.scenarios))
        rows = np.arange(part * self._lanes, (part + 1) * self._lanes)
        point, drive = np.divmod(np.minimum(rows, len(points) * len(drives) - 1), len(drives))
        gains = jnp.asarray(space.to_gains(self.spec.free, points)[point])
        own = jnp.asarray(self.drives[drives[drive]])
        return [np.asarray(v) for v in self.runs[scenario](gains, own)]


def in_threads(problem: Problem, points: np.ndarray, drives: np.ndarray) -> list[list[np.ndarray]]:
    """All calls of an evaluation, over the cores.

    A call of XLA keeps one core busy: 128 runs take 1.45 s in a row and 0.98 s in threads (with 8
    other processes on the 2 cores).
    """
    _ = problem.runs  # compiled once, before threads ask for them
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        calls = range(problem.calls(points, drives))
        return list(pool.map(partial(problem.call, points, drives), calls))


def _call(compiled: Any, scenario: Any, gains: Any, drives: Any) -> Any:
    return compiled(gains, drives, scenario)
