"""Searches and trainings spread over workers: the same to the bit as on one machine."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import identification_logs as logs
import numpy as np
import pytest
from agent_cases import PUSH

from jaxsim import load, scale
from rl import store
from rl.spec import read_spec as read_training
from rl.trainings import train_all
from tuning.identification import chunks as fit_chunks
from tuning.identification.chunks import Chunks
from tuning.identification.estimator import STAGES, Fits, fit
from tuning.identification.residuals import Problem
from tuning.problem import LANES
from tuning.problem import Problem as Drives
from tuning.spec import read_spec
from tuning.workers import OnWorkers


class Elsewhere:
    """A team in this process that is given what workers are given: pickled jobs."""

    here = False

    def __init__(self) -> None:
        self.computed: list[int] = []

    def compute(self, work: Any, job: Any, chunks: int, folder: Path, *, tell: Any = None) -> None:
        sent = pickle.dumps((work, job))

        def remote(_: Any, k: int) -> scale.Arrays:
            self.computed.append(k)
            does, given = pickle.loads(sent)
            return does(given, k)

        scale.Team().compute(remote, None, chunks, folder, tell=tell or (lambda p: None))


def _fits_problem() -> tuple[Problem, np.ndarray, np.ndarray]:
    recorded, truth = logs.random_bench_logs(4)
    starts = truth * (1.0 + 0.1 * np.random.default_rng(1).choice([-1.0, 1.0], truth.shape))
    problem = Problem(recorded, logs.unknown(recorded[0]), dt=2e-4, width=4)
    return problem, starts, np.arange(4)[:, None]


def test_fits_in_chunks_are_the_same_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, starts, who = _fits_problem()
    how: dict[str, Any] = {"who": who, "stages": STAGES[-2:], "iterations": 4}
    whole = fit(problem, starts, **how)
    monkeypatch.setattr(fit_chunks, "_RUNS", 3)
    team = Elsewhere()
    spread = Chunks(team, tmp_path)  # type: ignore[arg-type]
    chunks = spread(problem, starts, **how)
    assert team.computed == [0, 1]
    for name in Fits._fields:
        np.testing.assert_array_equal(getattr(whole, name), getattr(chunks, name))
    spread(problem, starts, **how)
    assert team.computed == [0, 1]  # found on disk
    spread(problem, starts * 1.01, **how)
    assert team.computed == [0, 1, 0, 1]  # another search


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 4])
def test_a_local_cluster_gives_the_same_bits(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Issue 7, line 5, for fits; tests/test_scale.py kills a worker."""
    pytest.importorskip("distributed")
    problem, starts, who = _fits_problem()
    how: dict[str, Any] = {"who": who, "stages": STAGES[-1:], "iterations": 3}
    whole = fit(problem, starts, **how)
    monkeypatch.setattr(fit_chunks, "_RUNS", 1)
    with scale.Team(scale.Where(workers=workers)) as team:
        chunks = Chunks(team, tmp_path)(problem, starts, **how)
    for name in Fits._fields:
        np.testing.assert_array_equal(getattr(whole, name), getattr(chunks, name))


def test_an_interrupted_search_keeps_its_finished_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, starts, who = _fits_problem()
    how: dict[str, Any] = {"who": who, "stages": STAGES[-1:], "iterations": 1}
    monkeypatch.setattr(fit_chunks, "_RUNS", 3)

    def stop(progress: Any) -> None:
        if progress.iteration == 1:
            raise KeyboardInterrupt

    spread = Chunks(Elsewhere(), tmp_path)  # type: ignore[arg-type]
    kept = spread(problem, starts, tell=stop, **how)
    assert kept.interrupted
    assert np.isfinite(kept.loss).tolist() == [True, True, True, False]
    np.testing.assert_array_equal(kept.values[3], starts[3])
    team = Elsewhere()
    whole = Chunks(team, tmp_path)(problem, starts, **how)  # type: ignore[arg-type]
    assert team.computed == [1]
    assert np.isfinite(whole.loss).all()
    with pytest.raises(KeyboardInterrupt):  # nothing to keep
        spread(problem, 1.01 * starts, tell=lambda p: stop(p._replace(iteration=1)), **how)


def test_the_calls_of_an_evaluation_are_the_same_to_the_bit(tmp_path: Path) -> None:
    study = load("bench_worst_case")
    spec = read_spec(study)
    points = np.random.default_rng(0).uniform(0.2, 0.8, (5, len(spec.free)))
    drives = np.arange(1, 15)  # 70 runs: two calls in each scenario, the second one filled up
    assert LANES < len(points) * len(drives) < 2 * LANES
    here = Drives(study, spec).evaluate(points, drives)
    team = Elsewhere()
    spread = OnWorkers(team, tmp_path)  # type: ignore[arg-type]
    there = Drives(study, spec, spread)
    for _ in range(2):
        for alone, shared in zip(here, there.evaluate(points, drives), strict=True):
            np.testing.assert_array_equal(alone, shared)
        assert team.computed == list(range(2 * len(study.scenarios)))  # the second time: on disk
    alike = (p.evaluate(points[:1], drives[:3], slopes=False) for p in (Drives(study, spec), there))
    for alone, shared in zip(*alike, strict=True):
        np.testing.assert_array_equal(alone, shared)
    assert team.computed[-len(study.scenarios) :] == list(range(len(study.scenarios)))
    assert len(list(tmp_path.iterdir())) == 1  # the last evaluation is kept, no other


def test_trainings_on_workers_are_the_same_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jaxsim.configure", lambda **_: None)  # the tests' own stays in force
    small: dict[str, Any] = {"steps": 480, "segment": 240, "envs": 8, "hidden": [8]}
    small |= {"algorithm.n_steps": 30, "algorithm.batch_size": 120, "validation": 4}
    named = [(f"seed-{s}", read_training(PUSH, "ppo", s, small)) for s in (0, 1)]
    here, there = tmp_path / "here", tmp_path / "there"
    train_all(named[:1], there, lambda name, spec, row: None)  # there already
    team, told = Elsewhere(), []
    train_all(named, there, lambda name, spec, row: told.append((name, row)), team)  # type: ignore[arg-type]
    assert team.computed == [0]
    assert [(name, row is None) for name, row in told] == [("seed-0", True), ("seed-1", False)]
    train_all(named, here, lambda name, spec, row: None)
    for name, _ in named:
        policies = [(folder / name / "policy.json").read_bytes() for folder in (here, there)]
        assert policies[0] == policies[1]
        rows = [store.read_rows(folder / name) for folder in (here, there)]
        assert [r[:-1] for r in rows[0]] == [r[:-1] for r in rows[1]]  # all but CPU time
    assert not (there / "chunks").exists()
