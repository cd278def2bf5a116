"""The bench of the 2018 paper, said twice: for the package and for the oracle."""

from __future__ import annotations

from typing import Any

import oracle

from jaxsim.drive import Drive
from jaxsim.laws.linear_damping import LinearDamping
from jaxsim.laws.pd import PD
from jaxsim.laws.prefilter import Prefilter
from jaxsim.laws.switched_damping import SwitchedDamping
from jaxsim.loads.inertia import Inertia
from jaxsim.motors.ideal import Ideal
from jaxsim.scenario import Scenario, Start
from jaxsim.signal import Signal
from jaxsim.signals.constant import Constant
from jaxsim.signals.step import Step
from jaxsim.transmissions.backlash import Backlash

PAPER = oracle.Params()
STEP, ONSET = 0.30, 0.010

# The oracle's name of each metric -> the package's.
SAME = {
    "first_contact_s": "first_contact_s",
    "first_entry_wB_rad_s": "entry_speed_rad_s",
    "first_impact_peak_Nm": "first_impact_Nm",
    "first_separation_s": "first_separation_s",
    "braking_contact_s": "braking_contact_s",
    "braking_peak_Nm": "braking_peak_Nm",
    "largest_torque_Nm": "largest_torque_Nm",
    "theta_max_rad": "theta_max_rad",
    "overshoot_rad": "overshoot_rad",
    "overshoot_pct": "overshoot_pct",
    "rise_10_90_s": "rise_10_90_s",
    "t50_s": "t50_s",
    "settle_2pct_s": "settle_2pct_s",
    "IAE_rad_s": "iae_rad_s",
    "ITAE_rad_s2": "itae_rad_s2",
    "TM_max_Nm": "command_max",
    "TM_min_Nm": "command_min",
    "impact_energy_J": "impact_loss_J",
}


def drive(p: oracle.Params = PAPER, *, no_pull: bool = False) -> Drive:
    return Drive(
        Ideal(p.J_M, p.D_M),
        Backlash(p.K, p.half_gap, p.D_B, no_pull=no_pull),
        Inertia(p.J_L, p.D_L),
    )


def damping(kind: str, p: oracle.Params = PAPER) -> Any:
    """The damping alone; 'none' is the linear law without gain: both share one program."""
    if kind == "switched":
        return SwitchedDamping(p.K_B)
    return LinearDamping(0.0 if kind == "none" else p.K_B)


def law(kind: str, p: oracle.Params = PAPER) -> Any:
    return Prefilter(PD(p.K_P, p.K_D, p.tau_D) + damping(kind, p), p.f_ref)


def scenario(
    duration: float = 0.3, *, step: float = STEP, start: Start | None = None, loads: Any = ()
) -> Scenario:
    """The step of section III; `loads`: pairs (time s, torque Nm) that add up, as the oracle's."""
    load_torque: Signal = Constant()
    for at, torque in loads:
        load_torque = load_torque + Step(torque, at)
    return Scenario(Step(step, ONSET), load_torque, start or Start(), duration=duration)
