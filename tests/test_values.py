"""Values of the bench of the 2018 paper against the event-accurate oracle."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import bench
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracle
import pytest

from jaxsim import batch, engine
from jaxsim._simulate import simulate
from jaxsim.hybrid import Deadzone, Exact, Plain
from jaxsim.law import Law, Measured
from jaxsim.loop import ClosedLoop
from jaxsim.metric import task_of
from jaxsim.metrics.dissipation import Dissipation
from jaxsim.run import Run
from jaxsim.scenario import Scenario, Start

LAWS = ("none", "linear", "switched")
DT = 2e-4
RANDOM = 200
SPREAD = 0.3

# What issue 2 asks of a run at DT.
RELATIVE, STATE, ORDER = 1e-5, 1e-6, 3.5
# On the way speeds are larger: 13 rad/s. Measured 1.9e-6.
ON_THE_WAY = 5e-6
# Of float32: angles of 0.3 rad carry 3e-8, the deflection 1e-9 rad of 8e-3. Measured: 2e-5 in the
# overshoot, 2e-6 in torques.
SINGLE = 1e-4

# Metrics that issue 2 names, by the oracle's name.
NAMED = (
    "first_entry_wB_rad_s", "first_impact_peak_Nm", "braking_peak_Nm", "largest_torque_Nm",
    "theta_max_rad", "overshoot_pct",
)  # fmt: skip
STATES = ("omega_L", "omega_B", "theta_L", "theta_B")


class Case(NamedTuple):
    """One run: parameters, omega_L, omega_B, theta_L, theta_B at the start, the step, the loads."""

    p: oracle.Params = bench.PAPER
    start: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    step: float = bench.STEP
    loads: tuple[tuple[float, float], ...] = ((0.15, 0.0), (0.2, 0.0))

    def scenario(self, duration: float) -> Scenario:
        omega_L, omega_B, theta_L, theta_B = self.start
        start = Start(theta_L, omega_L, theta_B, omega_B)
        return bench.scenario(duration, step=self.step, start=start, loads=self.loads)


def _solve(kind: oracle.Law, case: Case, duration: float, **options: Any) -> oracle.Solution:
    return oracle.solve(
        case.p, kind, step=case.step, t_step=bench.ONSET, duration=duration,
        start=case.start, loads=case.loads, **options,
    )  # fmt: skip


def _random_sets() -> list[oracle.Params]:
    """Every parameter within +-30 %, the gains too."""
    random = np.random.default_rng(2018)
    names = [n for n in vars(bench.PAPER) if n != "f_ref"]
    return [
        replace(
            bench.PAPER,
            **{n: getattr(bench.PAPER, n) * random.uniform(1 - SPREAD, 1 + SPREAD) for n in names},
        )
        for _ in range(RANDOM)
    ]


IN_GAP, BEYOND = 0.9 * bench.PAPER.half_gap, 1.1 * bench.PAPER.half_gap
CASES = {
    "paper": Case(),
    "negative step": Case(step=-bench.STEP),
    # Section III.E: the second step adds to the first, net +0.5 Nm.
    "disturbed": Case(loads=((0.15, -0.5), (0.2, 1.0))),
    "disturbed from zero": Case(loads=((0.0, -0.5), (0.2, 1.0))),
    "starts in contact": Case(start=(0.0, 0.0, 0.0, BEYOND)),
    "starts on the other side": Case(start=(1.0, -2.0, 0.0, -BEYOND)),
    "starts moving in the gap": Case(start=(-1.0, 3.0, 0.0, -IN_GAP)),
    "no step": Case(step=0.0, start=(2.0, 1.0, 0.0, 0.0)),
} | {f"random {i}": Case(p) for i, p in enumerate(_random_sets())}
PICKED = [name for name in CASES if not name.startswith("random")]
DURATION = 0.3


def _simulate(
    kind: str, cases: list[Case], duration: float, *, no_pull: bool = False, **options: Any
) -> Run:
    return simulate(
        batch.stack([bench.drive(c.p, no_pull=no_pull) for c in cases]),
        batch.stack([bench.law(kind, c.p) for c in cases]),
        batch.stack([c.scenario(duration) for c in cases]),
        metrics=tuple(bench.SAME.values()),
        **options,
    )


@cache
def found(kind: str, dt: float = DT, deadzone: Deadzone | None = None, dtype: Any = None) -> Run:
    """All cases as ONE batch; the signals every 30 ms."""
    every = round(0.03 / dt)
    return _simulate(
        kind, list(CASES.values()), DURATION, dt=dt, deadzone=deadzone, dtype=dtype, store=every
    )


@cache
def expected(kind: oracle.Law, name: str) -> oracle.Solution:
    return _solve(kind, CASES[name], DURATION)


@cache
def expected_metrics(kind: oracle.Law, name: str) -> oracle.Metrics:
    return expected(kind, name).metrics()


def metric_errors(kind: oracle.Law, run: Run, names: Any, wanted: Any = NAMED) -> np.ndarray:
    """(cases, metrics): relative errors; a metric that both leave undefined has none."""
    rows = []
    index = {name: i for i, name in enumerate(CASES)}
    for name in names:
        right = expected_metrics(kind, name)
        ours = [float(run.metrics[bench.SAME[m]][index[name]]) for m in wanted]
        theirs = [float(right[m]) for m in wanted]
        rows.append(
            [
                0.0 if b == 0.0 == a or np.isnan(b) else abs(a - b) / abs(b)
                for a, b in zip(ours, theirs, strict=True)
            ]
        )
    return np.array(rows)


def state_errors(kind: oracle.Law, run: Run, names: Any) -> np.ndarray:
    """(cases, states): at the end of the run."""
    index = [list(CASES).index(name) for name in names]
    ours = np.stack([np.asarray(run.signals[s])[index, -1] for s in STATES], axis=-1)
    return np.abs(ours - np.stack([expected(kind, n).state(DURATION)[:4] for n in names]))


@pytest.mark.parametrize("kind", LAWS)
def test_peaks_speeds_overshoot_and_states_are_those_of_the_oracle(kind: oracle.Law) -> None:
    run = found(kind)
    errors = dict(zip(NAMED, metric_errors(kind, run, ["paper"])[0], strict=True))
    assert max(errors.values()) <= RELATIVE, errors
    assert np.max(state_errors(kind, run, ["paper"])) <= STATE


@pytest.mark.parametrize("kind", LAWS)
@pytest.mark.parametrize("name", PICKED)
def test_scenarios(kind: oracle.Law, name: str) -> None:
    run, i = found(kind), list(CASES).index(name)
    t = np.asarray(run.time[i])[1:]
    right = expected(kind, name).state(t)
    for column, signal in enumerate(STATES):
        seen = np.asarray(run.signals[signal][i])[1:]
        assert seen == pytest.approx(right[:, column], abs=ON_THE_WAY), signal


@pytest.mark.parametrize("kind", LAWS)
def test_all_of_200_random_parameter_sets_complete_in_one_batch(kind: oracle.Law) -> None:
    run = found(kind)
    assert not run.failures()
    random = [name for name in CASES if name.startswith("random")]
    errors = metric_errors(kind, run, random, NAMED[:4])
    assert np.median(errors) <= RELATIVE
    assert np.max(errors) <= 100 * RELATIVE


def test_values_converge_with_order_at_least_3_5() -> None:
    """Over many parameter sets, because events fall anywhere in a step and single errors jump."""
    kind, names = "switched", list(CASES)
    sizes = [
        np.exp(np.mean(np.log(state_errors(kind, found(kind, dt), names) + 1e-15)))
        for dt in (2 * DT, DT)
    ]
    order = np.log2(sizes[0] / sizes[1])
    assert order >= ORDER, sizes  # measured: 6.2e-9 -> 1.3e-10, order 5.5


def test_a_negative_step_mirrors_the_positive_one() -> None:
    """To rounding: the compiler contracts a*b + c differently for the two walls."""
    for kind in LAWS:
        run = found(kind)
        for signal in STATES:
            values = np.asarray(run.signals[signal])
            assert values[0] == pytest.approx(-values[1], abs=1e-12), (kind, signal)


def test_plain_mode_is_of_first_order_and_worse_by_magnitudes() -> None:
    """Reported, not hidden.

    Measured at 4e-4 and 2e-4 s: medians of 7.0e-4 and 3.5e-4 (located:
    2.1e-10); of the paper's run the entry speed is 5 % off, the first impact 0.35 %.
    """
    names = [name for name in CASES if name.startswith("random")]
    located = np.median(state_errors("switched", found("switched"), names))
    sizes = [
        np.median(state_errors("switched", found("switched", dt, Plain()), names))
        for dt in (2 * DT, DT)
    ]
    assert sizes[1] > 1e4 * located, (sizes, located)
    assert 0.5 < np.log2(sizes[0] / sizes[1]) < 1.6, sizes


def test_float32_keeps_four_digits() -> None:
    run = found("switched", dtype=jnp.float32)
    assert not run.failures()
    assert run.signals["theta_L"].dtype == jnp.float32
    errors = dict(zip(NAMED, metric_errors("switched", run, ["paper"])[0], strict=True))
    assert max(errors.values()) <= SINGLE, errors


def test_no_pull_releases_where_the_torque_would_pull() -> None:
    cases = [CASES[name] for name in CASES][:40]
    run = _simulate("linear", cases, DURATION, no_pull=True, store=1500)
    for i, case in enumerate(cases):
        right = _solve("linear", case, DURATION, no_pull=True)
        ours = [float(run.signals[s][i][-1]) for s in STATES]
        assert ours == pytest.approx(right.state(DURATION)[:4], abs=STATE), i
        lost = right.metrics()["impact_energy_J"]
        assert float(run.metrics["impact_loss_J"][i]) == pytest.approx(lost, rel=1e-4)
    assert any(e.surface == "release" for e in right.events)


def test_a_start_exactly_on_the_boundary() -> None:
    """At rest with T_s = 0, where signs are those of rounding (the oracle's too: it starts beside).

    Before, both walls touched in the first reading of the signs, and the run ended in chatter.
    """
    beside = Case(start=(0.0, 0.0, 0.0, bench.PAPER.half_gap + 1e-9))
    case = Case(start=(0.0, 0.0, 0.0, bench.PAPER.half_gap))
    run = _simulate("switched", [case] * len(CASES), DURATION, store=round(0.03 / DT))
    ours = [float(run.signals[s][0][-1]) for s in STATES]
    assert ours == pytest.approx(_solve("switched", beside, DURATION).state(DURATION)[:4], abs=1e-5)


# Long runs.

LONG = 5.0


@cache
def lasting() -> Run:
    """Five seconds of the step without and with linear damping."""
    return simulate(
        bench.drive(),
        batch.stack([bench.law("none"), bench.law("linear")]),
        bench.scenario(LONG),
        metrics=("limit_cycle_Hz", "limit_cycle_rad", "limit_cycle_Nm", "limit_cycle_growth"),
        store=None,
    )


def test_the_limit_cycle_exists_without_damping_only() -> None:
    """9.766 Hz, 8.669 mrad peak to peak, T_s +-0.1618 Nm (errata, A)."""
    numbers = {name: np.asarray(v) for name, v in lasting().metrics.items()}
    assert numbers["limit_cycle_Hz"][0] == pytest.approx(9.766, abs=5e-4)
    assert numbers["limit_cycle_rad"][0] == pytest.approx(8.669e-3, abs=5e-7)
    assert numbers["limit_cycle_Nm"][0] == pytest.approx(0.1618, abs=5e-5)
    assert numbers["limit_cycle_growth"][0] == pytest.approx(1.0, abs=1e-4)
    # With damping the load rests inside the gap until the creeping motor pushes it on, once.
    theta_L = _solve("linear", Case(), LONG).state(np.linspace(0.6 * LONG, LONG, 20001))[:, 2]
    assert numbers["limit_cycle_rad"][1] == pytest.approx(np.ptp(theta_L), rel=1e-5)
    assert numbers["limit_cycle_Hz"][1] == 0.0


def test_the_switched_law_comes_to_rest_without_running_out_of_events() -> None:
    """The eight free runs of Fig. 8, five seconds; near rest the signs are those of rounding."""
    signs = [(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    starts = [Start(0.0, 5.0 * a, 0.5 * c * bench.PAPER.half_gap, 5.0 * b) for a, b, c in signs]
    run = simulate(
        bench.drive(),
        bench.law("switched"),
        batch.stack([bench.scenario(LONG, step=0.0, start=s) for s in starts]),
        metrics=("final_error_rad",),
        store=25000,
    )
    assert not run.failures()
    assert np.all(np.abs(np.asarray(run.signals["omega_L"])[:, -1]) < 1e-2)
    assert np.all(np.abs(np.asarray(run.metrics["final_error_rad"])) < 1e-2)


# Energy.


class Metered(Law):
    """A law with meters: its state holds the work of the motor and the viscous losses, J."""

    law: Law
    D_M: float = eqx.field(static=True)
    D_L: float = eqx.field(static=True)

    def rest(self, y: Measured) -> Any:
        zero = jnp.zeros_like(y.theta_L)
        return self.law.rest(y), zero, zero

    @property
    def surfaces(self) -> Any:
        return self.law.surfaces

    def guards(self, state: Any, y: Measured) -> Any:
        return self.law.guards(state[0], y)

    def field(self, state: Any, y: Measured, switches: Any) -> Any:
        work = self.command(state, y, switches) * y.omega_M
        lost = self.D_M * y.omega_M**2 + self.D_L * y.omega_L**2
        return self.law.field(state[0], y, switches), work, lost

    def command(self, state: Any, y: Measured, switches: Any) -> Any:
        return self.law.command(state[0], y, switches)


def test_energy_balance() -> None:
    """Work of the motor = stored + viscous losses + impact losses, without a load torque."""
    p = bench.PAPER
    metered = Metered(bench.law("switched"), p.D_M, p.D_L)
    loop = ClosedLoop(bench.drive(), metered, bench.scenario(), Exact(), DT)

    @jax.jit
    def end() -> Any:
        metrics = ((Dissipation(task_of(loop, 0, "rad")),),)
        first = engine.start(loop, ((metrics[0][0].start(),),))
        last, _ = engine.advance(loop, first, 1500, engine.budget(loop, 1500), metrics)
        return last

    last = end()
    axis, (_, work, viscous) = last.x.drive[0], last.x.law[0]
    beyond = max(abs(float(axis.theta_B)) - p.half_gap, 0.0)
    stored = 0.5 * (p.J_M * axis.omega_M**2 + p.J_L * axis.omega_L**2 + p.K * beyond**2)
    lost = last.folds[0][0][0]
    assert float(lost) > 1e-3
    # The loss is a quadrature of the cubic of each step, of an impact of 4 to 8 steps.
    assert float(work) == pytest.approx(float(stored + viscous + lost), abs=2e-6 * float(work))


def test_an_earlier_end_changes_nothing_before_it() -> None:
    """Traced, so that one program serves all ends; to rounding, as it is another program."""

    @jax.jit
    def until(end: Any) -> Any:
        done = simulate(
            bench.drive(), bench.law("switched"), bench.scenario(0.1), metrics=("T_s_max_Nm",),
            throw=False, until=end,
        )  # fmt: skip
        return done.signals["T_s"], done.signals["theta_L"], done.status, done.metrics["T_s_max_Nm"]

    short = simulate(
        bench.drive(), bench.law("switched"), bench.scenario(0.04), metrics=("T_s_max_Nm",)
    )
    torque, angle, status, largest = until(0.04)
    assert int(status) == 0
    kept = short.signals["T_s"].size
    np.testing.assert_allclose(torque[:kept], short.signals["T_s"], atol=1e-11)
    np.testing.assert_allclose(angle[:kept], short.signals["theta_L"], atol=1e-13)
    assert np.isnan(torque[kept:]).all()
    assert float(largest) == pytest.approx(float(short.metrics["T_s_max_Nm"]), rel=1e-11)
    assert np.isfinite(until(1.0)[0]).all()  # beyond the scenario's end there is nothing more
