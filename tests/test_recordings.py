"""Files with many recordings, starts at rest, and what a servo's motion cannot tell."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxsim
from jaxsim import tree
from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.laws.feedforward import Feedforward
from jaxsim.laws.servo import Servo
from jaxsim.loads.pendulum import Pendulum
from jaxsim.motors.geared import Geared
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.signals.samples import Samples
from jaxsim.study import from_table
from jaxsim.transmissions.backlash import Backlash
from tuning.identification.experiment import Experiment, measurement, model_of, wound
from tuning.identification.mapping import Recorded, experiments
from tuning.identification.spec import read_spec

STUDY = """
[drive]
motor = { type = "geared", J_M = 0.02, Fs = 0.5, Fc = 0.5 }
transmission = { type = "backlash", K = 40.0, half_gap = "6 mrad", D_B = 0.8 }
load = { type = "pendulum", mass = 0.5, length = 0.1 }
[law]
type = "servo"
K_T = 0.5
D_E = 1.0
k_p = 16.0
slew = 5.0
[scenario]
reference = { type = "delayed", signal = { type = "constant" }, delay = "30 ms" }
duration = 1.0
[run]
dt = "5 ms"
[identify]
start = "rest"
dt = "5 ms"
[identify.columns]
time = { column = "t" }
reference = { column = "goal", between = "linear", every = "10 ms" }
theta_L = { column = "q", noise = 0.005, spikes = 0.25 }
[identify.free]
K_T = { lower = 0.2, upper = 1.0 }
[[identify.experiments]]
log = "runs.npz"
records = [{ mass = [0.5, 1.0], kind = "fast" }]
first_of = ["mass"]
[identify.experiments.set]
mass = { column = "mass", unit = "g" }
release = { column = "on", below = 0.5 }
"""
STAMPS = 0.01 * np.arange(101.0) + np.where(np.arange(101) % 2, 0.002, 0.0)  # s, jittered


def _runs(folder: Path) -> None:
    """Six records: masses 0.5, 0.5, 1, 1, 2, 0.5, the last one slow; each with its own angle."""
    still = np.linspace(0.1, 0.6, 6)[:, None] * np.ones(101)
    still[2, 50:53] = -np.pi
    switch = np.ones((6, 101))
    switch[2, 70:] = 0.0
    np.savez(
        folder / "runs.npz", t=np.tile(STAMPS, (6, 1)), q=still, on=switch,
        goal=np.tile(STAMPS**2, (6, 1)), mass=[0.5, 0.5, 1.0, 1.0, 2.0, 0.5],
        kind=["fast", "fast", "fast", "fast", "fast", "slow"],
    )  # fmt: skip


def _mapped(folder: Path, **changes: Any) -> list[Recorded]:
    table = tomllib.loads(STUDY)
    table["identify"]["experiments"][0] |= changes
    study = from_table(table, folder, "servo")
    return experiments(study, read_spec(study))[0]


def test_records_are_chosen_and_say_what_they_are(tmp_path: Path) -> None:
    """The first fast record of each mass; its mass in g, its release where the switch falls."""
    _runs(tmp_path)
    light, heavy = _mapped(tmp_path)
    assert [light.experiment.name, heavy.experiment.name] == ["runs[0]", "runs[2]"]
    assert float(light.experiment.drive.load.mass) == pytest.approx(0.5e-3)
    law = heavy.experiment.law.laws[0]
    assert float(law.release) == pytest.approx(STAMPS[70])
    assert float(light.experiment.law.laws[0].release) == 1e9


def test_an_input_is_read_anew_at_equal_steps_and_late(tmp_path: Path) -> None:
    """t^2 read at jittered stamps, joined by straight lines: chords, to (12 ms)^2/4."""
    _runs(tmp_path)
    late = _mapped(tmp_path)[0].experiment.scenario.reference[0]
    assert float(late.delay) == pytest.approx(0.03)
    assert late.signal.on_ticks
    values = np.asarray(late.signal.values)
    np.testing.assert_allclose(values, (0.01 * np.arange(values.size)) ** 2, atol=0.012**2 / 4.0)


def test_spikes_of_several_samples_are_told_by_their_distance(tmp_path: Path) -> None:
    _runs(tmp_path)
    heavy = _mapped(tmp_path)[1]
    assert np.flatnonzero(~heavy.experiment.measurements[0].used).tolist() == [50, 51, 52]
    assert "3 spikes are masked" in heavy.remarks[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"records": {"mas": 0.5}}, "did you mean .*mass"),
        ({"records": {"mass": 0.7}}, "records: must match"),
        ({"records": {"kind": 1.0}}, "kind: must be text"),
        ({"records": {"mass": "0.5"}}, "mass: must be numbers"),
        ({"first_of": ["kin"]}, "did you mean .*kind"),
        ({"set": {"mass": {"column": "t"}}}, "one number"),
        ({"set": {"mass": {"column": "mass", "unt": "g"}}}, "did you mean .*unit"),
    ],
)
def test_records_that_are_not_there(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    _runs(tmp_path)
    with pytest.raises(InputError, match=words):
        _mapped(tmp_path, **changes)


def test_a_gear_wound_by_its_load_stays_where_it_is(tmp_path: Path) -> None:
    """The weight at 1 rad turns the load by 6 mrad of play and T/K; wound before, by nothing."""
    drive = Drive(
        Geared(J_M=0.02, Fc=2.0, Fs=2.0),
        Backlash(K=40.0, half_gap=6e-3, D_B=0.8),
        Pendulum(mass=1.0, length=0.1, rod=0.05, theta_0=0.2),
    )
    scenario = Scenario(Constant(0.0), start=Start(theta_L=1.0), duration=1.0)
    reading = measurement("theta_L", [0.0, 1.0], [1.0, 1.0], 1e-3)
    hung = Experiment("hung", drive, Feedforward(), scenario, (reading,), at_rest=True)
    fell = 1.0 - 9.81 * (1.0 + 0.025) * 0.1 * np.sin(0.8) / 40.0 - 6e-3
    for model, end in ((model_of(hung), fell), (wound(model_of(hung)), 1.0)):
        run = jaxsim.simulate(model.drive, model.law, model.scenario, dt=1e-3, metrics=())
        # As the play is, the load falls on it and comes to rest within a second to some 1e-4 rad.
        assert float(run.signals["theta_L"][-1]) == pytest.approx(end, abs=1e-3)
    assert float(run.signals["theta_L"][-1]) == pytest.approx(1.0, abs=1e-9)


def test_motor_and_friction_together_leave_no_trace_without_a_torque_sensor() -> None:
    """All of the motor times s, 1 + driving and 1 - driven, too: the load moves as before."""
    s = 1.07
    motor = {"J_M": 0.02, "D_M": 0.04, "Fc": 0.02, "Fs": 0.14}
    strong = {n: s * v for n, v in motor.items()}
    shares = {"driving": 0.2, "driven": 0.35}
    other = {"driving": s * 1.2 - 1.0, "driven": 1.0 - s * 0.65}
    gear, load = Backlash(K=40.0, half_gap=6e-3, D_B=0.8), Pendulum(mass=0.7, length=0.1, rod=0.04)
    t = 0.01 * np.arange(101)
    goal = Samples(0.8 * np.sin(5.0 * t), 0.01, "linear", on_ticks=True)
    scenario = Scenario(goal, start=Start(theta_L=0.3), duration=1.0)
    law = Servo(K_T=0.5, D_E=1.0, k_p=16.0, slew=5.0)
    drive = Drive(Geared(**motor, **shares, ws=1.5), gear, load)
    before = jaxsim.simulate(drive, law, scenario, dt=2e-3, metrics=())
    drive = Drive(Geared(**strong, **other, ws=1.5), gear, load)
    law = tree.replace(law, {"K_T": 0.5 * s, "D_E": s})
    after = jaxsim.simulate(drive, law, scenario, dt=2e-3, metrics=())
    moved = np.asarray(before.signals["theta_L"])
    assert np.ptp(moved) > 1.0
    np.testing.assert_allclose(after.signals["theta_L"], moved, atol=1e-9)
