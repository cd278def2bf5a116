"""Nordin's exact model against scipy: piecewise modes, events located by DOP853."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.errors import InputError
from jaxsim.hybrid import Plain
from jaxsim.law import Law
from jaxsim.laws.linear_damping import LinearDamping
from jaxsim.laws.pd import PD
from jaxsim.laws.prefilter import Prefilter
from jaxsim.laws.switched_damping import SwitchedDamping
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.signals.step import Step
from jaxsim.transmissions.backlash import Backlash
from jaxsim.transmissions.nordin import Nordin

# At dt = 2e-4: the fourth-order step leaves 3e-6 in a peak, more in what comes after many events.
VALUES = 1e-5
# Relative L2 error of a gradient; the step that finite differences of the oracle leave is 1e-7.
GRADIENTS = 1e-3
# Located events against the oracle's, s.
TIMES = 1e-7

THETA_L, OMEGA_L, THETA_B, OMEGA_B, INSIDE, Z, R, ITAE = range(8)


@dataclass(frozen=True)
class Bench:
    """Table II of the 2018 paper and the design of the errata."""

    J_M: float = 8.78e-4
    D_M: float = 9.30e-2
    K: float = 3.00e2
    D_B: float = 1.00e-1
    J_L: float = 8.78e-4
    D_L: float = 3.60e-2
    half_gap: float = 7.80e-3
    K_P: float = 10.28129662037006
    K_D: float = 0.05470907749696041
    tau_D: float = 5.82812354062619e-3
    K_B: float = -0.80
    switched: bool = False
    step: float = 0.30
    onset: float = 0.010


class Mode(NamedTuple):
    side: int  # of the wall that is touched, 0 in play
    sign_B: int
    sign_L: int
    sign_e: int


class Segment(NamedTuple):
    mode: Mode
    dense: Any
    t0: float
    t1: float


class Oracle:
    """The step from rest or from a start, mode by mode."""

    def __init__(self, bench: Bench, start: tuple[float, ...] = (0.0,) * 4, duration: float = 0.3):
        self.b, self.segments = bench, []
        theta_B = start[2]
        inside = float(np.clip(theta_B, -bench.half_gap, bench.half_gap))
        x = np.array([*start, inside, -start[0], 0.0, 0.0])
        side = int(np.sign(inside)) if abs(inside) == bench.half_gap else 0
        if side and side * self._push(x, side) < 0.0:
            side = 0
        mode = Mode(side, int(np.sign(start[3])), int(np.sign(start[1])), 1)
        for t0, t1, reference in ((0.0, bench.onset, 0.0), (bench.onset, duration, bench.step)):
            # At rest omega_B has no sign until the step moves the motor.
            mode = mode._replace(sign_B=mode.sign_B or int(np.sign(reference)))
            x, mode = self._through(x, mode, t0, t1, reference)

    def _push(self, x: np.ndarray, side: int) -> float:
        """T_s while the wall on `side` is touched."""
        return self.b.K * (x[THETA_B] - side * self.b.half_gap) + self.b.D_B * x[OMEGA_B]

    def _field(self, t: float, x: np.ndarray, mode: Mode, reference: float) -> np.ndarray:
        b = self.b
        T_s = self._push(x, mode.side) if mode.side else 0.0
        error = x[R] - x[THETA_L]
        damped = not b.switched or mode.sign_B * mode.sign_L >= 0
        T_M = b.K_P * error + b.K_D * (error - x[Z]) / b.tau_D + damped * b.K_B * x[OMEGA_B]
        domega_L = (T_s - b.D_L * x[OMEGA_L]) / b.J_L
        domega_M = (T_M - b.D_M * (x[OMEGA_L] + x[OMEGA_B]) - T_s) / b.J_M
        slip = 0.0 if mode.side else x[OMEGA_B] + b.K / b.D_B * (x[THETA_B] - x[INSIDE])
        itae = (t - b.onset) * mode.sign_e * (b.step - x[THETA_L]) * (t >= b.onset)
        return np.array(
            [
                x[OMEGA_L],
                domega_L,
                x[OMEGA_B],
                domega_M - domega_L,
                slip,
                (error - x[Z]) / b.tau_D,
                2 * np.pi * 20.0 * (reference - x[R]),
                itae,
            ]
        )

    def _events(self, mode: Mode) -> list[tuple[Callable, Mode]]:
        """Functions that are positive while the mode lasts, and the mode that follows."""
        b = self.b
        if mode.side:
            found = [(lambda t, x: mode.side * self._push(x, mode.side), mode._replace(side=0))]
        else:
            found = [
                (
                    lambda t, x, s=s: b.half_gap - s * x[INSIDE],
                    mode._replace(side=s, sign_L=mode.sign_L or s),
                )
                for s in (1, -1)
            ]
        signed = {"sign_e": lambda x: b.step - x[THETA_L]}
        if b.switched:
            signed |= {"sign_B": lambda x: x[OMEGA_B], "sign_L": lambda x: x[OMEGA_L]}
        for name, of in signed.items():
            sign = getattr(mode, name)
            if sign:
                after = mode._replace(**{name: -sign})
                found.append((lambda t, x, f=of, s=sign: s * f(x), after))
        return found

    def _through(
        self, x: np.ndarray, mode: Mode, t: float, t1: float, reference: float
    ) -> tuple[np.ndarray, Mode]:
        """From t to t1 under a constant reference."""
        while t < t1:
            events = self._events(mode)
            for function, _ in events:
                function.terminal, function.direction = True, -1.0  # type: ignore[attr-defined]
            solution = solve_ivp(
                lambda t, x, m=mode: self._field(t, x, m, reference),
                (t, t1), x, "DOP853", dense_output=True, events=[f for f, _ in events],
                rtol=1e-11, atol=1e-14, max_step=2e-3,
            )  # fmt: skip
            self.segments.append(Segment(mode, solution.sol, t, solution.t[-1]))
            t, x = solution.t[-1], solution.y[:, -1].copy()
            for (_, after), times in zip(events, solution.t_events, strict=True):
                if len(times):
                    if after.side and not mode.side:
                        x[INSIDE] = after.side * self.b.half_gap
                    mode = after
        return x, mode

    def contacts(self) -> list[tuple[int, list[Segment]]]:
        """Side and segments of each contact, in order."""
        runs = itertools.groupby(self.segments, key=lambda s: s.mode.side)
        return [(side, list(segments)) for side, segments in runs if side]

    def peak(self, segments: list[Segment], of: Callable) -> float:
        """The largest value over some segments, polished between the points of a fine grid."""
        best = -np.inf
        for s in segments:
            grid = np.linspace(s.t0, s.t1, 200)
            values = of(s.dense(grid))
            k = int(np.argmax(values))
            low, high = grid[max(k - 1, 0)], grid[min(k + 1, 199)]
            top = minimize_scalar(
                lambda t, s=s: -of(s.dense(t)), bounds=(low, high), options={"xatol": 1e-12}
            )
            best = max(best, float(values[k]), -float(top.fun))
        return best

    def metrics(self) -> dict[str, float]:
        """The names of the metrics of a run."""
        first_side, first = self.contacts()[0]
        side, braking = next(c for c in self.contacts() if c[0] != first_side)
        peaks = [self.peak(c, lambda x, s=s: s * self._push(x, s))
                 for s, c in ((first_side, first), (side, braking))]  # fmt: skip
        return {
            "entry_speed_rad_s": first[0].dense(first[0].t0)[OMEGA_B],
            "first_impact_Nm": first_side * peaks[0],
            "first_separation_s": first[-1].t1,
            "braking_contact_s": braking[0].t0,
            "braking_peak_Nm": side * peaks[1],
            "theta_max_rad": self.peak(self.segments, lambda x: x[THETA_L]),
            "itae_rad_s2": self.segments[-1].dense(self.segments[-1].t1)[ITAE],
        }

    def at(self, t: np.ndarray) -> np.ndarray:
        """theta_L, omega_L, theta_B, omega_B at the times t, (4, n)."""
        ends = np.array([s.t1 for s in self.segments])
        which = np.minimum(np.searchsorted(ends, t), len(ends) - 1)
        return np.stack(
            [self.segments[i].dense(time)[:4] for i, time in zip(which, t, strict=True)], axis=1
        )


def drive(bench: Bench, transmission: type = Nordin, **options: bool) -> Drive:
    preset = bench_2018()
    joint = transmission(K=bench.K, half_gap=bench.half_gap, D_B=bench.D_B, **options)
    return Drive(preset.motor, joint, preset.load)


def law(bench: Bench) -> Law:
    damping = SwitchedDamping(bench.K_B) if bench.switched else LinearDamping(bench.K_B)
    return Prefilter(PD(bench.K_P, bench.K_D, bench.tau_D) + damping)


def scenario(bench: Bench, start: tuple[float, ...] = (0.0,) * 4, duration: float = 0.3):
    return Scenario(Step(bench.step, bench.onset), start=Start(*start), duration=duration)


LAWS = {
    "none": Bench(K_B=0.0),
    "linear": Bench(),
    "switched": Bench(switched=True),
}


@pytest.mark.parametrize("name", LAWS)
def test_the_step_agrees_with_the_oracle(name: str) -> None:
    bench = LAWS[name]
    truth = Oracle(bench).metrics()
    run = simulate(drive(bench), law(bench), scenario(bench), metrics=tuple(truth))
    for metric, value in truth.items():
        if metric.endswith("_s") and "speed" not in metric:
            assert run.metrics[metric] == pytest.approx(value, abs=TIMES), metric
        else:
            assert run.metrics[metric] == pytest.approx(value, rel=VALUES), metric


def free_run(joint: Drive, bench: Bench, start: tuple[float, ...] = (0.0,) * 4, d_L: float = 0.0):
    """0.08 s of signals, all with the same shapes so that they are compiled once.

    Speeds jump at contact, so states need a finer step than peaks: 1.2e-5 at 1e-4, 8e-7 here.
    """
    step = Step(bench.step, bench.onset)
    task = Scenario(step, Constant(d_L), Start(*start), duration=0.08)
    return simulate(joint, law(bench), task, dt=5e-5, metrics=())


def test_the_joint_never_pulls_and_is_free_in_play() -> None:
    bench = LAWS["none"]
    run, other = (free_run(joint, bench) for joint in (drive(bench), drive(bench, Backlash)))
    T_s, contact = run.signals["T_s"], run.signals["contact"]
    assert set(np.unique(contact)) == {-1.0, 0.0, 1.0}
    assert np.all(T_s[contact == 0.0] == 0.0)
    assert np.all(T_s * contact >= 0.0)
    pulled = other.signals["T_s"] * other.signals["contact"]
    assert np.min(pulled) < -1e-3  # so the model makes a difference here


GAP = Bench.half_gap
STARTS = {
    "compressed": (0.0, 0.0, 0.010, 0.0),
    "at the wall, leaving": (0.0, 0.0, GAP, -1.0),
    "at the wall, entering": (0.0, 0.0, GAP, 1.0),
    "compressed, but pulled apart": (0.0, 0.5, GAP + 1e-4, -2.0),
    "in play": (0.0, -0.5, -0.004, 1.0),
}


@pytest.mark.parametrize("name", STARTS)
def test_any_start_agrees_with_the_oracle_and_its_mirror_image(name: str) -> None:
    bench, start = replace(LAWS["none"], step=0.05, onset=0.03), STARTS[name]
    run = free_run(drive(bench), bench, start)
    truth = Oracle(bench, start, 0.08).at(np.asarray(run.time))
    for signal, expected in zip(("theta_L", "omega_L", "theta_B", "omega_B"), truth, strict=True):
        scale = np.max(np.abs(expected))
        np.testing.assert_allclose(run.signals[signal], expected, rtol=0, atol=VALUES * scale)
    opposite = tuple(-v for v in start)
    mirror = free_run(drive(bench), replace(bench, step=-bench.step), opposite)
    assert np.array_equal(mirror.signals["T_s"], -run.signals["T_s"])


def test_what_the_damper_takes_is_what_is_missing_at_the_end() -> None:
    """Free inertias pushed apart by the spring: its energy = kinetic energy + impact_loss_J."""
    bench = Bench()
    preset = tree.replace(drive(bench), {"D_M": 0.0, "D_L": 0.0})
    start = (0.0, 0.0, GAP + 2e-3, 0.0)
    still = LinearDamping(0.0)
    task = Scenario(start=Start(*start), duration=0.004)
    run = simulate(preset, still, task, dt=2e-5, metrics=("impact_loss_J",))
    omega_L, omega_M = run.signals["omega_L"][-1], run.signals["omega_M"][-1]
    kinetic = 0.5 * (bench.J_L * omega_L**2 + bench.J_M * omega_M**2)
    assert run.signals["contact"][-1] == 0.0
    stored = 0.5 * bench.K * 2e-3**2
    assert kinetic + run.metrics["impact_loss_J"] == pytest.approx(stored, rel=1e-6)


METRICS = ("first_impact_Nm", "braking_peak_Nm", "theta_max_rad", "itae_rad_s2")
NAMES = ("half_gap", "D_B")
SHORT = 0.1  # s, past the braking peak


def numbers(bench: Bench, values: jax.Array) -> jax.Array:
    changed = tree.replace(drive(bench), dict(zip(NAMES, values, strict=True)))
    task = scenario(bench, duration=SHORT)
    run = simulate(changed, law(bench), task, metrics=METRICS, store=None)
    return jnp.stack([run.metrics[m] for m in METRICS])


def derivative(bench: Bench, mode: Callable) -> np.ndarray:
    """p dM/dp, (metrics, names)."""
    at = jnp.asarray([getattr(bench, n) for n in NAMES])
    return np.asarray(jax.jit(mode(lambda v: numbers(bench, v)))(at)) * np.asarray(at)


@pytest.mark.parametrize("name", [pytest.param("linear", marks=pytest.mark.slow), "switched"])
def test_gradients_agree_with_differences_of_the_oracle(name: str) -> None:
    bench, share = LAWS[name], 1e-4
    found = derivative(bench, jax.jacfwd)
    for column, parameter in zip(found.T, NAMES, strict=True):
        at = getattr(bench, parameter)
        up, down = (
            Oracle(replace(bench, **{parameter: at * (1 + d)}), duration=SHORT).metrics()
            for d in (share, -share)
        )
        for metric, value in zip(METRICS, column, strict=True):
            expected = (up[metric] - down[metric]) / (2 * share)
            assert value == pytest.approx(expected, rel=GRADIENTS), (metric, parameter)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear", "switched"])
def test_forward_mode_is_reverse_mode(name: str) -> None:
    forward, reverse = (derivative(LAWS[name], mode) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)


def test_small_damping_leaves_the_plain_joint_that_cannot_pull() -> None:
    """A rebound that returns within 0.2 ms feels the twist, which takes D_B/K to die out."""
    start, differences = (0.0, 0.0, GAP + 1e-4, -2.0), []
    for D_B in (0.3, 0.1, 0.02):
        bench = replace(LAWS["none"], D_B=D_B, K_P=0.0, K_D=0.0)
        joints = drive(bench), drive(bench, Backlash, no_pull=True)
        runs = (free_run(joint, bench, start, d_L=-20.0) for joint in joints)
        omega_B, limit = (np.asarray(run.signals["omega_B"][:40]) for run in runs)
        differences.append(np.max(np.abs(omega_B - limit)) / np.max(np.abs(limit)))
    assert differences[0] > 4.0 * differences[1] > 16.0 * differences[2] > 0.0
    assert differences[2] < 1e-4


def test_unlocated_runs_carry_no_mode_and_agree_to_the_step() -> None:
    bench = LAWS["linear"]
    truth = Oracle(bench).metrics()
    run = simulate(drive(bench), law(bench), scenario(bench), dt=2e-5, deadzone=Plain(), store=None)
    for metric in ("first_impact_Nm", "braking_peak_Nm", "theta_max_rad"):
        assert run.metrics[metric] == pytest.approx(truth[metric], rel=1e-3), metric


@pytest.mark.parametrize("field", ["K", "half_gap", "D_B", "N"])
def test_rules_of_the_parameters(field: str) -> None:
    values = {"K": 300.0, "half_gap": GAP, "D_B": 0.1, "N": 1.0, field: 0.0}
    with pytest.raises(InputError, match=rf"Nordin\.{field}: must be > 0"):
        Nordin(**values)
