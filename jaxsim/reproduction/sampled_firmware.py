"""The step with sampled controllers as firmware would run them: encoders, differences, delay."""

from __future__ import annotations

from jaxsim.findings import Findings, Group, above, claim
from jaxsim.law import Law
from jaxsim.reproduction import _bench_2018 as bench
from jaxsim.reproduction._draw_2018 import METHOD, over_time
from jaxsim.sampled import Encoders, Sampled

READING = (
    "section IV with what its text leaves out: speeds as differences of 20-bit encoders, command "
    "one period (0.4 ms) late; 2.5 kHz, Tustin, step at sample 25"
)


class SampledFirmware(Group):
    """Whether the claims survive real sensors and a real computer."""

    paper = bench.PAPER
    title = "the same with 20-bit encoder differences and one period of delay"
    figures = ("firmware_theta_L", "firmware_T_s")

    def find(self) -> Findings:
        found = bench.three(bench.scenario(bench.STEP), wrap=_firmware)
        numbers = bench.sampled_rows("sampled_firmware", found, READING)
        less = bench.reduction(found, "linear")
        verdict = claim(
            "impact_reduction_firmware",
            "first impact, conventional against none: less by",
            "%",
            less,
            above(0.0),
            "IV: 'The first impact torque is reduced by damping addition'. Delay and differences "
            "damp MORE: 47.7 against 44.6 % without them",
        )
        told = f"Not in the paper. Reading: {READING}. {METHOD}"
        figures = {
            "firmware_theta_L": over_time(
                found,
                "theta_L",
                (0.0, 0.3),
                "Step response with encoders and delay",
                told,
                marks=True,
            ),
            "firmware_T_s": over_time(
                found, "T_s", (0.0, 0.1), "Impact torque with encoders and delay", told
            ),
        }
        return Findings([*numbers, verdict], figures)


def _firmware(law: Law) -> Sampled:
    return Sampled(law, bench.PERIOD, bench.PERIOD, Encoders(counts=2**20))
