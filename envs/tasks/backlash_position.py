"""Position step with backlash: the action is the motor torque."""

from __future__ import annotations

from typing import ClassVar

from envs.tasks._position import SENSED, Position
from jaxsim.law import Law
from jaxsim.laws.held_command import HeldCommand
from jaxsim.observation import Action, Channel


class BacklashPosition(Position):
    """Move the load of the 2018 bench by 0.15 to 0.45 rad either way, through the gap, gently.

    Episodes differ in drive, step, load, noise and delay: `envs.tasks._position.Conditions`.

    Action (1,), held for 1 ms, in [-1, 1]:

    | index | name | unit | full scale |
    |---|---|---|---|
    | 0 | T_M | Nm | 3 |

    Observation (11,): value over full scale, clipped to the box. Angles are read by encoders of
    2^20 counts; speeds are their mean over the last period. The remaining time and the running
    maxima (of the samples) are what the cost to come depends on. Readings have noise, and in half
    of the episodes come one period late.

    | index | name | unit | full scale | low | high |
    |---|---|---|---|---|---|
    | 0 | reference | rad | 1 | -1 | 1 |
    | 1 | error | rad | 10 | -1 | 1 |
    | 2 | theta_B | rad | 0.05 | -1 | 1 |
    | 3 | omega_L | rad/s | 40 | -1 | 1 |
    | 4 | omega_M | rad/s | 40 | -1 | 1 |
    | 5 | omega_B | rad/s | 40 | -1 | 1 |
    | 6 | previous action | 1 | 1 | -1 | 1 |
    | 7 | remaining | 1 | 1 | 0 | 1 |
    | 8 | T_s max | Nm | 20 | 0 | 1 |
    | 9 | -T_s max | Nm | 20 | 0 | 1 |
    | 10 | overshoot | rad | 10 | 0 | 1 |

    Reward: minus the increments of the mean of IAE, ITAE, the maxima of T_s towards the target
    and away from it, and the overshoot, each over the value it has under the paper's switched law
    in the nominal case, and minus 1e-3 times the squared change of the action.
    """

    actions: ClassVar[tuple[Action, ...]] = (Action("T_M", "Nm", 3.0, "level"),)
    channels: ClassVar[tuple[Channel, ...]] = SENSED

    def law(self) -> Law:
        return HeldCommand()
