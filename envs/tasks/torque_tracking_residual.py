"""Torque steps of a flexible joint: the action adds to the voltage of the paper's law."""

from __future__ import annotations

from typing import ClassVar

from envs.tasks._torque import SENSED, Torque
from jaxsim.law import Control
from jaxsim.laws.held_command import HeldCommand
from jaxsim.observation import Action, Channel
from jaxsim.study import load


class TorqueTrackingResidual(Torque):
    """`TorqueTracking` with PI, positive feedback and lead at work: the action adds a voltage.

    The law is that of the study leg_torque, designed for the nominal leg, and runs continuously;
    the supply cuts the sum to 48 V. The action 0 leaves it alone. Action (1,), held for 1 ms, in
    [-1, 1]:

    | index | name | unit | full scale |
    |---|---|---|---|
    | 0 | added voltage | V | 12 |

    Observation (12,): the 10 of `TorqueTracking`, and the state of the law:

    | index | name | unit | full scale | low | high |
    |---|---|---|---|---|---|
    | 0 | reference | Nm | 5 | -1 | 1 |
    | 1 | error | Nm | 50 | -1 | 1 |
    | 2 | theta_L | rad | 4 | -1 | 1 |
    | 3 | omega_L | rad/s | 20 | -1 | 1 |
    | 4 | omega_M | rad/s | 2000 | -1 | 1 |
    | 5 | current | A | 100 | -1 | 1 |
    | 6 | previous action | 1 | 1 | -1 | 1 |
    | 7 | remaining | 1 | 1 | 0 | 1 |
    | 8 | rms error | Nm | 50 | 0 | 1 |
    | 9 | overshoot | % | 1000 | 0 | 1 |
    | 10 | lead filter | V | 100 | -1 | 1 |
    | 11 | integrated error | Nm s | 2 | -1 | 1 |

    Reward: as in `TorqueTracking`.
    """

    actions: ClassVar[tuple[Action, ...]] = (Action("added voltage", "V", 12.0, "level"),)
    channels: ClassVar[tuple[Channel, ...]] = (
        *SENSED,
        Channel("lead filter", "V", 100.0, state=0),
        Channel("integrated error", "Nm s", 2.0, state=1),
    )

    def law(self) -> Control:
        return load("leg_torque").law + HeldCommand(command_unit="V")
