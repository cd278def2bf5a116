"""Where a closed loop is linearised: at which angles, in which contacts and settings of the law.

Works on numbers and on values traced by JAX alike.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxsim import tree
from jaxsim.drive import Drive, Scalar
from jaxsim.hybrid import Exact
from jaxsim.loop import ClosedLoop, When
from jaxsim.motors.dc import DC
from jaxsim.sampled import solve_unrolled

_NO_SLOPE = ("ripple", "friction", "supply")
ALPHAS = ("alpha_j", "alpha_a", "alpha_v")


class Setting(NamedTuple):
    """Signs of the law's surfaces, alike on all axes: a label, and the signs by surface name."""

    label: str
    signs: dict[str, float]


def smooth(loop: ClosedLoop) -> tuple[ClosedLoop, list[str]]:
    """The loop without what has no slope: ripple, friction, supply limit; and which of them."""
    dc = [m for m in loop.drive.motor if isinstance(m, DC)]
    left_out = [p for p in _NO_SLOPE if any(getattr(m, p) is not None for m in dc)]
    motors = tuple(
        eqx.tree_at(lambda m: (m.ripple, m.friction, m.supply), m, (None,) * 3,
                    is_leaf=lambda v: v is None) if isinstance(m, DC) else m
        for m in loop.drive.motor
    )  # fmt: skip
    drive = replace(loop.drive, motor=motors)
    return ClosedLoop(drive, loop.law, loop.scenario, Exact(), loop.dt), left_out


def angles(loop: ClosedLoop) -> tuple[Scalar, ...]:
    """Load angles, rad: the last reference of a position law, the start under a torque law."""
    scenario = loop.scenario
    if loop.law.reference_unit == "rad":
        end = jnp.asarray(scenario.duration)
        return tuple(r.value(*When(end, end)) for r in scenario.reference)
    return tuple(s.theta_L for s in scenario.start)


def weight(drive: Drive, theta_L: tuple[Scalar, ...]) -> Any:
    """The torques that hold a load at rest at these angles, (axes,) Nm."""
    still = (0.0,) * drive.axes

    def acceleration(torque: Any) -> Any:
        return jnp.stack(drive.load.acceleration(theta_L, still, tuple(torque)))

    free = acceleration(jnp.zeros(drive.axes))
    # Affine in the torque: the columns of M^-1.
    columns = [acceleration(unit) - free for unit in jnp.eye(drive.axes)]
    rows = [[column[i] for column in columns] for i in range(drive.axes)]
    return -jnp.stack(solve_unrolled(rows, list(free))) + 0.0


def contacts(drive: Drive) -> dict[str, tuple[int, ...]]:
    """Name -> contact per axis: all closed, all open, and each joint open alone."""
    play = [any("contact" in s.name for s in t.surfaces) for t in drive.transmission]
    if not any(play):
        return {"closed": (1,) * drive.axes}
    one = {"contact+": (1,) * drive.axes, "contact-": tuple(-1 if p else 1 for p in play)}
    opened = {
        f"gap[{i}]": tuple(0 if k == i else 1 for k in range(drive.axes))
        for i, p in enumerate(play) if p and drive.axes > 1
    }  # fmt: skip
    return one | opened | {"gap": tuple(0 if p else 1 for p in play)}


def settings(loop: ClosedLoop) -> list[Setting]:
    """All combinations of signs of the law's surfaces."""
    contact = sum(len(t.surfaces) for t in loop.drive.transmission)
    motors = sum(len(m.surfaces) for m in loop.drive.motor)
    own = loop.surface_names()[contact + motors :]
    bases = list(dict.fromkeys(n.partition("[")[0] for n in own))
    found = []
    for signs in itertools.product((1.0, -1.0), repeat=len(bases)):
        by_base = dict(zip(bases, signs, strict=True))
        label = " ".join(f"{n}{'+' if s > 0 else '-'}" for n, s in by_base.items())
        found.append(Setting(label, {n: by_base[n.partition("[")[0]] for n in own}))
    return found


def gain_paths(law: Any, names: tuple[str, ...]) -> list[str]:
    """Paths of the law's parameters with these names."""
    return [p for p in tree.paths(law) if p.rpartition(".")[2] in names]
