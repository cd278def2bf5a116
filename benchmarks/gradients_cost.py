"""What gradients cost: time in forward runs, and memory, by number of parameters and of steps.

The bench with the switched law, ITAE in exact mode, 64 drives that differ in half_gap; parameters
are shared by all of them. Forward mode gives each drive's own derivatives, reverse mode those of
the mean. Memory is what the compiled program sets aside for its intermediate results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import measuring
import numpy as np

import jaxsim
from jaxsim import tree

MEMBERS = 64
# In the order in which they are taken: gains first, then the drive.
LAW = ("K_P", "K_D", "tau_D", "K_B")
DRIVE = ("J_M", "D_M", "K", "D_B", "J_L", "D_L")
STEPS = (300, 1500, 3000)


def objective(steps: int) -> tuple[Callable[[Any], Any], Any]:
    """ITAE of every drive as a function of the ten parameters, and their values."""
    study = jaxsim.load("bench_switched")
    scenario = replace(study.scenario, duration=steps * study.run.dt)
    gaps = 7.8e-3 * np.linspace(0.8, 1.2, MEMBERS)
    values = [tree.get(study.law, name) for name in LAW]
    values += [tree.get(study.drive, name) for name in DRIVE]

    def itae(p: Any) -> Any:
        law = tree.replace(study.law, dict(zip(LAW, p[: len(LAW)], strict=True)))
        drive = tree.replace(study.drive, dict(zip(DRIVE, p[len(LAW) :], strict=True)))
        run = jaxsim.simulate(
            jaxsim.spread(drive, half_gap=gaps), law, scenario,
            dt=study.run.dt, metrics=("itae_rad_s2",), store=None,
        )  # fmt: skip
        return run.metrics["itae_rad_s2"]

    return itae, jnp.asarray(values, float)


def forward(itae: Callable[[Any], Any], p: Any, count: int) -> Callable[[Any], Any]:
    """Derivatives with respect to the first `count` parameters, all in one run."""

    def slopes(q: Any) -> Any:
        return jax.jacfwd(lambda first: itae(jnp.concatenate([first, q[count:]])))(q[:count])

    return slopes


def programs(steps: int) -> dict[str, Any]:
    """Compiled programs by name, with their argument."""
    itae, p = objective(steps)
    functions = {
        "forward run": itae,
        "forward mode, 1": forward(itae, p, 1),
        "forward mode, 4": forward(itae, p, 4),
        "reverse mode, 10": jax.grad(lambda q: jnp.mean(itae(q))),
    }
    return {name: (jax.jit(f).lower(p).compile(), p) for name, f in functions.items()}


def main() -> None:
    jaxsim.configure()
    rows, ratios = [], {}
    for steps in measuring.progress(STEPS, "Gradients ..."):
        compiled = programs(steps)
        calls = {
            name: lambda f=f, p=p: jax.block_until_ready(f(p)) for name, (f, p) in compiled.items()
        }
        timings = measuring.interleaved(calls)
        base = timings["forward run"].best_s
        for name, timing in timings.items():
            memory = compiled[name][0].memory_analysis().temp_size_in_bytes
            of_run = timing.best_s / base
            rows.append(
                {"steps": steps, "what": name, "ms": 1e3 * timing.best_s,
                 "of a forward run": of_run, "MB": memory / 1e6}
            )  # fmt: skip
            if name != "forward run":
                ratios[f"forward run of {name}, {steps}"] = 1.0 / of_run
    measuring.save("gradients_cost", {"rows": rows}, ratios)


if __name__ == "__main__":
    main()
