"""Torque steps of a flexible joint: the action adds to the voltage of the paper's law."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx

from envs.held import Held
from envs.task import Channel
from envs.tasks._torque import SENSED, Torque
from jaxsim.law import Control
from jaxsim.study import load

Scalar = Any


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

    actions: ClassVar[tuple[Channel, ...]] = (Channel("added voltage", "V", 12.0),)
    channels: ClassVar[tuple[Channel, ...]] = (
        *SENSED,
        Channel("lead filter", "V", 100.0),
        Channel("integrated error", "Nm s", 2.0),
    )

    def law(self) -> Control:
        return load("leg_torque").law + Held(command_unit="V")

    def act(self, law: Any, action: tuple[Scalar, ...]) -> Any:
        voltage = self.actions[0].full_scale * action[0]
        return eqx.tree_at(lambda v: v.laws[1].laws[0].level, law, voltage)
