"""Torque steps of the 2014 leg, as all its tasks share them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from envs.task import Episode, Range, Task, drawn, either_way
from jaxsim.motors.dc import Supply
from jaxsim.observation import Channel
from jaxsim.scenario import Scenario
from jaxsim.signals.step import Step
from jaxsim.study import load
from jaxsim.tree import replace

Scalar = Any

VOLTAGE = 48.0


class Conditions(NamedTuple):
    """What differs between episodes; each is drawn uniformly, from the key of the episode alone.

    | condition | unit | range | |
    |---|---|---|---|
    | K | 1 | 0.8 to 1.2 | of the leg's |
    | J_L | 1 | 0.7 to 1.3 | of the leg's |
    | K_L | 1 | 0.8 to 1.2 | of the leg's |
    | reference | Nm | 1 to 4 | size of the torque step |
    | way | 1 | -1 to 1 | its sign is that of the step |
    | load_1, load_2 | Nm | -0.5 to 0.5 | steps of d_L, which add up |
    | at_1, at_2 | s | 0.05 to 0.15, 0.15 to 0.25 | when |
    | angle_noise | rad | 0 to 1e-5 | standard deviation of an angle's readings |
    | torque_noise | Nm | 0 to 0.02 | standard deviation of the readings of T_s |
    | late | 1 | -1 to 1 | > 0: readings come one control period late |
    """

    K: Range = Range(0.8, 1.2)
    J_L: Range = Range(0.7, 1.3)
    K_L: Range = Range(0.8, 1.2)
    reference: Range = Range(1.0, 4.0)
    way: Range = Range(-1.0, 1.0)
    load_1: Range = Range(-0.5, 0.5)
    at_1: Range = Range(0.05, 0.15)
    load_2: Range = Range(-0.5, 0.5)
    at_2: Range = Range(0.15, 0.25)
    angle_noise: Range = Range(0.0, 1e-5)
    torque_noise: Range = Range(0.0, 0.02)
    late: Range = Range(-1.0, 1.0)


# The study leg_torque.
NOMINAL = Conditions(
    *(Range(v, v) for v in (1.0, 1.0, 1.0, 3.0, 1.0, 0.0, 0.1, 0.0, 0.2, 0.0, 0.0, -1.0))
)

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

    Episodes differ as `Conditions` says. The leg has no gap that could wear.

    nominal: the paper's leg and 3 Nm, and exact readings but for the encoders, in every episode.
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

    def draw(self, key: Any, age: Scalar) -> Episode:
        now: Any = drawn(NOMINAL if self.nominal else Conditions(), key)
        leg: Any = load("leg_torque").drive
        values = {
            "K": now.K * float(leg.transmission[0].K),
            "J_L": now.J_L * float(leg.load.J_L),
            "K_L": now.K_L * float(leg.load.K_L),
        }
        drive = eqx.tree_at(
            lambda d: d.motor[0].supply, replace(leg, values), Supply(VOLTAGE),
            is_leaf=lambda v: v is None,
        )  # fmt: skip
        reference = Step(either_way(now.way, now.reference), _ONSET)
        load_torque = Step(now.load_1, now.at_1) + Step(now.load_2, now.at_2)
        scenario = Scenario(reference, load_torque, duration=self.duration)
        return Episode(drive, scenario, now.angle_noise, now.torque_noise, now.late)
