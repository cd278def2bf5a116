"""The position step of the 2018 bench, as all its tasks share it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax

from envs.task import Range, Task
from jaxsim.drive import Drive
from jaxsim.law import Law
from jaxsim.observation import Channel
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.step import Step
from jaxsim.study import load
from jaxsim.tree import replace

Scalar = Any


class Conditions(NamedTuple):
    """What differs between episodes. Factors are of the bench's values.

    reference: size of the step, rad; start: deflection over the half gap; load_torque: size of a
    step of d_L, Nm, at load_at, s.
    """

    half_gap: Range = Range(0.6, 1.3)
    K: Range = Range(0.8, 1.2)
    J_L: Range = Range(0.7, 1.3)
    reference: Range = Range(0.15, 0.45)
    start: Range = Range(-0.9, 0.9)
    load_torque: Range = Range(-0.2, 0.2)
    load_at: Range = Range(0.1, 0.25)


# The study bench_switched: every drive is the paper's, the load is left alone.
NOMINAL = Conditions(
    Range(1.0, 1.0), Range(1.0, 1.0), Range(1.0, 1.0), Range(0.3, 0.3), Range(0.0, 0.0),
    Range(0.0, 0.0), Range(0.15, 0.15),
)  # fmt: skip

_ONSET = 0.010  # of the reference, s; the study's

SENSED = (
    Channel("reference", "rad", 1.0),
    Channel("error", "rad", 10.0),
    Channel("theta_B", "rad", 0.05),
    Channel("omega_L", "rad/s", 40.0),
    Channel("omega_M", "rad/s", 40.0),
    Channel("omega_B", "rad/s", 40.0),
    Channel("previous action", "1", 1.0),
    Channel("remaining", "1", 1.0, 0.0),
    Channel("T_s max", "Nm", 20.0, 0.0),
    Channel("-T_s max", "Nm", 20.0, 0.0),
    Channel("overshoot", "rad", 10.0, 0.0),
)
LAW_STATE = (
    Channel("filtered reference", "rad", 1.0, state=0),
    Channel("filtered error", "rad", 10.0, state=1),
)


class Position(Task):
    """A step of the load angle with backlash; subclasses say what the action does.

    nominal: the paper's drive and step in every episode instead of drawn ones.
    """

    nominal: bool = eqx.field(static=True, default=False)

    period: ClassVar[float] = 1e-3
    duration: ClassVar[float] = 0.3
    # Of the switched law (K_B = -0.8) in the nominal case; a test computes them again.
    terms: ClassVar[Mapping[str, float]] = {
        "iae_rad_s": 7.93612e-3,
        "itae_rad_s2": 1.740667e-4,
        "T_s_max_Nm": 1.394422,
        "T_s_min_Nm": -1.185203,
        "overshoot_rad": 6.97057e-3,
    }
    # Bang-bang in every period would cost 1.2 over an episode, as much as the rest.
    action_rate: ClassVar[float] = 1e-3
    failure: ClassVar[float] = 1000.0  # full torque all the time costs about 260

    def draw(self, key: Any) -> tuple[Drive, Scenario]:
        conditions = NOMINAL if self.nominal else Conditions()
        keys = jax.random.split(key, len(conditions))
        drawn: Any = Conditions(*(r.draw(k) for r, k in zip(conditions, keys, strict=True)))
        bench = load("bench_switched").drive
        transmission, inertia = bench.transmission[0], bench.load
        factors = {"half_gap": drawn.half_gap, "K": drawn.K, "J_L": drawn.J_L}
        owners = {"half_gap": transmission, "K": transmission, "J_L": inertia}
        values = {n: f * float(getattr(owners[n], n)) for n, f in factors.items()}
        drive = replace(bench, values)
        start = Start(theta_B=drawn.start * values["half_gap"])
        reference = Step(drawn.reference, _ONSET)
        load_torque = Step(drawn.load_torque, drawn.load_at)
        return drive, Scenario(reference, load_torque, start, duration=self.duration)


def switched_law() -> Law:
    """Prefilter, PD and switched damping with the gains of the 2018 paper: the study's law."""
    return load("bench_switched").law.laws[0]
