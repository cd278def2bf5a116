"""A control law as a computer runs it: Tustin's rule, hold, delay, encoders, filters, float32."""

from __future__ import annotations

import abc
import functools
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.random import threefry_2x32

from jaxsim.errors import InputError
from jaxsim.hybrid import Plain, switch_all
from jaxsim.law import Control, Decentral, JointLaw, Law, Measured, Scalar, Supervised
from jaxsim.parameters import NON_NEGATIVE, POSITIVE, Parameters, parameter
from jaxsim.tree import cast

# Commands under way are kept one by one in the state: a delay of thousands of periods, which was
# meant in another unit, would compile for minutes.
_LONGEST = 32


class Sensors(Parameters):
    """What the sampled law gets to see of the measurements."""

    @abc.abstractmethod
    def read(
        self, y: Measured, last: Measured, ratio: Scalar, period: float, number: Scalar
    ) -> Measured:
        """The readings now, given the true values and the readings one period ago.

        number: of the reading, counted from 0 before the start; each axis has numbers of its own.
        """

    def counted(self, y: Measured) -> Measured:
        """The true values as the hardware delivers them, before any arithmetic of the target."""
        return y


class TrueSpeeds(Sensors):
    """Everything as it is."""

    def read(
        self, y: Measured, last: Measured, ratio: Scalar, period: float, number: Scalar
    ) -> Measured:
        return y


class Differences(Sensors):
    """Exact angles, speeds as their backward differences over one period.

    What encoders of infinitely many counts read.
    """

    def read(
        self, y: Measured, last: Measured, ratio: Scalar, period: float, number: Scalar
    ) -> Measured:
        omega_L = (y.theta_L - last.theta_L) / period
        omega_M = (y.theta_M - last.theta_M) / period
        return y._replace(
            theta_B=y.theta_M / ratio - y.theta_L,
            omega_L=omega_L,
            omega_M=omega_M,
            omega_B=omega_M / ratio - omega_L,
        )


class Encoders(Sensors):
    """Angles rounded to counts, speeds as their backward differences over one period.

    counts: per revolution, on motor and load (2018 paper: 2^20). The joint torque is measured
    by its own sensor and stays as it is. The derivative is that of the angle itself: that of
    rounding is zero, and a gradient would not see what the law feeds back.
    """

    counts: int = eqx.field(static=True, default=2**20)

    def __check_init__(self) -> None:
        if self.counts < 1:
            raise InputError("Encoders.counts", "must be >= 1", self.counts, "e.g. 2**20")

    def read(
        self, y: Measured, last: Measured, ratio: Scalar, period: float, number: Scalar
    ) -> Measured:
        return Differences().read(self.counted(y), last, ratio, period, number)

    def counted(self, y: Measured) -> Measured:
        count = 2.0 * jnp.pi / self.counts
        theta_L, theta_M = (_rounded(angle, count) for angle in (y.theta_L, y.theta_M))
        return y._replace(theta_L=theta_L, theta_M=theta_M)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def _rounded(angle: Scalar, count: float) -> Scalar:
    return count * jnp.round(angle / count)


@_rounded.defjvp
def _passed_through(count: float, angle: Any, tangent: Any) -> tuple[Scalar, Scalar]:
    return _rounded(*angle, count), tangent[0]


class Filtered(Sensors):
    """`sensors` behind a low-pass on both speeds: w_k = w_{k-1} + (1 - a)(v_k - w_{k-1}).

    a = exp(-2 pi cutoff period): the first-order low-pass with its input held over a period, the
    fixed velocity filter of many drives. Angles and torque stay as they are.
    """

    sensors: Sensors
    cutoff: Scalar = parameter("Hz", "cut-off of the low-pass", rule=POSITIVE)

    def read(
        self, y: Measured, last: Measured, ratio: Scalar, period: float, number: Scalar
    ) -> Measured:
        raw = self.sensors.read(y, last, ratio, period, number)
        share = -jnp.expm1(-2.0 * jnp.pi * period * self.cutoff)
        omega_L = last.omega_L + share * (raw.omega_L - last.omega_L)
        omega_M = last.omega_M + share * (raw.omega_M - last.omega_M)
        return raw._replace(omega_L=omega_L, omega_M=omega_M, omega_B=omega_M / ratio - omega_L)

    def counted(self, y: Measured) -> Measured:
        return self.sensors.counted(y)


class Noisy(Sensors):
    """`sensors` behind random noise: theta + angle_noise n and T_s + torque_noise n.

    n ~ N(0, 1), independent for both angles and the torque, and new in every reading. It depends
    on the seed and the number of the reading alone: runs repeat, and members of a batch that are
    to differ have seeds of their own, `spread(law, seed=range(100))`. Speeds that are differences
    of angles have their noise; speeds that are measured themselves stay exact.
    """

    sensors: Sensors
    angle_noise: Scalar = parameter(
        "rad", "standard deviation of both angles", rule=NON_NEGATIVE, default=0.0
    )
    torque_noise: Scalar = parameter(
        "Nm", "standard deviation of T_s", rule=NON_NEGATIVE, default=0.0
    )
    seed: Scalar = parameter("1", "whole number", rule=NON_NEGATIVE, default=0.0)

    def read(
        self, y: Measured, last: Measured, ratio: Scalar, period: float, number: Scalar
    ) -> Measured:
        n = _normal(self.seed, number, y.theta_L.dtype)
        off_L, off_M = self.angle_noise * n[0], self.angle_noise * n[1]
        noisy = y._replace(
            theta_L=y.theta_L + off_L,
            theta_M=y.theta_M + off_M,
            theta_B=y.theta_B + off_M / ratio - off_L,
            T_s=y.T_s + self.torque_noise * n[2],
        )
        return self.sensors.read(noisy, last, ratio, period, number)


def _normal(seed: Scalar, number: Scalar, dtype: Any) -> Any:
    """Three numbers from N(0, 1) for a seed and a count, the same in every precision.

    One call of Threefry keyed by both. `jax.random` would make a key, fold the count in, and draw:
    40 us of the 100 that a step of one environment takes.
    """
    key = jnp.stack([jnp.asarray(v).astype(jnp.uint32) for v in (seed, number)])
    bits = threefry_2x32(key, jnp.arange(4, dtype=jnp.uint32))[:3]
    # 23 bits, in the middle of their intervals: never -1 or 1.
    uniform = (bits >> 9).astype(jnp.float32) * 2.0**-22 + (2.0**-23 - 1.0)
    return (2.0**0.5 * jax.lax.erf_inv(uniform)).astype(dtype)


class Held(NamedTuple):
    """State of a sampled law: what is applied, what waits, and its memory."""

    command: tuple[Scalar, ...]
    waiting: tuple[tuple[Scalar, ...], ...]
    law: Any
    seen: tuple[Measured, ...]


class Sampled(eqx.Module):
    """`law` run every `period` seconds, its command held and applied `delay` seconds late.

    The states are advanced by Tustin's rule x1 = x0 + period/2 (f(x0, y0) + f(x1, y1)), exact
    for laws that are affine in their state: the bilinear transform of each of their filters.
    Switching conditions are evaluated at the samples. period and delay are static and must be
    multiples of the integration step. Source: 2018 paper, section IV.

    precision: 32 or 64 bits of readings, law and memory, whatever the drive is integrated in: a
    target with float32 runs what `gearlash export c --float` writes. A policy sets its law anew
    at every one of its own periods, which are multiples of this one.

    Raises: InputError for a period <= 0 or a delay < 0.
    """

    law: Any = eqx.field(
        converter=lambda v: Decentral((v,)) if isinstance(v, Law) else v, metadata={"base": Control}
    )
    period: float = eqx.field(static=True)
    delay: float = eqx.field(static=True, default=0.0)
    sensors: Sensors = eqx.field(default_factory=TrueSpeeds)
    precision: Literal[32, 64] = eqx.field(static=True, default=64)

    def __check_init__(self) -> None:
        if not self.period > 0.0:
            raise InputError("Sampled.period", "must be > 0 s", self.period, "e.g. 400e-6")
        if not self.delay >= 0.0:
            raise InputError("Sampled.delay", "must be >= 0 s", self.delay, "e.g. one period")
        if self.delay > _LONGEST * self.period:
            rule = f"must be at most {_LONGEST} periods of {self.period:g} s"
            raise InputError("Sampled.delay", rule, self.delay, "give seconds or text with a unit")
        if self.precision not in (32, 64):
            raise InputError("Sampled.precision", "must be 32 or 64", self.precision, "e.g. 32")
        self.law.check_period(self.period)

    @property
    def axes(self) -> int:
        return self.law.axes

    @property
    def command_unit(self) -> str:
        return self.law.command_unit

    @property
    def reference_unit(self) -> str | None:
        return self.law.reference_unit

    def ticks(self, dt: float) -> tuple[int, int]:
        """period and delay in integration steps.

        Raises: InputError when dt does not divide them.
        """
        counts = []
        for name, value in (("period", self.period), ("delay", self.delay)):
            count = round(value / dt)
            if abs(count * dt - value) > 1e-9 * dt + 1e-12 * value:
                raise InputError(
                    f"Sampled.{name}",
                    f"must be a multiple of dt = {dt:g} s",
                    value,
                    f"use dt = {self.period / max(1, round(self.period / dt)):.6g} s"
                    if name == "period"
                    else f"use {max(count, 1) * dt:.6g} s",
                )
            counts.append(count)
        return counts[0], counts[1]

    def start(self, ys: tuple[Measured, ...], dt: float) -> Held:
        """At rest, before the first sample; readings exact, command zero."""
        period, delay = self.ticks(dt)
        zero = tuple(jnp.zeros_like(y.theta_L) for y in ys)
        law = self.law.rest(ys)
        if isinstance(self.law, Supervised):
            law = law, self.law.start(ys, self.period)
        return Held(zero, (zero,) * (delay // period + 1), law, ys)

    def on_tick(
        self, tick: Scalar, ys: tuple[Measured, ...], held: Held, ratios: tuple, dt: float
    ) -> Held:
        """What changes at an integration tick: a new sample, a command that becomes due."""
        period, delay = self.ticks(dt)
        held = _choose(tick % period == 0, self.sample(ys, held, ratios, tick // period), held)
        due = tick % period == delay % period
        return held._replace(command=_choose(due, held.waiting[-1], held.command))

    def sample(self, ys: tuple[Measured, ...], held: Held, ratios: tuple, number: Scalar) -> Held:
        """The law's turn at its sample of that number, from 0: the newest command waits."""
        if self.precision == 64:
            return self._sample(ys, held, ratios, number)
        # Kept in the drive's own precision, which holds every float32: carries stay of one dtype.
        counts = tuple(self.sensors.counted(y) for y in ys)
        coarse = cast((self, counts, held, ratios), jnp.float32)
        done = coarse[0]._sample(*coarse[1:], number)
        return cast(done, ys[0].theta_L.dtype)

    def _sample(self, ys: tuple[Measured, ...], held: Held, ratios: tuple, number: Scalar) -> Held:
        first = (number + 1) * self.axes
        seen = tuple(
            self.sensors.read(y, last, ratio, self.period, first + axis)
            for axis, (y, last, ratio) in enumerate(zip(ys, held.seen, ratios, strict=True))
        )
        if not isinstance(self.law, Supervised):
            state = self._advanced(self.law, held.law, held.seen, seen)
            command = self.law.command(state, seen, _switches(self.law, state, seen))
            return Held(held.command, (command, *held.waiting[:-1]), state, seen)
        state, memory = held.law
        state = self._advanced(self.law.under(memory), state, held.seen, seen)
        told = state, ((),) * self.axes  # nobody at the target knows a motor's current
        memory = self.law.on_tick(number, ys, memory, ratios, self.period, told)
        law = self.law.under(memory)
        command = law.command(state, seen, _switches(law, state, seen))
        return Held(held.command, (command, *held.waiting[:-1]), (state, memory), seen)

    def _advanced(self, law: JointLaw, state: Any, before: Any, now: Any) -> Any:
        return law.on_sample(self._tustin(law, state, before, now), now, self.period)

    def _tustin(
        self, law: JointLaw, state: Any, before: tuple[Measured, ...], now: tuple[Measured, ...]
    ) -> Any:
        leaves, structure = jax.tree.flatten(state)
        if not leaves:
            return state

        def rates(values: list[Scalar], ys: tuple[Measured, ...]) -> list[Scalar]:
            tree = jax.tree.unflatten(structure, values)
            return jax.tree.leaves(law.field(tree, ys, _switches(law, tree, ys)))

        half = 0.5 * self.period
        old, new = rates(leaves, before), rates(leaves, now)
        columns = [
            jax.jvp(lambda v: rates(v, now), (leaves,), (unit,))[1] for unit in _units(leaves)
        ]
        matrix = [
            [float(i == j) - half * columns[j][i] for j in range(len(leaves))]
            for i in range(len(leaves))
        ]
        change = solve_unrolled(matrix, [half * (a + b) for a, b in zip(old, new, strict=True)])
        return jax.tree.unflatten(structure, [x + d for x, d in zip(leaves, change, strict=True)])


def _switches(law: JointLaw, state: Any, ys: tuple[Measured, ...]) -> Any:
    return switch_all(Plain(), law.surfaces, law.guards(state, ys), None)


def _choose(condition: Scalar, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _units(leaves: list[Scalar]) -> list[list[Scalar]]:
    return [
        [jnp.ones_like(v) if i == j else jnp.zeros_like(v) for j, v in enumerate(leaves)]
        for i in range(len(leaves))
    ]


def solve_unrolled(matrix: list[list[Scalar]], rhs: list[Scalar]) -> list[Scalar]:
    """Gaussian elimination, unrolled on scalars.

    A LAPACK call per step costs more than the whole step. No pivoting: I - period/2 J is
    diagonally dominant for filters slower than the sampling.
    """
    rows = [[*row, b] for row, b in zip(matrix, rhs, strict=True)]
    size = len(rows)
    for k in range(size):
        for i in range(k + 1, size):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    solution: list[Scalar] = [0.0] * size
    for i in reversed(range(size)):
        known = sum(rows[i][j] * solution[j] for j in range(i + 1, size))
        solution[i] = (rows[i][size] - known) / rows[i][i]
    return solution
