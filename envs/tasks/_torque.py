"""Torque steps of the 2014 leg, as all its tasks share them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax

from envs.task import Range, Task
from jaxsim.drive import Drive
from jaxsim.motors.dc import Supply
from jaxsim.observation import Channel
from jaxsim.scenario import Scenario
from jaxsim.signals.step import Step
from jaxsim.study import load
from jaxsim.tree import replace

Scalar = Any

VOLTAGE = 48.0


class Conditions(NamedTuple):
    """What differs between episodes. Factors are of the leg's values.

    reference: size of the torque step, Nm; load_torque: size of a step of d_L, Nm, at load_at, s.
    """

    K: Range = Range(0.8, 1.2)
    J_L: Range = Range(0.7, 1.3)
    K_L: Range = Range(0.8, 1.2)
    reference: Range = Range(1.0, 4.0)
    load_torque: Range = Range(-0.5, 0.5)
    load_at: Range = Range(0.1, 0.25)


# The study leg_torque.
NOMINAL = Conditions(
    Range(1.0, 1.0), Range(1.0, 1.0), Range(1.0, 1.0), Range(3.0, 3.0), Range(0.0, 0.0),
    Range(0.15, 0.15),
)  # fmt: skip

_ONSET = 0.010  # of the reference, s; the study's

SENSED = (
    Channel("reference", "Nm", 5.0),
    Channel("error", "Nm", 50.0),
    Channel("theta_L", "rad", 4.0),
    Channel("omega_L", "rad/s", 20.0),
    Channel("omega_M", "rad/s", 2000.0),
    Channel("current", "A", 100.0),
    Channel("previous action", "1", 1.0),
    Channel("remaining", "1", 1.0, 0.0),
    Channel("rms error", "Nm", 50.0, 0.0),
    Channel("overshoot", "%", 1000.0, 0.0),
)


class Torque(Task):
    """A step of the joint torque of the leg; subclasses say what the action does.

    nominal: the paper's leg and 3 Nm in every episode instead of drawn ones.
    """

    nominal: bool = eqx.field(static=True, default=False)

    period: ClassVar[float] = 1e-3
    duration: ClassVar[float] = 0.3
    # Of PI + positive feedback + lead in the nominal case; a test computes them again.
    terms: ClassVar[Mapping[str, float]] = {
        "torque_error_rms_Nm": 0.297762,
        "torque_overshoot_pct": 8.73559,
    }
    action_rate: ClassVar[float] = 1e-3
    failure: ClassVar[float] = 1e4  # swinging at full voltage costs about 2200

    def draw(self, key: Any) -> tuple[Drive, Scenario]:
        conditions = NOMINAL if self.nominal else Conditions()
        keys = jax.random.split(key, len(conditions))
        drawn: Any = Conditions(*(r.draw(k) for r, k in zip(conditions, keys, strict=True)))
        leg: Any = load("leg_torque").drive
        values = {
            "K": drawn.K * float(leg.transmission[0].K),
            "J_L": drawn.J_L * float(leg.load.J_L),
            "K_L": drawn.K_L * float(leg.load.K_L),
        }
        drive = eqx.tree_at(
            lambda d: d.motor[0].supply, replace(leg, values), Supply(VOLTAGE),
            is_leaf=lambda v: v is None,
        )  # fmt: skip
        reference = Step(drawn.reference, _ONSET)
        load_torque = Step(drawn.load_torque, drawn.load_at)
        return drive, Scenario(reference, load_torque, duration=self.duration)
