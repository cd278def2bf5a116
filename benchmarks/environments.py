"""Environment steps per second behind Gymnasium's doors, with and without a pool of threads.

`BacklashPosition` in float32, 10 integration steps per control period, random actions, episodes
that end and begin anew included. NPROC=1 leaves XLA one thread, as beside torch; it is read when
JAX starts, so each setting is measured in a process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import measuring
import numpy as np

SIZES = (1, 64, 1024, 4096)
SUBSTEPS = 10
POOLS = {"one per core": None, "one": "1"}


def stepper(size: int, plain: bool) -> Callable[[], Any]:
    """A call that makes one step of all environments."""
    from envs.single import SingleEnv
    from envs.vector import BatchedEnv

    options = {"plain": plain, "dt": 1e-3 / SUBSTEPS}
    env = SingleEnv("backlash_position", **options) if size == 1 else None
    batch = None if env else BatchedEnv("backlash_position", size, **options)
    (env or batch).reset(seed=0)
    shape = (97, 1) if env else (97, size, 1)
    actions = iter_for_ever(np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32))

    def one() -> None:
        if env.step(next(actions))[3]:
            env.reset()

    return one if env else lambda: batch.step(next(actions))


def iter_for_ever(rows: np.ndarray) -> Any:
    while True:
        yield from rows


def measured() -> list[dict[str, Any]]:
    """One row per size and mode, in this process."""
    import jaxsim

    jaxsim.configure()
    rows = []
    for size in SIZES:
        calls = {mode: stepper(size, mode == "plain") for mode in ("plain", "exact")}
        for mode, timing in measuring.interleaved(calls).items():
            rate = size / timing.best_s
            rows.append({"environments": size, "mode": mode, "steps_per_s": rate})
    return rows


def in_own_process(threads: str | None) -> list[dict[str, Any]]:
    environ = {k: v for k, v in os.environ.items() if k != "NPROC"}
    environ |= {"NPROC": threads} if threads else {}
    command = [sys.executable, __file__, "--child"]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    rows = []
    for pool, threads in measuring.progress(POOLS.items(), "Measuring ..."):
        rows += [{"threads": pool, **row} for row in in_own_process(threads)]
    rate = {tuple(list(row.values())[:3]): row["steps_per_s"] for row in rows}
    usual = "one per core"
    single, plain, exact = (
        rate[usual, size, mode] for size, mode in ((1, "plain"), (1024, "plain"), (1024, "exact"))
    )
    ratios = {
        "1024 over one, plain": plain / single,
        "exact over plain, 1024": exact / plain,
        "one thread over one per core, one environment": rate["one", 1, "plain"] / single,
    }
    measuring.save("environments", {"rows": rows}, ratios)


if __name__ == "__main__":
    if sys.argv[1:] == ["--child"]:
        print(json.dumps(measured()))
    else:
        main()
