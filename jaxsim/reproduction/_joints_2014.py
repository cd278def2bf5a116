"""What all groups of the 2014 paper share: its joints, its laws, its scenario, its runs."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxsim._simulate import simulate
from jaxsim.batch import stack
from jaxsim.drive import Drive
from jaxsim.drives.leg_2014 import leg_2014
from jaxsim.drives.two_link_arm_2014 import two_link_arm_2014
from jaxsim.findings import Row
from jaxsim.hybrid import Deadzone
from jaxsim.law import Decentral, JointLaw
from jaxsim.laws.lead import Lead
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.positive_feedback import PositiveFeedback
from jaxsim.linear import torque_loop
from jaxsim.linear.joints import JointSystem
from jaxsim.linear.linearise import joint_system
from jaxsim.linear.torque_loop import TorqueLaw
from jaxsim.motors.dc import Ripple
from jaxsim.run import Run
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.signals.step import Step

PAPER = "Dallali, Medrano-Cerda et al. 2014"
HZ = 2.0 * math.pi
STEP = 3.0  # Nm
STEP_2 = 0.5  # Nm at joint 2: link 2 weighs 1.034 Nm at most, more would spin it up for ever
POSE = (0.0, 0.5)  # rad
K_O = 2.0
K_I = (12.5, 25.0)  # 1/s, (34)
LEAD = (128.0, 628.0)  # rad/s, section 3.3.1
NO_LEAD = (100.0, 100.0)  # gain 1 at all frequencies: one program with and without
AMPLITUDE = 0.013  # Nm, section 3.3
PHASES = (math.pi, 0.5 * math.pi)
# The fastest pole is near -2100 rad/s: RK4 at this step is good to 3e-6 of the torque step.
DT = 2.5e-4
STORE = 4  # ticks: 1 kHz, as the RMS values are taken
DURATION = 15.0
METRICS = ("torque_overshoot_pct", "torque_settle_2pct_s", "command_peak")

FULL = TorqueLaw(1.0, np.array(K_I))  # (34) with k_o = 1, all alphas 1
NONE = FULL.weighted(0.0)
NO_JERK = replace(FULL, alpha_j=0.0)
VELOCITY_ONLY = replace(FULL, alpha_j=0.0, alpha_a=0.0)
WITH_LEAD = replace(FULL, lead=torque_loop.Lead(*LEAD))
ERRATA = "errata and readings, part B"


@functools.cache
def arm(
    pose: tuple[float, float] = POSE,
    *,
    B_L: tuple[float, float] = (0.01, 0.01),
    K_L: bool = True,
    more_L: float = 1.0,
) -> JointSystem:
    """The arm of section 3.1, linearised: (2)-(5); K_L False is the paper's K_L = 0."""
    joints = _arm_at(pose)
    stiffness = joints.K_L if K_L else np.zeros((2, 2))
    return replace(joints, B_L=np.diag(B_L), K_L=stiffness, L=more_L * joints.L)


@functools.cache
def _arm_at(pose: tuple[float, float]) -> JointSystem:
    return joint_system(two_link_arm_2014(), np.array(pose))


@functools.cache
def leg() -> JointSystem:
    """The leg of section 4."""
    return joint_system(leg_2014())


def rippled(drive: Drive, amplitude: float = AMPLITUDE) -> Drive:
    """A drive with amplitude cos(2 theta_M + phase) Nm at each motor; section 3.3."""
    motor = tuple(
        replace(m, ripple=Ripple(amplitude, 2.0, phase))
        for m, phase in zip(drive.motor, PHASES, strict=False)
    )
    return replace(drive, motor=motor)


def arm_law(
    alpha: float = 1.0, lead: tuple[float, float] = NO_LEAD, model: Drive | None = None
) -> JointLaw:
    """(34) with k_o = 2, positive feedback (23) with all weights alpha, by the law's own model."""
    joints = tuple(Lead(PITorque(K_O, k_i), *lead) for k_i in K_I)
    model = two_link_arm_2014() if model is None else model
    return Decentral(joints) + PositiveFeedback.design(model, alpha, alpha, alpha)


def arm_scenario(
    torques: tuple[float, float] = (STEP, 0.0), pose: tuple[float, float] = POSE
) -> Scenario:
    """Torque steps at t = 0 from rest with no torque in the joints."""
    start = tuple(Start(theta_L=q) for q in pose)
    references = tuple(Step(T) for T in torques)
    return Scenario(references, (Constant(), Constant()), start, DURATION)


class Case(NamedTuple):
    """One run: drive, law, scenario."""

    drive: Drive
    law: Any
    scenario: Scenario


_MEMBERS = 8  # every batch is filled up to this, so that all groups share one program


def runs(
    cases: Mapping[str, Case], deadzone: Deadzone | None = None, members: int = _MEMBERS
) -> dict[str, Run]:
    """One run per case, as one batch; signals at 1 kHz, METRICS."""
    listed = list(cases.values())
    listed += listed[-1:] * (members - len(listed))
    batch = simulate(
        *(stack(parts) for parts in zip(*listed, strict=True)),
        dt=DT,
        store=STORE,
        metrics=METRICS,
        deadzone=deadzone,
        throw=False,
    )
    batch = jax.tree.map(np.asarray, batch)
    return {name: batch.member(i) for i, name in enumerate(cases)}


@functools.cache
def arm_runs() -> dict[str, Run]:
    """The runs of sections 3.2 and 3.3; several groups look at them."""
    smooth, rough = rippled(two_link_arm_2014(), 0.0), rippled(two_link_arm_2014())
    step, second = arm_scenario(), arm_scenario((0.0, STEP_2))
    return runs({
        "full": Case(smooth, arm_law(), step),
        "none": Case(smooth, arm_law(0.0), step),
        "full_joint2": Case(smooth, arm_law(), second),
        "none_joint2": Case(smooth, arm_law(0.0), second),
        "ripple": Case(rough, arm_law(), step),
        "ripple_lead": Case(rough, arm_law(lead=LEAD), step),
        "hanging": Case(smooth, arm_law(), arm_scenario(pose=(0.0, 0.0))),
        "ripple_none": Case(rough, arm_law(0.0), step),
    })  # fmt: skip


def torque_error(run: Run, torques: tuple[float, ...] = (STEP, 0.0)) -> np.ndarray:
    """T_s - tau_r at the stored samples, (samples, joints), Nm."""
    return np.asarray(run.signals["T_s"]).reshape(len(run.time), -1) - np.asarray(torques)


def rms(values: np.ndarray) -> np.ndarray:
    """Root mean square over the samples, per joint."""
    return np.sqrt(np.mean(values**2, axis=0))


def two_ways(row: Row, other: float, within: float = 1e-5) -> Row:
    """A row judged by a second method, too: relative difference to it."""
    ok = bool(abs(row.value - other) <= within * abs(other))
    told = f"the second method gives {other:.10g}"
    words = f"within {within:g} of its size of a second method"
    return row._replace(
        tolerance=words if row.tolerance is None else f"{row.tolerance}; {words}",
        ok=ok if row.ok is None else ok and row.ok,
        note=f"{told}; {row.note}" if row.note else told,
    )
