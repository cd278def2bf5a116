"""The piecewise affine form against (1)-(5), (9)-(19) of the 2018 paper and (20)-(23)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm

from jaxsim import pwa
from jaxsim._simulate import simulate
from jaxsim.drive import Drive
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.drives.two_link_arm_2014 import two_link_arm_2014
from jaxsim.errors import InputError
from jaxsim.law import Law
from jaxsim.laws.linear_damping import LinearDamping
from jaxsim.laws.pd import PD
from jaxsim.laws.prefilter import Prefilter
from jaxsim.laws.switched_damping import SwitchedDamping
from jaxsim.loads.inertia import Inertia
from jaxsim.loads.pendulum import Pendulum
from jaxsim.motors.ideal import Ideal
from jaxsim.pwa import PiecewiseAffine
from jaxsim.sampled import Sampled
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.transmissions.backlash import Backlash
from jaxsim.transmissions.nordin import Nordin

ROUNDING = 1e-12  # relative to the largest entry of what is compared
SIDES = (0, 1, -1)  # i = 0, 1, 2 of (5)


@dataclass
class Numbers:
    J_M: float
    D_M: float
    K: float
    D_B: float
    J_L: float
    D_L: float
    half_gap: float
    K_P: float
    K_D: float
    tau_D: float
    K_B: float
    cutoff: float


def random_numbers(seed: int) -> Numbers:
    typical = (9e-4, 9e-2, 300.0, 0.1, 9e-4, 4e-2, 8e-3, 10.0, 0.05, 6e-3, -0.8, 20.0)
    factors = 10.0 ** np.random.default_rng(seed).uniform(-0.5, 0.5, len(typical))
    return Numbers(*(f * t for f, t in zip(factors, typical, strict=True)))


def drive_of(p: Numbers) -> Drive:
    return Drive(
        Ideal(p.J_M, p.D_M), Backlash(p.K, p.half_gap, p.D_B), Inertia(p.J_L, p.D_L)
    )  # fmt: skip


def law_of(p: Numbers, damping: type[Law] = SwitchedDamping) -> Law:
    return Prefilter(PD(p.K_P, p.K_D, p.tau_D) + damping(p.K_B), cutoff=p.cutoff)


def equations(p: Numbers, side: int, x: np.ndarray, T_M: float, d_L: float) -> np.ndarray:
    """(1)-(5) in mode `side`, d/dt of [omega_L, omega_B, theta_L, theta_B]."""
    omega_L, omega_B, _, theta_B = x[:4]
    omega_M = omega_B + omega_L
    T_s = abs(side) * (p.D_B * omega_B + p.K * (theta_B - side * p.half_gap))
    domega_M = (T_M - T_s - p.D_M * omega_M) / p.J_M
    domega_L = (T_s + d_L - p.D_L * omega_L) / p.J_L
    return np.array([domega_L, domega_M - domega_L, omega_L, omega_B])


def closed_equations(p: Numbers, side: int, damped: bool, x: np.ndarray, u: np.ndarray):
    """The same under (20)-(23): x = [paper's four, r, z], u = [theta_Lref, d_L]."""
    r, z = x[4:]
    error = r - x[2]
    T_M = p.K_P * error + p.K_D * (error - z) / p.tau_D + damped * p.K_B * x[1]
    filters = [2.0 * np.pi * p.cutoff * (u[0] - r), (error - z) / p.tau_D]
    return np.r_[equations(p, side, x, T_M, u[1]), filters]


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    expected = np.asarray(expected, dtype=float)
    assert found.shape == expected.shape
    assert np.max(np.abs(found - expected)) <= ROUNDING * np.max(np.abs(expected))


def sorted_rows(G: np.ndarray, g: np.ndarray) -> np.ndarray:
    table = np.c_[G, g]
    return table[np.lexsort(table.T)]


@pytest.mark.parametrize("seed", range(3))
def test_plant_is_the_paper_s_9_to_19_with_12_corrected(seed: int) -> None:
    p = random_numbers(seed)
    form = pwa.plant(drive_of(p))
    J = 1 / p.J_M + 1 / p.J_L
    A_0 = [
        [-p.D_L / p.J_L, 0, 0, 0],
        [-p.D_M / p.J_M + p.D_L / p.J_L, -p.D_M / p.J_M, 0, 0],
        [1, 0, 0, 0],
        [0, 1, 0, 0],
    ]
    A_1 = np.array(A_0)
    A_1[:2, [1, 3]] += np.outer([1 / p.J_L, -J], [p.D_B, p.K])  # with the corrected entries
    a_1 = p.K * p.half_gap * np.array([-1 / p.J_L, J, 0, 0])
    e = np.eye(4)[3]
    gap, plus, minus = form.cells
    assert [c.name for c in form.cells] == ["gap", "contact+", "contact-"]
    for cell, A, a in ((gap, A_0, 0 * a_1), (plus, A_1, a_1), (minus, A_1, -a_1)):
        assert_same(cell.A, A)
        assert_same(cell.a, a)
    assert_same(form.B, [[0, 1 / p.J_L], [1 / p.J_M, -1 / p.J_L], [0, 0], [0, 0]])  # (19)
    b = p.half_gap
    for cell, G, g in ((gap, [e, -e], [b, b]), (plus, [e], [-b]), (minus, [-e], [-b])):
        assert_same(sorted_rows(cell.G, cell.g), sorted_rows(np.array(G), np.array(g)))  # (10)-(17)
    for cell, F, f in ((gap, e, 0), (plus, 0 * e, b), (minus, 0 * e, -b)):
        assert_same(cell.F, F[None])  # (11), (15), (18)
        assert_same(cell.f, np.array([f]))


@pytest.mark.parametrize("seed", range(3))
def test_plant_obeys_1_to_5_wherever_it_is_located(seed: int) -> None:
    p, rng = random_numbers(seed), np.random.default_rng(100 + seed)
    form = pwa.plant(drive_of(p))
    for side in SIDES:
        x = rng.normal(size=4)
        x[3] = p.half_gap * (rng.uniform(-0.9, 0.9) if side == 0 else side * rng.uniform(1.1, 3))
        u = rng.normal(size=2)
        cell = form.cells[form.locate(x)]
        assert cell.mode == {0: "gap", 1: "contact+", -1: "contact-"}[side]
        assert np.all(cell.G @ x + cell.g >= 0.0)
        assert_same(cell.A @ x + cell.a + form.B @ u, equations(p, side, x, *u))


@pytest.mark.parametrize("seed", range(2))
def test_closed_loop_has_12_cells_that_obey_20_to_23(seed: int) -> None:
    p, rng = random_numbers(seed), np.random.default_rng(200 + seed)
    form = pwa.closed_loop(drive_of(p), law_of(p))
    assert form.states == ("omega_L", "omega_B", "theta_L", "theta_B", "law_0", "law_1")
    assert len(form.cells) == 12
    seen = set()
    for side, sign_B, sign_L in itertools.product(SIDES, (1, -1), (1, -1)):
        x = np.abs(rng.normal(size=6)) * [sign_L, sign_B, 1, 1, 1, 1]
        x[3] = p.half_gap * (rng.uniform(-0.9, 0.9) if side == 0 else side * rng.uniform(1.1, 3))
        index, u = form.locate(x), rng.normal(size=2)
        cell, damped = form.cells[index], sign_B * sign_L >= 0
        contact = {0: "gap", 1: "contact+", -1: "contact-"}[side]
        assert cell.mode == f"{contact} {'damped' if damped else 'undamped'}"
        assert [i for i, c in enumerate(form.cells) if np.all(c.G @ x + c.g >= 0)] == [index]
        found = cell.A @ x + cell.a + form.B @ u
        assert_same(found, closed_equations(p, side, damped, x, u))
        seen.add(index)
    assert len(seen) == 12


def test_boundaries_belong_to_contact_and_to_the_damped_law() -> None:
    p = random_numbers(5)
    form = pwa.closed_loop(drive_of(p), law_of(p))

    def mode(omega_L: float, omega_B: float, theta_B: float) -> str:
        return form.cells[form.locate(np.array([omega_L, omega_B, 0, theta_B, 0, 0]))].mode

    assert mode(1.0, 1.0, p.half_gap) == "contact+ damped"  # (5)
    assert mode(1.0, -1.0, -p.half_gap) == "contact- undamped"
    for omega_B in (1.0, -1.0):
        assert mode(0.0, omega_B, 0.0) == "gap damped"  # the equality in (23)
        assert mode(0.0, omega_B, p.half_gap) == "contact+ damped"
    assert mode(0.0, 0.0, 0.0) == "gap damped"


def pairs(form: PiecewiseAffine, surface: int):
    """Neighbours: cells that differ in the sign of one surface only."""
    for c, d in itertools.combinations(form.cells, 2):
        if [k for k, s in enumerate(c.signs) if s != d.signs[k]] == [surface]:
            yield c, d


def on_boundary(form: PiecewiseAffine, surface: int, c, d, rng) -> np.ndarray:
    """A point in both closed cells."""
    row, offset = form.H[surface], form.h[surface]
    size = np.ones(len(form.states))
    size[3] = np.max(np.abs(form.h))  # theta_B, of the size of the gap
    for _ in range(1000):
        x = size * rng.normal(size=len(form.states))
        x -= (row @ x + offset) / (row @ row) * row
        inside = [k for k in range(len(form.h)) if k != surface]
        if all(s.signs[k] * (form.H[k] @ x + form.h[k]) >= 0 for s in (c, d) for k in inside):
            return x
    raise AssertionError("no common point found")


@pytest.mark.parametrize("closed", [False, True])
def test_continuity_data_match_on_every_boundary(closed: bool) -> None:
    """(8); with a rank that carries no Lyapunov argument, as the errata say."""
    p, rng = random_numbers(7), np.random.default_rng(7)
    drive = drive_of(p)
    form = pwa.closed_loop(drive, law_of(p)) if closed else pwa.plant(drive)
    count = 0
    for surface in range(len(form.surfaces)):
        for c, d in pairs(form, surface):
            x = on_boundary(form, surface, c, d, rng)
            np.testing.assert_allclose(c.F @ x + c.f, d.F @ x + d.f, rtol=0, atol=ROUNDING)
            assert np.any(c.F != d.F)
            count += 1
    assert count == (20 if closed else 2)  # 2 walls x 4 + 2 speeds x 6
    n = len(form.states)
    for c in form.cells:
        assert c.F.shape == (3 if closed else 1, n)
        assert np.linalg.matrix_rank(c.F) < n


def test_the_field_jumps_by_the_damping_torque_on_the_walls() -> None:
    """The cells are closed in (7), yet T_s jumps by D_B omega_B on +-half_gap; nowhere else."""
    p = random_numbers(11)
    gap, plus, minus = pwa.plant(drive_of(p)).cells
    for cell, side in ((plus, 1), (minus, -1)):
        x = np.array([0.3, 1.7, 0.2, side * p.half_gap])
        jump = (cell.A - gap.A) @ x + cell.a - gap.a
        shares = np.array([1 / p.J_L, -1 / p.J_M - 1 / p.J_L, 0, 0])
        assert np.max(np.abs(jump - p.D_B * 1.7 * shares)) < ROUNDING * np.max(np.abs(cell.A))
        x[1] = 0.0
        jump = (cell.A - gap.A) @ x + cell.a - gap.a
        assert np.max(np.abs(jump)) < ROUNDING * np.max(np.abs(cell.a))


def test_poles_per_mode() -> None:
    p = random_numbers(13)
    found = pwa.plant(drive_of(p)).poles()
    assert list(found) == ["gap", "contact+", "contact-"]
    gap = np.sort([0.0, 0.0, -p.D_L / p.J_L, -p.D_M / p.J_M])
    np.testing.assert_allclose(np.sort(found["gap"].real), gap, rtol=1e-9, atol=1e-9)
    # Two inertias on a spring: J_M J_L s^3 + ... without the rigid mode's zero.
    D = p.D_M + p.D_L
    cubic = [
        p.J_M * p.J_L,
        p.J_M * (p.D_L + p.D_B) + p.J_L * (p.D_M + p.D_B),
        (p.J_M + p.J_L) * p.K + p.D_B * D + p.D_M * p.D_L,
        D * p.K,
    ]
    expected = np.sort_complex(np.r_[np.roots(cubic), 0.0])
    np.testing.assert_allclose(np.sort_complex(found["contact+"]), expected, rtol=1e-8, atol=1e-8)


def test_modes_of_the_three_laws() -> None:
    p = random_numbers(17)
    sides = ["gap", "contact+", "contact-"]
    linear = pwa.closed_loop(drive_of(p), law_of(p, LinearDamping)).poles()
    assert list(linear) == [f"{s} damped" for s in sides]
    p.K_B = 0.0
    none = pwa.closed_loop(drive_of(p), law_of(p, LinearDamping)).poles()
    assert list(none) == [f"{s} undamped" for s in sides]
    p = random_numbers(17)
    switched = pwa.closed_loop(drive_of(p), law_of(p)).poles()
    assert set(switched) == set(linear) | set(none)
    for name, values in switched.items():
        np.testing.assert_allclose(values, {**linear, **none}[name], rtol=1e-9, atol=1e-9)


def test_the_engine_moves_as_the_cell_says() -> None:
    """A short run in the gap and in contact against the matrix exponential of its cell."""
    drive = bench_2018()
    law = Prefilter(PD(10.0, 0.05, 6e-3) + LinearDamping(-0.8))
    form, h = pwa.closed_loop(drive, law), 1e-3
    for theta_B in (0.0, 0.010):
        start = Start(theta_L=0.1, omega_L=0.2, theta_B=theta_B, omega_B=-0.5)
        scenario = Scenario(Constant(0.3), Constant(-0.1), start, duration=h)
        run = simulate(drive, law, scenario, dt=1e-5, metrics=())
        x = np.array([0.2, -0.5, 0.1, theta_B, 0.3, 0.2])
        cell = form.cells[form.locate(x)]
        M = np.zeros((7, 7))
        M[:6] = np.c_[cell.A, cell.a + form.B @ [0.3, -0.1]]
        expected = (expm(M * h) @ np.r_[x, 1.0])[:4]
        for name, value in zip(form.states[:4], expected, strict=True):
            assert run.signals[name][-1] == pytest.approx(value, rel=1e-9, abs=1e-12), name


def test_no_pull_and_no_gap_have_their_cells() -> None:
    p = random_numbers(19)
    joint = Backlash(p.K, p.half_gap, p.D_B, no_pull=True)
    form = pwa.plant(Drive(Ideal(p.J_M, p.D_M), joint, Inertia(p.J_L, p.D_L)))
    x = np.array([0.0, -2.0 * p.K / p.D_B * 1e-4, 0.0, p.half_gap + 1e-4])  # it would pull
    cell = form.cells[form.locate(x)]
    assert cell.mode == "contact+"
    assert "push+ < 0" in cell.name
    assert_same(cell.A @ x + cell.a, equations(p, 0, x, 0.0, 0.0))
    rigid = Backlash(p.K, 0.0, p.D_B)
    form = pwa.plant(Drive(Ideal(p.J_M, p.D_M), rigid, Inertia(p.J_L, p.D_L)))
    assert [c.mode for c in form.cells] == ["contact+", "contact-"]
    assert_same(form.cells[0].A, form.cells[1].A)


def test_a_ratio_and_a_voltage_motor() -> None:
    """N = 50: theta_B and omega_B are on the load side; the motor's inertia there is N^2 J_M."""
    p, N = random_numbers(23), 50.0
    joint = Backlash(p.K, p.half_gap, p.D_B, N=N)
    geared = pwa.plant(Drive(Ideal(p.J_M / N**2, p.D_M / N**2), joint, Inertia(p.J_L, p.D_L)))
    direct = pwa.plant(drive_of(p))
    for one, other in zip(geared.cells, direct.cells, strict=True):
        assert_same(one.A, other.A)
    assert_same(geared.B, direct.B * [N, 1.0])


class Pulling(Law):
    """Not affine: T_M = theta_L^2."""

    def command(self, state, y, switches):
        return y.theta_L**2


def test_what_is_not_affine_is_refused_by_name() -> None:
    bench = bench_2018()
    swinging = Drive(bench.motor, bench.transmission, Pendulum(mass=1.0, length=0.1, rod=0.0))
    with pytest.raises(InputError, match=r"drive: must be affine in each mode; got Pendulum"):
        pwa.plant(swinging)
    with pytest.raises(InputError, match=r"drive: must be affine"):
        pwa.closed_loop(swinging, LinearDamping(-0.8))
    with pytest.raises(InputError, match=r"law: must be affine in each mode; got Pulling"):
        pwa.closed_loop(bench, Pulling())
    physical = Drive(bench.motor, Nordin(300.0, 7.8e-3, 0.1), bench.load)
    with pytest.raises(InputError, match="surfaces must depend on the state only"):
        pwa.plant(physical)
    with pytest.raises(InputError, match="must be continuous"):
        pwa.closed_loop(bench, Sampled(LinearDamping(-0.8), period=4e-4))
    with pytest.raises(InputError, match="x: must be 4 finite numbers"):
        pwa.plant(bench).locate(np.array([0.0, 0.0, np.nan, 0.0]))


def test_several_axes_are_refused() -> None:
    with pytest.raises(InputError, match="drive: must have one axis"):
        pwa.plant(two_link_arm_2014())
