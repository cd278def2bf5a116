"""Poles and margins of sampled loops against closed forms and the law's own turn at samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.linalg import expm

from jaxsim import tree
from jaxsim._simulate import simulate
from jaxsim.criterion import Subject, chosen
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.law import Measured
from jaxsim.laws.linear_damping import LinearDamping
from jaxsim.linear.linearise import linearise
from jaxsim.linear.period import exponential
from jaxsim.loop import ClosedLoop
from jaxsim.sampled import Differences, Encoders, Noisy, Sampled, TrueSpeeds
from jaxsim.study import Study, load

T = 4e-4
# Of z: what remembers is let fade by 1e-9 (see `jaxsim.linear.period`).
SAME = 1e-8


@pytest.fixture(scope="module")
def bench() -> Study:
    return load("bench_sampled")


def measure(study: Study, law: Any, names: tuple[str, ...]) -> Any:
    """Criteria of the loop, without a run."""

    def never(scenario: Any, names: Any) -> dict[str, Any]:
        raise AssertionError("no run is needed")

    subject = Subject(ClosedLoop(study.drive, law, study.scenario, Exact(), 2e-4), never)
    found: dict[str, Any] = {}
    for group in chosen(names, ()):
        found |= group().measure(subject)
    return jnp.stack([jnp.ravel(found[name])[0] for name in names])


@eqx.filter_jit
def _measured(study: tuple[Any, Any], law: Any, names: tuple[str, ...]) -> Any:
    own = load("bench_sampled")._replace(drive=study[0], scenario=study[1])
    return measure(own, law, names)


def numbers(study: Study, law: Any, *names: str) -> list[float]:
    return _measured((study.drive, study.scenario), law, names).tolist()


def z_of(rate: float) -> float:
    """|z| of the rightmost pole."""
    return float(np.exp(T * rate))


def test_exponential_is_scipys_and_its_slope_a_difference() -> None:
    M = np.random.default_rng(0).normal(size=(6, 6)) * 30.0
    M -= 80.0 * np.eye(6)
    np.testing.assert_allclose(exponential(jnp.asarray(M)), expm(M), rtol=1e-9, atol=1e-12)
    N, h = np.random.default_rng(1).normal(size=(6, 6)), 1e-5
    slope = jax.jvp(exponential, (jnp.asarray(M),), (jnp.asarray(N),))[1]
    difference = (expm(M + h * N) - expm(M - h * N)) / (2.0 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize(
    ("late", "sensors"), [(0.0, TrueSpeeds()), (T, TrueSpeeds()), (2e-4, Differences())]
)
def test_the_motor_in_the_gap_has_its_poles_in_closed_form(
    bench: Study, late: float, sensors: Any
) -> None:
    """J omega' = K_B omega - D omega with a held command: a polynomial in z."""
    K_B = -0.9
    J, D = (float(tree.get(bench.drive, n)) for n in ("J_M", "D_M"))
    a, b = np.exp(-D * T / J), -np.expm1(-D * T / J) / D
    # A command that comes late acts b_0 in its own period and b_1 in the next.
    b_0 = -np.expm1(-D * (T - late) / J) / D
    b_1 = a * (1.0 - np.exp(D * late / J)) / -D
    assert b_0 + b_1 == pytest.approx(b)
    if isinstance(sensors, TrueSpeeds):
        wanted = [1.0, -a - K_B * b_0, -K_B * b_1]
    else:
        # theta+ = theta + g omega + (h_0 c + h_1 c_before), seen (theta - theta_before)/T.
        g = -np.expm1(-D * T / J) * J / D
        h_0 = ((T - late) - -np.expm1(-D * (T - late) / J) * J / D) / D
        h = (T - g) / D
        h_1 = h - h_0
        A = np.zeros((4, 4))  # omega, moved, command before, spare
        k = K_B / T
        A[0] = [a, k * b_0, b_1, 0.0]
        A[1] = [g, k * h_0, h_1, 0.0]
        A[2] = [0.0, k, 0.0, 0.0]
        wanted = np.poly(A)
    law = Sampled(LinearDamping(K_B), T, late, sensors)
    (rate,) = numbers(bench, law, "rightmost_gap_pole_per_s")
    assert z_of(rate) == pytest.approx(np.abs(np.roots(wanted)).max(), rel=SAME)


def turn(study: Study, law: Sampled, gains: float = 1.0) -> np.ndarray:
    """The map over one period, all states kept: `Sampled.on_tick` differentiated, SciPy's expm."""
    drive = linearise(study.drive, 0.3, contact=1).system
    n, dt = len(drive.A), 2e-4
    grown = expm(dt * np.block([[drive.A, drive.B[:, :1]], [np.zeros((1, n + 1))]]))
    loop = ClosedLoop(study.drive, law, study.scenario, Exact(), dt)
    rows = [drive.outputs.index(name) for name in Measured._fields]
    # Moving in the same direction: the switch stays where it is.
    x0 = jnp.array([0.3, 0.5, 0.01, 40.0])
    base = jnp.asarray(drive.C[rows]) @ x0
    start = law.start((Measured(*base),), dt)
    held0, unravel = ravel_pytree(start)

    def period(X: Any) -> Any:
        x, held = X[:n], unravel(X[n:])
        for tick in (0, 1):
            y = Measured(*(jnp.asarray(drive.C[rows]) @ x))
            held = law.on_tick(jnp.asarray(tick), (y,), held, loop.ratios, dt)
            (command,) = held.command
            x = jnp.asarray(grown[:n, :n]) @ x + jnp.asarray(grown[:n, n]) * command
        return jnp.concatenate([x, ravel_pytree(held)[0]])

    return np.asarray(jax.jacfwd(period)(jnp.concatenate([x0, held0])))


@pytest.mark.parametrize(
    ("late", "sensors"), [(0.0, Differences()), (2e-4, TrueSpeeds()), (1e-3, Differences())]
)
def test_poles_in_contact_are_those_of_the_law_as_it_runs(
    bench: Study, late: float, sensors: Any
) -> None:
    # Linear damping: one setting, so that the mode seen here is the one that counts.
    inner = tree.replace(load("bench_linear_kb").law, {"K_B": -0.5})
    law = Sampled(inner, T, late, sensors)
    z = np.linalg.eigvals(turn(bench, law))
    rate, damping = numbers(bench, law, "rightmost_pole_per_s", "least_damping")
    assert z_of(rate) == pytest.approx(np.abs(z).max(), rel=SAME)
    s = np.log(z[np.abs(z) > 1e-6]) / T
    assert damping == pytest.approx((-s.real / np.abs(s)).min(), rel=1e-6)


@pytest.mark.parametrize("late", [pytest.param(0.0, marks=pytest.mark.slow), T])
def test_at_its_gain_margin_a_sampled_loop_is_about_to_be_unstable(
    bench: Study, late: float
) -> None:
    inner = tree.replace(load("bench_linear_kb").law, {"K_B": -0.5})

    def scaled(factor: float) -> Sampled:
        own = {n: factor * tree.get(inner, n) for n in ("K_P", "K_D", "K_B")}
        return Sampled(tree.replace(inner, own), T, late, Differences())

    (margin,) = numbers(bench, scaled(1.0), "gain_margin_dB")
    assert 1.0 < margin < 20.0
    for step in (0.99, 1.01):
        factor = step * 10.0 ** (margin / 20.0)
        radius = np.abs(np.linalg.eigvals(turn(bench, scaled(factor)))).max()
        assert (radius > 1.0) == (step > 1.0)
        found = numbers(bench, scaled(factor), "gain_margin_dB", "phase_margin_deg")
        assert found[0] == pytest.approx(-20.0 * np.log10(step), rel=1e-5)
        assert (found[1] > 0.0) == (step < 1.0)


def test_a_loop_that_turns_unstable_at_half_the_sampling_rate(bench: Study) -> None:
    """z = -1: the motor in its gap under K_B alone, a - |K_B| b = -1."""
    J, D = (float(tree.get(bench.drive, n)) for n in ("J_M", "D_M"))
    a, b = np.exp(-D * T / J), -np.expm1(-D * T / J) / D
    edge = -(1.0 + a) / b
    for share in (0.999, 1.001):
        law = Sampled(LinearDamping(share * edge), T)
        (rate,) = numbers(bench, law, "rightmost_gap_pole_per_s")
        assert (rate > 0.0) == (share > 1.0)


def test_gradients_are_the_differences_and_rounding_is_left_out(bench: Study) -> None:
    names = ("rightmost_pole_per_s", "gain_margin_dB", "phase_margin_deg")

    def found(p: Any) -> Any:
        law = tree.replace(bench.law, {"K_D": p[0], "K_B": p[1], "cutoff": p[2]})
        return measure(bench, law, names)

    compiled = jax.jit(found)
    at, size = jnp.array([0.05, -0.7, 20.0]), np.array([0.05, 0.7, 20.0])
    slopes, h = jax.jit(jax.jacfwd(found))(at), 1e-5
    for k, move in enumerate(h * np.diag(size)):
        difference = (compiled(at + move) - compiled(at - move)) / (2.0 * h * size[k])
        np.testing.assert_allclose(slopes[:, k], difference, rtol=2e-5, atol=1e-6)
    assert (np.abs(slopes[:, :2]) > 1e-3).all()
    # Encoders and noise are what their exact readings make of them.
    noisy = replace(bench.law, sensors=Noisy(Encoders(2**12), angle_noise=1e-4))
    exact = replace(bench.law, sensors=Differences())
    assert numbers(bench, noisy, *names) == numbers(bench, exact, *names)


def test_what_has_no_poles_at_samples_says_so(bench: Study) -> None:
    arm = load("arm_torque")
    law = Sampled(arm.law, 5e-4)
    with pytest.raises(InputError, match="use gain_margin_dB"):
        simulate(arm.drive, law, arm.scenario, dt=5e-4, metrics=("torque_gain_margin_dB",))
