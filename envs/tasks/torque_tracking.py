"""Torque steps of a flexible joint: the action is the voltage."""

from __future__ import annotations

from typing import ClassVar

from envs.tasks._torque import SENSED, VOLTAGE, Torque
from jaxsim.law import Control
from jaxsim.laws.held_command import HeldCommand
from jaxsim.observation import Action, Channel


class TorqueTracking(Torque):
    """Make the joint torque of the 2014 leg follow a step of 1 to 4 Nm either way.

    Episodes differ in leg, step, load, noise and delay: `envs.tasks._torque.Conditions`.

    Action (1,), held for 1 ms, in [-1, 1]:

    | index | name | unit | full scale |
    |---|---|---|---|
    | 0 | voltage | V | 48 |

    Observation (10,): value over full scale; beyond it the sensor saturates. Angles are read by
    encoders of 2^20 counts; speeds are their mean over the last period; torque and current have
    sensors. The remaining time, rms error and overshoot so far are what the cost to come depends
    on. Readings have noise, and in half of the episodes come one period late.

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

    Reward: minus the increments of the mean of rms error and overshoot, each over the value it
    has under PI, positive feedback and lead in the nominal case, and minus 1e-3 times the squared
    change of the action.
    """

    actions: ClassVar[tuple[Action, ...]] = (Action("voltage", "V", VOLTAGE, "level"),)
    channels: ClassVar[tuple[Channel, ...]] = SENSED

    def law(self) -> Control:
        # The law itself looks at no reference; the metrics must know that it is a torque.
        return HeldCommand(command_unit="V", follows="Nm")
