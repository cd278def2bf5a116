"""A drive or closed loop as functions of flat vectors, to be differentiated."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxsim.drive import Drive, Motor, Scalar, Shaft
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact, Surface, Switch
from jaxsim.law import Decentral
from jaxsim.laws.feedforward import Feedforward
from jaxsim.linear.state_space import per_axis
from jaxsim.loop import ClosedLoop, Outputs, State, When
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.tree import cast

_NOT_LINEAR = ("P_loss", "contact")  # outputs that are quadratic or discrete


class _Disturbed(Motor):
    """A motor with a torque tau_d on its shaft, so that the drive can be differentiated by it."""

    inner: Motor
    tau_d: Any

    @property
    def command_unit(self) -> str:  # type: ignore[override]
        return self.inner.command_unit

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        return self.inner.surfaces

    def rest(self) -> Any:
        return self.inner.rest()

    def torque(self, extra: Any, command: Scalar) -> Scalar:
        return self.inner.torque(extra, command)

    def _felt(self, shaft: Shaft) -> Shaft:
        return shaft._replace(torque=shaft.torque - self.tau_d)

    def guards(
        self, shaft: Shaft, extra: Any, command: Scalar, modes: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        return self.inner.guards(self._felt(shaft), extra, command, modes)

    def field(
        self, shaft: Shaft, extra: Any, command: Scalar, switches: tuple[Switch, ...]
    ) -> tuple[Scalar, Any]:
        return self.inner.field(self._felt(shaft), extra, command, switches)


class FlatLoop(eqx.Module):
    """The loop on flat vectors: x all states, u = (reference, d_L, tau_d) signal by signal.

    A pytree, so that one compilation serves all angles and parameters.
    """

    loop: ClosedLoop
    rest: State

    @classmethod
    def of(cls, system: ClosedLoop | Drive) -> FlatLoop:
        loop = cast(_as_loop(system), jnp.float64)
        if loop.clocked:
            raise InputError(
                "law", "must be continuous to be linearised", "a sampled law",
                "linearise with the law inside Sampled",
            )  # fmt: skip
        return cls(loop, cast(loop.start()[0], jnp.float64))

    @property
    def start(self) -> Any:
        """x of the scenario's start."""
        return ravel_pytree(self.rest)[0]

    def unravel(self, x: Any) -> State:
        return ravel_pytree(self.rest)[1](x)

    @property
    def axes(self) -> int:
        return self.loop.drive.axes

    def under(self, u: Any) -> ClosedLoop:
        """The loop with these references, load torques and shaft torques."""
        reference, d_L, tau_d = (u[k * self.axes : (k + 1) * self.axes] for k in range(3))
        scenario = Scenario(
            reference=tuple(Constant(v) for v in reference),
            load_torque=tuple(Constant(v) for v in d_L),
            start=self.loop.scenario.start,
            duration=self.loop.scenario.duration,
        )
        motors = tuple(_Disturbed(m, t) for m, t in zip(self.loop.drive.motor, tau_d, strict=True))
        return eqx.tree_at(lambda c: (c.scenario, c.drive.motor), self.loop, (scenario, motors))

    def states(self) -> tuple[str, ...]:
        """Names of x: the drive's axis by axis, then the law's; own states of parts are counted."""
        drive = [[(n, getattr(s, n)) for n in s._fields] for s in self.rest.drive]
        names: list[str] = []
        for i, fields in enumerate(drive):
            for name, value in fields:
                own = len(jax.tree.leaves(value))
                single = name in ("theta_L", "omega_L", "theta_B", "omega_M")
                parts = [name] if single else [f"{name}_{k}" for k in range(own)]
                names += [per_axis(p, self.axes)[i] for p in parts]
        return (*names, *(f"law_{k}" for k in range(len(self.start) - len(names))))

    def field(self, x: Any, u: Any, modes: tuple[Any, ...]) -> Any:
        return ravel_pytree(self.under(u).field(_now(x), self.unravel(x), modes, ()))[0]

    def outputs(self, x: Any, u: Any, modes: tuple[Any, ...]) -> Any:
        """Signal by signal, axis by axis."""
        found = self.under(u).outputs(_now(x), self.unravel(x), modes, ())
        return jnp.stack([getattr(o, n) for n in signals() for o in found])

    def guards(self, x: Any, u: Any, modes: tuple[Any, ...]) -> tuple[Any, ...]:
        return self.under(u).guards(_now(x), self.unravel(x), modes, ())


def _now(x: Any) -> When:
    return When(jnp.zeros_like(x[0]), jnp.zeros_like(x[0]))


def signals() -> tuple[str, ...]:
    """The outputs that can be linearised, in order."""
    return tuple(n for n in Outputs._fields if n not in _NOT_LINEAR)


def _as_loop(system: ClosedLoop | Drive) -> ClosedLoop:
    if isinstance(system, ClosedLoop):
        return system
    axes = range(system.axes)
    law = Decentral(tuple(Feedforward(command_unit=system.command_unit) for _ in axes))
    idle = tuple(Constant() for _ in axes)
    scenario = Scenario(reference=idle, load_torque=idle, start=tuple(Start() for _ in axes))
    return ClosedLoop(system, law, scenario, Exact(), dt=1e-4)
