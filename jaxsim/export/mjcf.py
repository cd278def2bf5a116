"""A geared joint as a MuJoCo model: motor, gap and load."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.loads.inertia import Inertia
from jaxsim.motors.ideal import Ideal
from jaxsim.provenance import replace_text
from jaxsim.transmissions.backlash import Backlash

_STEP = 1e-5
# A limit makes the relative acceleration (1 - d) a + d a_ref: with the smallest d that MuJoCo
# takes, and a_ref in proportion, it is a spring and damper that acts beside the other torques.
# Its usual d near 1 would take the motor torque away while in contact.
_IMPEDANCE = 1e-4
_DIFFERENT = (
    "contact is found at the timestep, its instant is not located: keep the timestep small",
    "the gear never pulls (no_pull), where this drive's may shortly before release",
    f"in contact a share of {_IMPEDANCE:g} of the other torques on the deflection is lost",
)


class Limit(NamedTuple):
    """solref of a limit: minus stiffness and minus damping per unit of inertia."""

    stiffness: float
    damping: float


def write_mjcf(path: Path, drive: Drive, about: dict[str, Any]) -> tuple[str, ...]:
    """Write the joint as MJCF; returns what is not the same in MuJoCo, in words.

    Two hinges, load and motor, both on the load side (motor angle/N, inertia N^2 J_M; the
    actuator's gear N makes ctrl the motor torque), and a tendon of length
    theta_B = theta_M/N - theta_L, whose limits are the gap and its contact.

    Raises: InputError for what MuJoCo would compute wrongly: several axes, electrical motors,
    friction that sticks, transmissions other than `Backlash` with a gap, loads other than
    `Inertia`.
    """
    motor, gear, load = _parts(drive)
    if float(gear.half_gap) == 0.0:
        fix = "a tendon with stiffness and damping is all that it takes"
        raise InputError("drive.transmission.half_gap", "must be > 0", "0.0", fix)
    N, half_gap = float(gear.N), float(gear.half_gap)
    J_M, J_L = N * N * float(motor.J_M), float(load.J_L)
    limit = _limit(float(gear.K), float(gear.D_B), J_M, J_L)
    rows = "\n  ".join(
        [
            *(f"{key}: {value}" for key, value in about.items() if not isinstance(value, dict)),
            *(f"not the same in MuJoCo: {words}" for words in _DIFFERENT),
        ]
    ).replace("--", "- -")
    text = _MODEL.format(
        about=rows, step=_STEP, J_M=J_M, J_L=J_L, D_M=N * N * float(motor.D_M),
        D_L=float(load.D_L), half_gap=half_gap, N=N, d=_IMPEDANCE,
        solref=quoteattr(f"{-limit.stiffness!r} {-limit.damping!r}"),
    )  # fmt: skip
    replace_text(path, text)
    return _DIFFERENT


def _limit(K: float, D_B: float, J_M: float, J_L: float) -> Limit:
    """With solref = (-k, -b) and a constant impedance, torque = J (k r + b v), 1/J = 1/J_M + 1/J_L.

    Source: MuJoCo's documentation, "Solver parameters": direct format, scaled by d_max.
    """
    inertia = J_M * J_L / (J_M + J_L)
    return Limit(K / inertia, D_B / inertia)


_MODEL = """<!--
  {about}
  ctrl: motor torque, Nm. qpos: theta_L and theta_M/N, rad. ten_length: theta_B, rad.
-->
<mujoco model="gearlash">
  <compiler angle="radian"/>
  <option timestep="{step!r}" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="load">
      <joint name="theta_L" type="hinge" axis="0 0 1" damping="{D_L!r}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{J_L!r} {J_L!r} {J_L!r}"/>
    </body>
    <body name="motor">
      <joint name="theta_M_over_N" type="hinge" axis="0 0 1" damping="{D_M!r}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{J_M!r} {J_M!r} {J_M!r}"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="theta_B" limited="true" range="-{half_gap!r} {half_gap!r}"
           solreflimit={solref} solimplimit="{d!r} {d!r} 1 0.5 1">
      <joint joint="theta_M_over_N" coef="1"/>
      <joint joint="theta_L" coef="-1"/>
    </fixed>
  </tendon>
  <actuator>
    <motor name="T_M" joint="theta_M_over_N" gear="{N!r}"/>
  </actuator>
</mujoco>
"""


def _parts(drive: Drive) -> tuple[Ideal, Backlash, Inertia]:
    if drive.axes != 1:
        raise InputError("drive", "must have one axis", f"{drive.axes} axes", "export one joint")
    found = []
    known = (
        ("motor", drive.motor[0], Ideal, "electrics and friction that sticks have no counterpart"),
        ("transmission", drive.transmission[0], Backlash, "only a gap with K and D_B has one"),
        ("load", drive.load, Inertia, "only an inertia with viscosity has one"),
    )
    for name, part, kind, why in known:
        if not isinstance(part, kind):
            rule = f"must be {kind.__name__}: {why}"
            raise InputError(f"drive.{name}", rule, type(part).__name__, "simulate it here")
        found.append(part)
    return tuple(found)  # type: ignore[return-value]
