"""The certificate: right gradients pass, wrong ones and jumps are named."""

from __future__ import annotations

from typing import Any

import pytest

from jaxsim._certify import certify
from jaxsim.errors import InputError
from jaxsim.hybrid import Plain
from jaxsim.study import Study, load

GAINS = ["K_B", "K_P", "half_gap", "K"]
METRICS = ["itae_rad_s2", "largest_torque_Nm"]
# Event-accurate sensitivities of the first impact (reference file; the switched law's first
# impact is that of the linear law), times the parameter.
REFERENCE = {
    "K_B": 0.30486517125829127 * -0.80,
    "K_P": 0.08321998096346302 * 10.28129662037006,
    "half_gap": 22.881691005387523 * 7.80e-3,
    "K": 0.0008146105318814396 * 300.0,
}
ACCURACY = 1e-5  # relative, at dt = 2e-4 s; measured 2e-7


@pytest.fixture(scope="module")
def study() -> Study:
    return load("bench_switched")


@pytest.fixture(scope="module")
def rows(study: Study) -> list[Any]:
    return certify(study, GAINS, METRICS)


def test_located_gradients_are_right(rows: list[Any]) -> None:
    assert [(r.metric, r.verdict) for r in rows] == [(m, "right") for m in METRICS for _ in GAINS]


def test_gradient_of_the_impact_is_that_of_the_event_accurate_solution(rows: list[Any]) -> None:
    # With this many traced parameters the compiled start once took a rounding error of 1e-17 Nm
    # for a motion of the load and ran the first approach undamped.
    found = {r.parameter.rsplit(".", 1)[-1]: r.value * r.forward for r in rows[len(GAINS) :]}
    assert found == pytest.approx(REFERENCE, rel=ACCURACY)


def test_plain_gradients_are_called_wrong(study: Study) -> None:
    plain = study._replace(run=study.run._replace(deadzone=Plain()))
    verdicts = {r.verdict for r in certify(plain, ["half_gap"], METRICS)}
    assert verdicts <= {"wrong", "jumps"}


def test_a_parameter_without_effect_is_zero(study: Study) -> None:
    (row,) = certify(study, ["J_M"], ["theta_min_rad"])
    assert (row.forward, row.verdict) == (0.0, "zero")


@pytest.mark.parametrize(
    ("names", "metrics", "message"),
    [
        (["K_PP"], METRICS, "did you mean .*K_P"),
        (["K_P"], ["itae"], "did you mean itae_rad_s2"),
        ([], METRICS, "needs a parameter"),
        (["law.half_gap"], METRICS, "half_gap"),
        (["K_P"], ["rise_10_90_s"], None),
    ],
)
def test_bad_names(study: Study, names: list[str], metrics: list[str], message: str | None) -> None:
    if message is None:
        assert certify(study, names, metrics)[0].verdict == "right"
        return
    with pytest.raises(InputError, match=message):
        certify(study, names, metrics)


def test_a_metric_that_is_infinite_has_no_gradient(study: Study) -> None:
    from jaxsim.scenario import Scenario

    idle = study._replace(scenario=Scenario(duration=0.02))
    with pytest.raises(InputError, match="first_contact_s: must be finite"):
        certify(idle, ["K_P"], ["first_contact_s"])
