"""How cost and memory grow: with drives, steps, axes, storage and gradients.

The bench with the switched law, exact mode, dt = 2e-4 s, three metrics. Memory is what the
compiled program asks for on all cores besides its inputs and outputs, the same in every run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import measuring
import numpy as np

import jaxsim
from jaxsim import tree
from jaxsim.drive import Drive
from jaxsim.law import Decentral
from jaxsim.loads.general import Mechanism
from jaxsim.loads.inertia import Inertia
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.signals.step import Step

DT = 2e-4
METRICS = ("itae_rad_s2", "largest_torque_Nm", "overshoot_rad")
DRIVES = (256, 1024, 4096, 16_384, 65_536)
STEPS = (300, 3000, 30_000)
AXES = (1, 2, 4)
STORES = (None, 100, 30, 10, 1)
GAINS = ("K_B", "K_P", "K_D", "tau_D")
MANY, FEW = 1024, 64


def case(*, drives: int = MANY, steps: int = 1500, axes: int = 1) -> tuple[Any, Any, Any]:
    """A batch of the bench's drive (or of so many of them side by side), law and scenario."""
    study = jaxsim.load("bench_switched")
    one, load = study.drive, cast(Inertia, study.drive.load)
    law = cast(Decentral, study.law)
    if axes > 1:
        rows = tuple(tuple(load.J_L if i == j else 0.0 for j in range(axes)) for i in range(axes))
        none = (0.0,) * axes
        many = Mechanism(
            M=lambda q, p: rows, C=lambda q, w, p: none, G=lambda q, p: none,
            D_L=np.full(axes, load.D_L),
        )  # fmt: skip
        one, law = (
            Drive(one.motor * axes, one.transmission * axes, many),
            Decentral(law.laws * axes),
        )
    gaps = 7.8e-3 * np.linspace(0.8, 1.2, drives)
    names = [f"transmission[{i}].half_gap" for i in range(axes)] if axes > 1 else ["half_gap"]
    batch = jaxsim.spread(one, **dict.fromkeys(names, gaps))
    parts = (Step(0.30, 0.010),) * axes, (Constant(),) * axes, (Start(),) * axes
    return batch, law, Scenario(*parts, duration=steps * DT)


def run(what: tuple[Any, Any, Any], store: int | None = None) -> Any:
    """The metrics of a case, and its signals where they are stored."""
    done = jaxsim.simulate(*what, dt=DT, metrics=METRICS, store=store, throw=False)
    return done.metrics if store is None else (done.metrics, done.signals)


def timed(cases: dict[Any, Callable[[], Any]]) -> dict[Any, float]:
    """Seconds of each call, the least of interleaved repeats."""
    calls = {k: (lambda call=call: jax.block_until_ready(call())) for k, call in cases.items()}
    return {k: t.best_s for k, t in measuring.interleaved(calls, repeats=3).items()}


def times() -> list[dict[str, Any]]:
    """Rows of cost: what grows, how far, seconds, and seconds per unit of it over the first."""
    found = []
    for name, sizes in (("drives", DRIVES), ("steps", STEPS), ("axes", AXES)):
        cases = {n: case(**{name: n}) for n in sizes}
        spent = timed({n: (lambda what=what: run(what)) for n, what in cases.items()})
        first = spent[sizes[0]] / sizes[0]
        found += [
            {"grows": name, "to": n, "s": s, "per unit of the first": s / n / first}
            for n, s in spent.items()
        ]
    return found


def stores() -> list[dict[str, Any]]:
    """Rows of storage: every so many steps, seconds, against none."""
    what = case()
    spent = timed({n: (lambda n=n: run(what, n)) for n in STORES})
    return [
        {"grows": "stored every (steps)", "to": n or 0, "s": s, "of none": s / spent[None]}
        for n, s in spent.items()
    ]


def memory() -> list[dict[str, Any]]:
    """Rows of memory of FEW drives: metrics, four gains forward, four gains in reverse."""
    found = []
    for steps in STEPS:
        drives, law, scenario = case(drives=FEW, steps=steps)

        def total(gains: Any, drives: Any = drives, law: Any = law, s: Any = scenario) -> Any:
            own = tree.replace(law, dict(zip(GAINS, gains, strict=True)))
            return jnp.sum(run((drives, own, s))["itae_rad_s2"])

        gains = jnp.array([float(tree.get(law, name)) for name in GAINS])
        ways = {"metrics": total, "forward": jax.jacfwd(total), "reverse": jax.grad(total)}
        made = {way: jax.jit(f).lower(gains).compile() for way, f in ways.items()}
        sizes = {f"{way}, MB": measuring.megabytes(program, FEW) for way, program in made.items()}
        found.append({"steps": steps} | sizes)
    return found


def main() -> None:
    jaxsim.configure()
    parts = {}
    for part in measuring.progress((times, stores, memory), "Growth ..."):
        parts[part.__name__] = part()
    ratios = {
        f"linear in {name}": 1.0
        / max(r["per unit of the first"] for r in parts["times"] if r["grows"] == name)
        for name in ("drives", "steps", "axes")
    }
    first, *_, last = parts["memory"]
    ratios |= {
        f"memory of {way}, 300 over 30000 steps": first[f"{way}, MB"] / last[f"{way}, MB"]
        for way in ("metrics", "forward", "reverse")
    }
    measuring.save("growth", parts, ratios)


if __name__ == "__main__":
    main()
