"""Exported C against the law in Python: 10 000 steps, compiled with every warning and sanitiser."""

from __future__ import annotations

import dataclasses
import itertools
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsim._simulate import simulate
from jaxsim.commands.export import _limits
from jaxsim.errors import InputError
from jaxsim.export.c_code import sampled_at, write_c
from jaxsim.export.step import Step
from jaxsim.law import Decentral, Measured
from jaxsim.laws.cascade import Cascade
from jaxsim.laws.held_command import HeldCommand
from jaxsim.laws.pi_torque import PITorque
from jaxsim.laws.policy import Layer, Network, Policy
from jaxsim.laws.positive_feedback import PositiveFeedback
from jaxsim.motors.dc import Supply
from jaxsim.observation import Action, Channel
from jaxsim.sampled import Encoders, Noisy, Sampled
from jaxsim.study import load

GCC = shutil.which("gcc")
pytestmark = pytest.mark.skipif(GCC is None, reason="no gcc")
FLAGS = [
    "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-fno-fast-math",
    "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
]  # fmt: skip
STEPS = 10_000
PERIOD = 4e-4
COUNT = 2.0 * np.pi / 2**20  # of `Encoders()`
# What the issue asks for, relative to the largest command; the same arithmetic is left to right
# in both, so that only XLA's fused products and sums remain.
DOUBLE, SINGLE = 1e-12, 1e-5


def _harness(step: Step, axes: int) -> str:
    reads = "".join(f"        in.{name} = row[{i}];\n" for i, name in enumerate(step.readings))
    names = ["command"] if axes == 1 else [f"command_{i}" for i in range(axes)]
    writes = "".join(f'        printf("%.17g ", (double)out.{name});\n' for name in names)
    return f"""#include <stdio.h>
#include "law.h"
int main(void)
{{
    double row[{len(step.readings)}];
    law_input in;
    law_output out;
    law_state state;
    int k;
    for (k = 0; fread(row, sizeof row, 1, stdin) == 1; ++k) {{
{reads.replace("= row", "= (law_real)row")}        if (k == 0) law_init(&state, &in);
        const int bad = law_step(&state, &in, &out);
{writes}        printf("%d\\n", bad);
    }}
    return 0;
}}
"""


def _run_c(folder: Path, step: Step, axes: int, table: np.ndarray) -> np.ndarray:
    (folder / "main.c").write_text(_harness(step, axes), "utf-8")
    files = [str(folder / "law.c"), str(folder / "main.c"), "-lm", "-o", str(folder / "law")]
    done = subprocess.run([str(GCC), *FLAGS, *files], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    ran = subprocess.run(
        [str(folder / "law")], input=table.tobytes(), capture_output=True, check=False
    )
    assert ran.returncode == 0, ran.stderr.decode()
    return np.array([line.split() for line in ran.stdout.decode().splitlines()], float)


def _readings(axes: int, ratios: tuple[float, ...], steps: int = STEPS) -> list[Measured]:
    """Motions of several frequencies, as consistent as those of a drive: (steps,) per field."""
    t = PERIOD * np.arange(steps)
    ys = []
    for axis in range(axes):
        f = 3.0 + axis
        theta_L, omega_L = 0.3 * np.sin(f * t), 0.3 * f * np.cos(f * t)
        theta_B, omega_B = 8e-3 * np.sin(41.0 * t), 0.328 * np.cos(41.0 * t)
        n = ratios[axis]
        # On the counts of an encoder, as a target reads them: between two counts, float and
        # double round to different ones.
        theta_L, theta_M = (COUNT * np.round(a / COUNT) for a in (theta_L, n * (theta_L + theta_B)))
        motor = theta_M, n * (omega_L + omega_B)
        reference = 0.3 * np.sign(np.sin(2.0 * t + axis))
        ys.append(Measured(reference, theta_L, omega_L, theta_B, omega_B, *motor, 2.0 * theta_B))
    return ys


def _run_python(law: Any, ratios: tuple[float, ...], ys: list[Measured], dtype: Any) -> np.ndarray:
    """The law as the engine runs it, a tick per period."""
    cast = lambda v: jnp.asarray(v, dtype)  # noqa: E731
    law, ys = jax.tree.map(cast, law), jax.tree.map(cast, ys)
    first = tuple(jax.tree.map(lambda v: v[0], ys))

    def one(held: Any, now: Any) -> Any:
        tick, y = now
        held = law.on_tick(tick, tuple(y), held, ratios, law.period)
        return held, jnp.stack(held.command)

    ticks = jnp.arange(len(ys[0].theta_L))
    run = jax.jit(lambda f, v: jax.lax.scan(one, law.start(f, law.period), v)[1])
    return np.asarray(run(first, (ticks, ys)))


def _table(step: Step, ys: list[Measured]) -> np.ndarray:
    named = {}
    for axis, y in enumerate(ys):
        for name, values in y._asdict().items():
            named[f"{name}_{axis}" if len(ys) > 1 else name] = values
    return np.ascontiguousarray(np.stack([named[n] for n in step.readings], axis=1))


def _bench() -> tuple[Any, tuple[float, ...]]:
    law = load("bench_sampled").law
    return Sampled(law.law, PERIOD, 0.0, law.sensors), (1.0,)


def _study(name: str) -> tuple[Any, tuple[float, ...]]:
    study = load(name)
    return sampled_at(study.law, PERIOD), tuple(float(t.ratio) for t in study.drive.transmission)


def _arm() -> tuple[Any, tuple[float, ...]]:
    drive = load("arm_torque").drive
    law = Decentral((PITorque(2.0, 12.5), PITorque(2.0, 25.0))) + PositiveFeedback.design(drive)
    return Sampled(law, PERIOD), tuple(float(t.ratio) for t in drive.transmission)


def _filtered() -> tuple[Any, tuple[float, ...]]:
    from jaxsim.derivatives.butterworth import Butterworth, ButterworthDifferences

    drive = load("leg_torque").drive
    source = ButterworthDifferences(Butterworth(50.0))
    law = Decentral((PITorque(2.0, 10.0),)) + PositiveFeedback.design(drive, source=source)
    return Sampled(law, PERIOD, 0.0, Encoders()), (float(drive.transmission[0].ratio),)


def _clipped() -> tuple[Any, tuple[float, ...]]:
    return Sampled(Cascade(30.0, 2.0, 0.5, 1.5, 1e-3), PERIOD), (1.0,)


def policy(
    activation: Any = "tanh", base: Any = None, period: float = PERIOD, action: Any = "level"
) -> Policy:
    random = np.random.default_rng(0)
    names = ("error", "omega_L", "T_s", "remaining", "T_s max", "previous action")
    channels = tuple(Channel(n, "1", 0.7) for n in names)
    sizes = len(names), 16, 16, 1
    # Small weights: with larger ones the loop through the previous action lets rounding grow.
    layers = [
        Layer(random.normal(0.0, 0.2, (b, a)), random.normal(0.0, 0.1, b))
        for a, b in itertools.pairwise(sizes)
    ]
    network = Network(layers, np.zeros(len(names)), np.full(len(names), 0.5), activation=activation)
    base = base or HeldCommand(0.0, follows="rad")
    actions = (Action("u", "Nm", 3.0, action),)
    return Policy(base, network, channels, actions, period, 2.0, Encoders())


def _residual() -> tuple[Any, tuple[float, ...]]:
    """The usual one: every 2 ms a torque beside PD, prefilter and damping, at work every 0.4 ms."""
    base = load("bench_switched").law.laws[0] + HeldCommand(0.0)
    return sampled_at(policy(base=base, period=5.0 * PERIOD), PERIOD), (1.0,)


def _schedule() -> tuple[Any, tuple[float, ...]]:
    """The gain of the damping, set at every sample."""
    base = load("bench_switched").law
    return sampled_at(policy(base=base, action="K_B"), None), (1.0,)


CASES: dict[str, Any] = {
    "switched, encoders": _bench,
    "leg: PI, lead, positive feedback": lambda: _study("leg_torque"),
    "leg: Butterworth, differences": _filtered,
    "arm: two joints": _arm,
    "cascade with limit": _clipped,
    "policy tanh": lambda: (sampled_at(policy(), None), (1.0,)),
    "policy relu": lambda: (sampled_at(policy("relu"), None), (1.0,)),
    "policy beside PD and damping": _residual,
    "policy sets a gain": _schedule,
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("single", [False, True])
def test_c_commands_what_the_law_commands(name: str, single: bool, tmp_path: Path) -> None:
    law, ratios = CASES[name]()
    step = write_c(tmp_path, law, ratios, {"made by": "a test"}, single=single)
    ys = _readings(law.axes, ratios)
    mine = _run_c(tmp_path, step, law.axes, _table(step, ys))
    python = _run_python(law, ratios, ys, jnp.float32 if single else jnp.float64)
    assert mine.shape == (STEPS, law.axes + 1)
    assert not mine[:, -1].any()
    scale = np.abs(python).max()
    assert scale > 0.1
    worst = np.abs(mine[:, :-1] - python).max() / scale
    assert worst <= (SINGLE if single else DOUBLE)


def test_the_firmware_twin_runs_what_is_exported(tmp_path: Path) -> None:
    """In the closed loop it commands, a period late, what the float C makes of its readings."""
    study = load("bench_twin")
    run = simulate(study.drive, study.law, study.scenario, dt=study.run.dt, metrics=())
    every = round(study.law.period / study.run.dt)
    signals = {n: np.asarray(v)[::every] for n, v in run.signals.items()}
    step = write_c(tmp_path, study.law, (1.0,), {}, single=True)
    for angle in ("theta_L", "theta_M"):
        signals[angle] = COUNT * np.round(signals[angle] / COUNT)
    table = np.stack([signals[n] for n in step.readings], axis=1)
    mine = _run_c(tmp_path, step, 1, np.ascontiguousarray(table))[:, 0]
    twin = signals["command"]
    assert twin[0] == 0.0
    assert np.abs(mine[:-1] - twin[1:]).max() <= SINGLE * np.abs(twin).max()


def test_a_reading_that_is_no_number_changes_nothing(tmp_path: Path) -> None:
    law, ratios = _bench()
    step = write_c(tmp_path, law, ratios, {})
    table = _table(step, _readings(1, ratios, 100))
    spoilt = np.insert(table, (40, 40), [[np.nan] * 3, [np.inf] * 3], axis=0)
    clean, dirty = _run_c(tmp_path, step, 1, table), _run_c(tmp_path, step, 1, spoilt)
    np.testing.assert_array_equal(dirty[40:42], [[clean[39, 0], 1.0]] * 2)
    np.testing.assert_array_equal(np.delete(dirty, (40, 41), axis=0), clean)


def test_gains_are_constants_to_tune_on_the_target(tmp_path: Path) -> None:
    law, ratios = _bench()
    step = write_c(tmp_path, law, ratios, {})
    table = _table(step, _readings(1, ratios, 500))
    text = (tmp_path / "law.h").read_text("utf-8")
    assert (
        "#define LAW_K_B (-0.8) /* Nm s/rad; gain on the deflection speed; negative damps */"
        in text
    )
    (tmp_path / "law.h").write_text(
        text.replace("#define LAW_K_B (-0.8)", "#define LAW_K_B (-0.4)"), "utf-8"
    )
    import jaxsim.tree

    other = jaxsim.tree.replace(law.law, {"K_B": -0.4})
    python = _run_python(
        Sampled(other, PERIOD, 0.0, law.sensors), ratios, _readings(1, ratios, 500), jnp.float64
    )
    mine = _run_c(tmp_path, step, 1, table)[:, :1]
    assert np.abs(mine - python).max() <= DOUBLE * np.abs(python).max()


def test_limits_stand_in_the_header_with_their_units(tmp_path: Path) -> None:
    law, ratios = _clipped()
    write_c(tmp_path, law, ratios, {})
    text = (tmp_path / "law.h").read_text("utf-8")
    assert text.startswith("/* Cascade of gearlash, run every 0.0004 s.")
    assert "#define LAW_limit 1.5 /* V; largest control signal of either sign */" in text
    supply = Supply(48.0)
    drive = load("leg_torque").drive
    motor = dataclasses.replace(drive.motor[0], supply=supply)
    with_supply = dataclasses.replace(drive, motor=(motor,))
    assert _limits(with_supply) == {
        "limit of command": "48 V of either sign, at the study's supply"
    }
    assert _limits(load("bench_switched").drive) == {}


def test_what_no_target_can_run_is_refused(tmp_path: Path) -> None:
    law, ratios = _bench()
    with pytest.raises(InputError, match="without noise"):
        write_c(tmp_path, Sampled(law.law, PERIOD, 0.0, Noisy(law.sensors)), ratios, {})
    with pytest.raises(InputError, match="must be given for a continuous law"):
        sampled_at(law.law, None)
    with pytest.raises(InputError, match="law's own period"):
        sampled_at(law, 1e-3)
    with pytest.raises(InputError, match="must divide the policy's period"):
        sampled_at(policy(), 0.4 * PERIOD)
