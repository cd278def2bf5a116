"""Position step with backlash: the action adds to the torque of the paper's law."""

from __future__ import annotations

from typing import ClassVar

from envs.tasks._position import LAW_STATE, SENSED, Position, switched_law
from jaxsim.law import Law
from jaxsim.laws.held_command import HeldCommand
from jaxsim.observation import Action, Channel


class BacklashPositionResidual(Position):
    """`BacklashPosition` with PD and switched damping at work: the action adds torque.

    The law is that of the study bench_switched and runs continuously; the action 0 leaves it
    alone. Action (1,), held for 1 ms, in [-1, 1]:

    | index | name | unit | full scale |
    |---|---|---|---|
    | 0 | added T_M | Nm | 1 |

    Observation (13,): the 11 of `BacklashPosition`, and the state of the law:

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
    | 11 | filtered reference | rad | 1 | -1 | 1 |
    | 12 | filtered error | rad | 10 | -1 | 1 |

    Reward: as in `BacklashPosition`.
    """

    actions: ClassVar[tuple[Action, ...]] = (Action("added T_M", "Nm", 1.0, "level"),)
    channels: ClassVar[tuple[Channel, ...]] = SENSED + LAW_STATE

    def law(self) -> Law:
        return switched_law() + HeldCommand()
