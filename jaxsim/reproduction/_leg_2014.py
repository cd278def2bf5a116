"""The leg of section 4 of the 2014 paper: its four laws, its lead, its runs."""

from __future__ import annotations

import functools

import numpy as np

from jaxsim.derivatives.butterworth import Butterworth, ButterworthDifferences
from jaxsim.drives.leg_2014 import leg_2014
from jaxsim.law import Decentral, JointLaw
from jaxsim.laws.lead import Lead
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.positive_feedback import PositiveFeedback
from jaxsim.linear import torque_loop
from jaxsim.linear.torque_loop import TorqueLaw
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.run import Run
from jaxsim.sampled import Sampled
from jaxsim.scenario import Scenario
from jaxsim.signals.step import Step

K_P, K_I = 2.0, 10.0
LEAD = (128.0, 750.0)  # rad/s
ONSET, DURATION = 0.4, 6.0
PERIOD = 1e-3
CUTOFF, ORDER = 50.0, 3
# The parts of Fig. 16: alpha_j, alpha_a, alpha_v.
ALPHAS = {
    "none": (0.0, 0.0, 0.0),
    "velocity": (0.0, 0.0, 1.0),
    "velocity_acceleration": (0.0, 1.0, 1.0),
    "full": (1.0, 1.0, 1.0),
}
CASES = {
    **{name: (name, False) for name in ALPHAS},
    **{f"{name}_lead": (name, True) for name in ALPHAS},
}


def linear(case: str, *, filtered: bool = False) -> TorqueLaw:
    """The law of a case for the linear analysis."""
    name, lead = CASES[case]
    return TorqueLaw(
        K_P,
        K_I,
        *ALPHAS[name],
        lead=torque_loop.Lead(*LEAD) if lead else None,
        derivatives=torque_loop.Butterworth(CUTOFF * paper.HZ, ORDER) if filtered else None,
    )


def law(case: str, *, filtered: bool = False) -> JointLaw | Sampled:
    """The law of a case; filtered: as in the experiment, sampled, by filter and differences."""
    name, lead = CASES[case]
    source = ButterworthDifferences(Butterworth(CUTOFF, ORDER)) if filtered else None
    pi = Lead(PITorque(K_P, K_I), *(LEAD if lead else paper.NO_LEAD))
    feedback = PositiveFeedback.design(leg_2014(), *ALPHAS[name], source=source)
    whole = Decentral((pi,)) + feedback
    return Sampled(whole, PERIOD) if filtered else whole


@functools.cache
def runs(*, filtered: bool = False, amplitude: float = paper.AMPLITUDE) -> dict[str, Run]:
    """All cases: a step of 3 Nm at 0.4 s from hanging rest, with ripple at the motor."""
    drive = paper.rippled(leg_2014(), amplitude)
    asked = Scenario(Step(paper.STEP, ONSET), duration=DURATION)
    return paper.runs(
        {case: paper.Case(drive, law(case, filtered=filtered), asked) for case in CASES}
    )


def after_step(run: Run) -> np.ndarray:
    """T_s - tau_r from the step on, (samples,), Nm."""
    return paper.torque_error(run, (paper.STEP,))[np.asarray(run.time) >= ONSET, 0]
