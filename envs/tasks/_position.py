"""The position step of the 2018 bench, as all its tasks share it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from envs.task import Episode, Range, Task, drawn, either_way
from jaxsim.law import Law
from jaxsim.observation import Channel
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.step import Step
from jaxsim.study import load
from jaxsim.tree import replace

Scalar = Any


class Conditions(NamedTuple):
    """What differs between episodes; each is drawn uniformly, from the key of the episode alone.

    | condition | unit | range | |
    |---|---|---|---|
    | half_gap | 1 | 0.6 to 1.3 | of the bench's, times the wear |
    | K | 1 | 0.8 to 1.2 | of the bench's |
    | J_L | 1 | 0.7 to 1.3 | of the bench's |
    | reference | rad | 0.15 to 0.45 | size of the step |
    | way | 1 | -1 to 1 | its sign is that of the step |
    | start | 1 | -0.9 to 0.9 | deflection over the half gap |
    | load_1, load_2 | Nm | -0.2 to 0.2 | steps of d_L, which add up |
    | at_1, at_2 | s | 0.05 to 0.15, 0.15 to 0.25 | when |
    | angle_noise | rad | 0 to 1e-5 | standard deviation of an angle's readings |
    | torque_noise | Nm | 0 to 0.02 | standard deviation of the readings of T_s |
    | late | 1 | -1 to 1 | > 0: readings come one control period late |
    """

    half_gap: Range = Range(0.6, 1.3)
    K: Range = Range(0.8, 1.2)
    J_L: Range = Range(0.7, 1.3)
    reference: Range = Range(0.15, 0.45)
    way: Range = Range(-1.0, 1.0)
    start: Range = Range(-0.9, 0.9)
    load_1: Range = Range(-0.2, 0.2)
    at_1: Range = Range(0.05, 0.15)
    load_2: Range = Range(-0.2, 0.2)
    at_2: Range = Range(0.15, 0.25)
    angle_noise: Range = Range(0.0, 1e-5)
    torque_noise: Range = Range(0.0, 0.02)
    late: Range = Range(-1.0, 1.0)


# The study bench_switched: every drive is the paper's, the load is left alone.
NOMINAL = Conditions(
    *(Range(v, v) for v in (1.0, 1.0, 1.0, 0.3, 1.0, 0.0, 0.0, 0.1, 0.0, 0.2, 0.0, 0.0, -1.0))
)

# Growth of the half gap per episode, and at most: over 2000 episodes by a fifth.
_WEAR, _WORN = 1e-4, 0.2
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

    Episodes differ as `Conditions` says. The gap wears: it is wider by 1e-4 of itself with every
    episode that the drive has behind it since its seed, by a fifth at most.

    nominal: the paper's drive and step, and exact readings but for the encoders, in every episode.
    """

    nominal: bool = eqx.field(static=True, default=False)

    period: ClassVar[float] = 1e-3
    duration: ClassVar[float] = 0.3
    # Of the switched law (K_B = -0.8) in the nominal case; a test computes them again.
    terms: ClassVar[Mapping[str, float]] = {
        "iae_rad_s": 7.93612e-3,
        "itae_rad_s2": 1.740667e-4,
        "driving_torque_max_Nm": 1.394422,
        "braking_torque_max_Nm": 1.185203,
        "overshoot_rad": 6.97057e-3,
    }
    # Bang-bang in every period would cost 1.2 over an episode, as much as the rest.
    action_rate: ClassVar[float] = 1e-3
    failure: ClassVar[float] = 1000.0  # full torque all the time costs about 260

    def draw(self, key: Any, age: Scalar) -> Episode:
        now: Any = drawn(NOMINAL if self.nominal else Conditions(), key)
        bench = load("bench_switched").drive
        transmission, inertia = bench.transmission[0], bench.load
        wear = 0.0 if self.nominal else jnp.minimum(_WEAR * age, _WORN)
        factors = {"half_gap": now.half_gap * (1.0 + wear), "K": now.K, "J_L": now.J_L}
        owners = {"half_gap": transmission, "K": transmission, "J_L": inertia}
        values = {n: f * float(getattr(owners[n], n)) for n, f in factors.items()}
        drive = replace(bench, values)
        start = Start(theta_B=now.start * values["half_gap"])
        reference = Step(either_way(now.way, now.reference), _ONSET)
        load_torque = Step(now.load_1, now.at_1) + Step(now.load_2, now.at_2)
        scenario = Scenario(reference, load_torque, start, duration=self.duration)
        return Episode(drive, scenario, now.angle_noise, now.torque_noise, now.late)


def switched_law() -> Law:
    """Prefilter, PD and switched damping with the gains of the 2018 paper: the study's law."""
    return load("bench_switched").law.laws[0]
