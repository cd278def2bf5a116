"""`gearlash analyse` against the polynomials of the papers and the torque loop's own analysis."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from jaxsim.analysis import Analysis, Mode, analyse
from jaxsim.commands.analyse import command
from jaxsim.errors import InputError
from jaxsim.linear.frequency import margins
from jaxsim.linear.stability import abscissa, stable_gains
from jaxsim.linear.torque_loop import closed_loop, open_loop
from jaxsim.reproduction import _joints_2014 as paper
from jaxsim.study import Study, from_table, load, with_values

S = Polynomial([0.0, 1.0])
SAME = 1e-7  # relative: poles of a loop of twelve states, two ways


def _bench(damping: float, contact: bool) -> np.ndarray:
    """Poles of 2018 (1)-(5), PD with filter, prefilter, and K_B omega_B at the motor."""
    motor, load = 9.30e-2 * S + 8.78e-4 * S**2, 3.60e-2 * S + 8.78e-4 * S**2
    gear = (3.00e2 + 1.00e-1 * S) * float(contact)
    tau = 5.82812354062619e-3
    law = 10.28129662037006 * (1.0 + tau * S) + 0.05470907749696041 * S
    # Motor: (motor + gear - K_B s) theta_M - (gear - K_B s) theta_L = -law/(1 + tau s) theta_L.
    k = gear - damping * S
    whole = ((motor + k) * (load + gear) - gear * k) * (1.0 + tau * S) + gear * law
    return np.append(whole.trim().roots(), -40.0 * math.pi)


def _mode(found: Analysis, name: str) -> Mode:
    return next(m for m in found.modes if m.name == name)


def _near(a: np.ndarray, b: np.ndarray) -> None:
    assert len(a) == len(b)
    distance = np.abs(np.asarray(a)[:, None] - np.asarray(b)[None, :])
    assert np.all(distance.min(axis=1) <= SAME * (1.0 + np.abs(a)))
    assert np.all(distance.min(axis=0) <= SAME * (1.0 + np.abs(b)))


@pytest.fixture(scope="module")
def bench() -> Analysis:
    return analyse(load("bench_switched"))


@pytest.fixture(scope="module")
def arm() -> Analysis:
    return analyse(load("arm_torque"))


@pytest.mark.parametrize("contact", ["contact+", "contact-"])
@pytest.mark.parametrize(("switches", "K_B"), [("omega_L+", -0.8), ("omega_L-", 0.0)])
def test_the_bench_in_contact(bench: Analysis, contact: str, switches: str, K_B: float) -> None:
    mode = _mode(bench, f"{contact}, omega_B+ {switches}")
    _near(mode.poles, _bench(K_B, contact=True))
    assert mode.verdict == "stable"
    assert mode.margins[0] is not None
    edge = mode.margins[0].gain
    assert mode.gain.intervals() == [(0.0, pytest.approx(edge, rel=1e-9))]
    assert abscissa(mode.gain.A_0 + edge * mode.gain.A_1) == pytest.approx(0.0, abs=1e-6)


def test_the_bench_in_its_gap_is_marginal(bench: Analysis) -> None:
    # In the gap the load is alone, and the motor feels the damping only.
    mode = _mode(bench, "gap, omega_B+ omega_L-")
    known = [0.0, 0.0, -3.60e-2 / 8.78e-4, -9.30e-2 / 8.78e-4, -40.0 * math.pi,
             -1.0 / 5.82812354062619e-3]  # fmt: skip
    assert np.sort(np.real(mode.poles)) == pytest.approx(np.sort(known), rel=1e-9, abs=1e-9)
    assert mode.verdict == "marginal"
    assert mode.margins == [None]
    assert np.isnan(mode.bandwidth).all()


def test_the_arm_is_that_of_the_torque_loop(arm: Analysis) -> None:
    (mode,) = arm.modes
    law = paper.FULL.scaled(2.0)
    _near(mode.poles, np.linalg.eigvals(closed_loop(paper.arm(), law).A))
    assert np.array(mode.bandwidth) / paper.HZ == pytest.approx([55.3338, 55.6510], rel=1e-5)
    ((_, edge),) = stable_gains(paper.arm(), paper.FULL)
    assert mode.K_p is not None
    assert mode.K_p.intervals() == [(0.0, pytest.approx(0.5 * edge, rel=1e-7))]
    for axis, found in enumerate(mode.pi_margins):
        wanted = margins(open_loop(paper.arm(), law, axis))
        assert found is not None
        assert (found.gain, found.phase) == pytest.approx((wanted.gain, wanted.phase), rel=1e-6)
    assert mode.alpha is not None
    _near(mode.alpha.roots(0.5), np.linalg.eigvals(closed_loop(paper.arm(), law.weighted(0.5)).A))
    assert arm.region is not None
    assert arm.region.K_p_max == pytest.approx([14.1128] * 2, rel=5e-6)


def test_all_commands_scaled_is_gain_and_shares_scaled(arm: Analysis) -> None:
    ((_, edge),) = arm.modes[0].gain.intervals()
    for factor, stable in ((0.9999 * edge, True), (1.0001 * edge, False)):
        law = paper.FULL.scaled(2.0 * factor).weighted(factor)
        assert bool(abscissa(closed_loop(paper.arm(), law).A) < 0.0) is stable


def test_the_arm_with_play_closed_is_the_arm_and_open_is_held() -> None:
    found = analyse(load("arm_backlash"))
    names = [m.name for m in found.modes]
    assert names == ["contact+", "contact-", "gap[0]", "gap[1]", "gap"]
    _near(_mode(found, "contact+").poles,
          np.linalg.eigvals(closed_loop(paper.arm(), paper.FULL.scaled(2.0)).A))  # fmt: skip
    weight = 1.034 * math.sin(0.5)
    assert any(f"[{weight:.6f}, {weight:.6f}]" in note for note in found.notes)
    assert any("ripple" in note for note in found.notes)
    zeros = _mode(found, "gap").poles  # the links are alone: their poles are the zeros
    for zero in (-0.0304489 + 3.0036363j, -0.2036675 + 7.4767459j):
        assert np.abs(zeros - zero).min() < 1e-6


def test_the_command_writes_all(tmp_path: Path) -> None:
    command("leg_torque", out=tmp_path, change=["alpha_j=0.5"], at="0.1")
    content = json.loads((tmp_path / "analysis.json").read_text())
    assert content["theta_L_rad"] == [0.1]
    assert content["modes"][0]["verdict"] == "stable"
    assert content["routh_hurwitz"]["K_p_V_Nm"] == [2.0]
    figures = {p.name for p in tmp_path.glob("*.png")}
    assert figures == set(content["figures"])
    assert {"pole_zero.png", "bode.png", "stability_region.png", "root_locus_gain.png",
            "root_locus_K_p.png", "root_locus_alpha.png"} == figures  # fmt: skip


def test_gains_outside_the_region_are_named() -> None:
    found = analyse(with_values(load("leg_torque"), {"K_i": 120.0}))
    assert any("K_i < 107.6" in note for note in found.notes)
    assert not any("outside" in note for note in analyse(load("leg_torque")).notes)


def test_sampled_laws_are_taken_continuous_but_not_those_with_memory() -> None:
    table = load("leg_torque").table
    law = {"type": "sampled", "period": 1e-3, "law": table["law"]}
    sampled = _study(table | {"law": law})
    found = analyse(sampled)
    _near(found.modes[0].poles, analyse(load("leg_torque")).modes[0].poles)
    assert "continuous" in found.notes[0]
    feedback = {"type": "positive_feedback", "Gamma_j": [3.975e-5], "Gamma_a": [0.054354],
                "Gamma_v": [6.909329], "source": {"type": "butterworth_differences"}}  # fmt: skip
    law = {"type": "sampled", "period": 1e-3, "law": [table["law"][0], feedback]}
    with pytest.raises(InputError, match="law: must be continuous"):
        analyse(_study(table | {"law": law}))


def _study(table: dict) -> Study:
    return from_table(table, Path(), "changed")


@pytest.mark.parametrize(("at", "field"), [("0,x", "--at"), ("0,0.5,1", "theta_L")])
def test_angles_are_checked(at: str, field: str) -> None:
    with pytest.raises(InputError) as caught:
        command("arm_torque", at=at)
    assert caught.value.field == field
