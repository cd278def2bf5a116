"""A trained policy as a control law: a network that sets parameters of a law at work."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxsim import tree
from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.law import Control, JointLaw, Law, Measured, Scalar, Supervised, as_joint_law
from jaxsim.observation import (
    Action,
    Channel,
    Horizon,
    Memory,
    Seen,
    act,
    first_memory,
    observe,
    remember,
)
from jaxsim.parameters import POSITIVE, Parameters, parameter
from jaxsim.sampled import Sensors, TrueSpeeds

_ACTIVATIONS = {"tanh": jnp.tanh, "relu": jax.nn.relu}
# Ranges of a training are those of episodes drawn in float32, a little inside the real ones.
_EDGE, _ROUNDING = 0.02, 1e-6
_SQUASHES = {"tanh": jnp.tanh, "clip": lambda v: jnp.clip(v, -1.0, 1.0)}


class Layer(Parameters):
    """y = weight x + bias."""

    weight: Any = parameter("1", "(outputs, inputs)", ndim=2)
    bias: Any = parameter("1", "(outputs,)", ndim=1)


class Network(Parameters):
    """A multilayer perceptron from an observation to an action in the box, normalisation included.

    z = clip((o - mean)/scale, -bound, bound); hidden layers with `activation`, the last one with
    `squash`. Raises: InputError where the sizes of two neighbours differ.
    """

    layers: tuple[Layer, ...] = eqx.field(converter=tuple)
    mean: Any = parameter("1", "of the observation, (channels,)", ndim=1)
    scale: Any = parameter("1", "of the observation, (channels,)", ndim=1, rule=POSITIVE)
    bound: float = eqx.field(static=True, default=10.0)
    activation: Literal["tanh", "relu"] = eqx.field(static=True, default="tanh")
    squash: Literal["tanh", "clip"] = eqx.field(static=True, default="tanh")

    def __check_init__(self) -> None:
        size = np.shape(self.mean)[-1]
        for i, layer in enumerate(self.layers):
            shape = np.shape(layer.weight)[-2:]
            if shape[1:] != (size,) or np.shape(layer.bias)[-1:] != shape[:1]:
                rule = f"must take the {size} numbers before it and have one bias per output"
                found = f"weight {shape}, bias {np.shape(layer.bias)}"
                raise InputError(f"layers[{i}]", rule, found, "is the file of one training?")
            size = shape[0]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Inputs, hidden units, outputs."""
        return np.shape(self.mean)[-1], *(np.shape(v.bias)[-1] for v in self.layers)

    def __call__(self, observation: Any) -> Any:
        """The action in [-1, 1], (actions,)."""
        z = jnp.clip((observation - self.mean) / self.scale, -self.bound, self.bound)
        *hidden, last = self.layers
        for layer in hidden:
            z = _ACTIVATIONS[self.activation](layer.weight @ z + layer.bias)
        return _SQUASHES[self.squash](last.weight @ z + last.bias)


class Trained(eqx.Module):
    """What a policy has seen of a drive: the range of one parameter over its episodes, SI."""

    parameter: str = eqx.field(static=True)
    low: float = eqx.field(static=True)
    high: float = eqx.field(static=True)


class Held(NamedTuple):
    """State of a policy: the action applied, the readings, and what it remembers."""

    action: tuple[Scalar, ...]
    seen: Measured
    memory: Memory


class Policy(Supervised):
    """At every sample: law parameters = centre + full_scale * network(observation).

    The classical law `base` runs continuously; the policy sets its parameters and holds them for
    a period: the command itself (`held_command`), a command added to a classical law (a sum with
    `held_command` in it), or a gain, such as K_B. Environments of a task do the same by the same
    functions (`jaxsim.observation`), so a policy scores in a run what it scores there.

    One axis. duration: of the episodes it was trained for, s; the share that remains is one of
    the things that it may look at, 0 from then on. trained: on which drives, where that is known.

    Raises: InputError where network, channels and actions do not fit together.
    """

    base: JointLaw = eqx.field(
        converter=lambda v: as_joint_law(v, 1) if isinstance(v, Law) else v,
        metadata={"base": Control},
    )
    network: Network
    channels: tuple[Channel, ...] = eqx.field(converter=tuple)
    actions: tuple[Action, ...] = eqx.field(converter=tuple)
    period: float = eqx.field(static=True)
    duration: float = eqx.field(static=True)
    sensors: Sensors = eqx.field(default_factory=TrueSpeeds)
    trained: tuple[Trained, ...] = eqx.field(converter=tuple, default=())

    def __check_init__(self) -> None:
        if not 0.0 < self.period < self.duration:
            value = f"{self.period} of {self.duration}"
            raise InputError("Policy.period", "must be > 0 s and < duration", value, "e.g. 1e-3")
        self.check(len(self.channels), len(self.actions), "Policy")
        for action in self.actions:
            tree.resolve(self.base, action.parameter)

    def check(self, channels: int, actions: int, field: str) -> None:
        """Raises: InputError where the network takes or gives other numbers."""
        takes, *_, gives = self.network.sizes
        if (takes, gives) != (channels, actions):
            rule = f"must have a network from {channels} channels to {actions} actions"
            raise InputError(field, rule, f"{takes} to {gives}", "was it trained for another task?")

    def remarks(self, drive: Drive) -> list[str]:
        """What is to be said of a drive that it was not trained on, in words."""
        own = tree.paths(drive)
        if any(t.parameter not in own for t in self.trained):
            return [
                "the policy was trained on a drive of other parts: it knows nothing of this one"
            ]
        told = []
        for t in self.trained:
            value, slack = float(tree.get(drive, t.parameter)), _EDGE * (t.high - t.low)
            slack += _ROUNDING * abs(t.high)
            if not t.low - slack <= value <= t.high + slack:
                name = t.parameter.rpartition(".")[2]
                told.append(f"{name} = {value:.4g}, there {_span(t)}")
        return [f"the policy was trained on other drives: {'; '.join(told)} (SI)"] if told else []

    @property
    def axes(self) -> int:
        return 1

    @property
    def command_unit(self) -> str:
        return self.base.command_unit

    @property
    def reference_unit(self) -> str | None:
        return self.base.reference_unit

    @property
    def surfaces(self) -> Any:
        return self.base.surfaces

    @property
    def horizon(self) -> Horizon:
        """Of its observations."""
        return Horizon(self.period, self.duration, self.reference_unit or "rad")

    def rest(self, ys: tuple[Measured, ...]) -> Any:
        return self.base.rest(ys)

    def guards(self, state: Any, ys: tuple[Measured, ...]) -> Any:
        return self.base.guards(state, ys)

    def field(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> Any:
        return self.base.field(state, ys, switches)

    def command(self, state: Any, ys: tuple[Measured, ...], switches: Any) -> tuple[Scalar, ...]:
        return self.base.command(state, ys, switches)

    def ticks(self, dt: float) -> int:
        count = round(self.period / dt)
        if count < 1 or abs(count * dt - self.period) > 1e-9 * dt + 1e-12 * self.period:
            rule, fix = f"must be a multiple of dt = {dt:g} s", "choose a dt that divides it"
            raise InputError("Policy.period", rule, self.period, fix)
        return count

    def start(self, ys: tuple[Measured, ...], dt: float) -> Held:
        (y,) = ys
        # Of these readings only angles and reference are looked at again, and no ratio is in them.
        seen = self.sensors.read(y, y, 1.0, self.period, 0)
        return Held((jnp.zeros_like(y.theta_L),) * len(self.actions), seen, first_memory(seen))

    def on_tick(
        self, tick: Scalar, ys: tuple[Measured, ...], held: Held, ratios: tuple, dt: float,
        states: tuple[Any, Any],
    ) -> Held:  # fmt: skip
        law, motors = states
        number = tick // self.ticks(dt) + 1
        seen = self.sensors.read(ys[0], held.seen, ratios[0], self.period, number)
        memory = remember(held.memory, seen, self.horizon)
        told = observe(self.channels, Seen(seen, motors[0], law, held.action, memory), self.horizon)
        chosen = self.network(told)
        new = Held(tuple(chosen[i] for i in range(len(self.actions))), seen, memory)
        due = tick % self.ticks(dt) == 0
        return jax.tree.map(lambda a, b: jnp.where(due, a, b), new, held)

    def under(self, held: Held) -> JointLaw:
        return act(self.actions, self.base, held.action)


def _span(t: Trained) -> str:
    same = t.high - t.low <= _ROUNDING * abs(t.high)
    return f"{t.high:.3g}" if same else f"{t.low:.3g} to {t.high:.3g}"


__all__ = ["Held", "Layer", "Network", "Policy", "Trained"]
