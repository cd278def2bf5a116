"""Experiments: what was put in, what came out, and the machine that is thought to be between."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxsim import tree
from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.parameters import NON_NEGATIVE, Parameters, parameter
from jaxsim.scenario import Scenario
from jaxsim.signal import Scalar


class Sensor(Parameters):
    """reading(t) = scale * signal(t - delay) + offset; the unit is that of the signal."""

    offset: Scalar = parameter("SI unit of the signal", "added to every reading", default=0.0)
    scale: Scalar = parameter("1", "reading over signal", default=1.0)
    delay: Scalar = parameter("s", "age of a reading", rule=NON_NEGATIVE, default=0.0)


class Measurement(NamedTuple):
    """One measured signal of one experiment.

    signal: name of a signal of a `Run` ("theta_L", "T_s", ...; "theta_L[1]" for one of several
    axes). times: (n,) s from the start of the experiment, increasing. values: (n,) in the SI unit
    of the signal. noise: standard deviation of a reading, quantisation included, in that unit: the
    weight of the signal. used: (n,) False where a sample is masked.
    """

    signal: str
    times: np.ndarray
    values: np.ndarray
    noise: float
    used: np.ndarray
    sensor: Sensor = Sensor()


class Experiment(NamedTuple):
    """One recording: the machine with what is known of this recording set, and what it read.

    The scenario holds the inputs (`reference`: the command of an open-loop log under
    `Feedforward`, or what a drive's own law follows; `load_torque`) and the start. The experiments
    of one fit have the same components and the same measured signals in the same order; numbers,
    lengths and durations may differ. at_rest: whether the gear starts wound up by the load.
    """

    name: str
    drive: Drive
    law: Any
    scenario: Scenario
    measurements: tuple[Measurement, ...]
    at_rest: bool = False

    @property
    def signals(self) -> tuple[str, ...]:
        return tuple(m.signal for m in self.measurements)


class Model(eqx.Module):
    """Everything of one experiment that may hold an unknown, as one tree of parameters."""

    drive: Drive
    law: Any
    scenario: Scenario
    sensors: tuple[Sensor, ...]
    at_rest: bool = eqx.field(static=True, default=False)


def model_of(experiment: Experiment) -> Model:
    """The tree of one experiment."""
    sensors = tuple(m.sensor for m in experiment.measurements)
    parts = experiment.drive, experiment.law, experiment.scenario
    return Model(*parts, sensors, experiment.at_rest)


def wound(model: Model) -> Model:
    """The model at rest: its gear carries what keeps the load from falling.

    theta_B = T/K + sign(T) half_gap, with T = -a(0)/(a(1) - a(0)) of the load's acceleration
    a(T_s) under the load torque of the beginning; for drives of one axis.
    """
    start = model.scenario.start[0]
    gear: Any = model.drive.transmission[0]
    zero = jnp.zeros_like(jnp.asarray(start.theta_L, float))
    pull = model.scenario.load_torque[0].value(zero, zero)

    def acceleration(torque: Scalar) -> Scalar:
        return model.drive.load.acceleration((start.theta_L,), (zero,), (torque + pull,))[0]

    free = acceleration(zero)
    torque = -free / (acceleration(zero + 1.0) - free)
    theta_B = torque / gear.K + jnp.sign(torque) * getattr(gear, "half_gap", 0.0)
    return tree.replace(model, {"scenario.start.theta_B": theta_B})


def measurement(
    signal: str, times: Any, values: Any, noise: float, *, used: Any = None, sensor: Any = None
) -> Measurement:
    """A checked `Measurement`; samples that are not finite are masked.

    Raises: InputError for times that do not increase, unequal lengths, or a noise that is not > 0.
    """
    times, values = np.asarray(times, float), np.asarray(values, float)
    where = f"measurement {signal}"
    if times.ndim != 1 or times.shape != values.shape or times.size < 2:
        got = f"{times.shape} and {values.shape}"
        raise InputError(where, "times and values must be lists of one length", got, "check them")
    if not np.all(np.diff(times) > 0.0):
        at = int(np.argmin(np.diff(times)))
        raise InputError(where, "times must increase", f"not after sample {at}", "repair the log")
    if not 0.0 < noise < float("inf"):
        raise InputError(f"{where}.noise", "must be > 0", noise, "give a standard deviation")
    finite = np.isfinite(values)
    used = finite if used is None else finite & np.asarray(used, bool)
    kept = np.where(finite, values, 0.0)
    return Measurement(signal, times, kept, float(noise), used, sensor or Sensor())
