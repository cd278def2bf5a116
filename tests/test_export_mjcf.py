"""The MuJoCo model of a joint against the engine: both push the motor and let it rattle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsim._simulate import simulate
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.errors import InputError
from jaxsim.export.mjcf import write_mjcf
from jaxsim.laws.feedforward import Feedforward
from jaxsim.scenario import Scenario
from jaxsim.signals.step import Step
from jaxsim.study import load
from jaxsim.transmissions.backlash import Backlash

mujoco = pytest.importorskip("mujoco")
DURATION, DT, TORQUE = 0.1, 2e-4, 0.5
# Of the largest value; measured 5.4e-4, the share of 1e-4 and the instant of each contact.
RESIDUAL = 1e-3


def _mujoco(path: Path, torques: np.ndarray) -> np.ndarray:
    """theta_L, theta_B and both speeds after each interval of DT at a constant torque."""
    model: Any = mujoco.MjModel.from_xml_path(str(path))  # type: ignore[attr-defined]
    data: Any = mujoco.MjData(model)  # type: ignore[attr-defined]
    rows = []
    for torque in torques:
        data.ctrl[0] = torque
        for _ in range(round(DT / model.opt.timestep)):
            mujoco.mj_step(model, data)  # type: ignore[attr-defined]
        load, motor = data.qpos
        rows.append((load, motor - load, data.qvel[0], data.qvel[1] - data.qvel[0]))
    return np.array(rows)


@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_mujoco_moves_as_the_engine_does(ratio: float, tmp_path: Path) -> None:
    base = bench_2018()
    gear = Backlash(K=300.0, D_B=0.1, half_gap=7.8e-3, N=ratio, no_pull=True)
    drive = type(base)(base.motor, gear, base.load)
    write_mjcf(tmp_path / "joint.xml", drive, {"made by": "a test"})
    back = DURATION / 2.0
    reference = Step(TORQUE, 0.0) + Step(-2.0 * TORQUE, back)
    run = simulate(drive, Feedforward(), Scenario(reference, duration=DURATION), dt=DT)
    steps = round(DURATION / DT)
    torques = np.where(DT * np.arange(steps) < back - 1e-9, TORQUE, -TORQUE)
    theirs = _mujoco(tmp_path / "joint.xml", torques)
    assert len(run.events()) > 3
    for i, name in enumerate(("theta_L", "theta_B", "omega_L", "omega_B")):
        ours = np.asarray(run.signals[name])[1:]
        residual = np.abs(theirs[:, i] - ours).max() / np.abs(ours).max()
        assert residual <= RESIDUAL


@pytest.mark.parametrize(
    ("study", "words"),
    [("leg_torque", "drive.motor: must be Ideal: electrics"), ("arm_torque", "must have one axis")],
)
def test_what_mujoco_would_compute_wrongly_is_refused(
    study: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        write_mjcf(tmp_path / "joint.xml", load(study).drive, {})
    assert not (tmp_path / "joint.xml").exists()


def test_a_joint_without_play_is_refused(tmp_path: Path) -> None:
    base = bench_2018()
    stiff = type(base)(base.motor, Backlash(K=300.0, half_gap=0.0), base.load)
    with pytest.raises(InputError, match="half_gap: must be > 0"):
        write_mjcf(tmp_path / "joint.xml", stiff, {})
