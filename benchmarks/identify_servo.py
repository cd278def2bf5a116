"""A hobby servo identified from recordings of others: friction, gear, firmware and half gap.

    python benchmarks/identify_servo.py PATH/raw_100hz.npz [--parts NAME ...] [--gap] [--out FILE]

960 runs of a Feetech STS3215 that swings a pendulum, 100 Hz. Fitted are the first repetitions with
four of the eight loads; the other four loads, all 480 runs of 6 s, are simulated from their first
sample with nothing but the commanded angle. `--parts` leaves out one part of the model at a time,
fits the rest anew, and says what each was worth; `--gap` traces the half gap.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import jaxsim
from jaxsim.drive import Drive
from jaxsim.hybrid import Exact
from jaxsim.laws.servo import Servo
from jaxsim.loads.pendulum import Pendulum
from jaxsim.motors.geared import Geared
from jaxsim.scenario import Scenario, Start
from jaxsim.signals.constant import Constant
from jaxsim.signals.delayed import Delayed
from jaxsim.signals.samples import Samples
from jaxsim.transmissions.backlash import Backlash
from tuning.identification.estimator import Stage, fit
from tuning.identification.experiment import Experiment, measurement
from tuning.identification.residuals import Problem
from tuning.identification.robust import Huber
from tuning.identification.unknowns import free

TRAIN = ((0.535, 0.10), (0.969, 0.10), (0.741, 0.15), (1.168, 0.15))  # kg, m
DT = 4e-3  # half of it moves the angle by 0.08 mrad in the mean
NOISE = 5e-3  # rad: what the model leaves, not the encoder (0.4 mrad)
ROOM = Exact(max_events=500)
AMPLE = Exact(max_events=3000)  # for values alone, where room that is not needed costs nothing
LOSS = Huber(4.0)
GAPS = 1e-3 * np.array([3.0, 5.0, 6.5, 8.0, 9.5, 11.0, 13.0])  # rad, of the profile
SUPPLY = 12.0  # V; the log has 11.8 to 12.1

# name: start, lower, upper (SI); a part of the model that is left out stands at its last number.
UNKNOWNS: dict[str, tuple[float, float, float]] = {
    "K_T": (0.48, 0.2, 1.0), "D_E": (0.93, 0.3, 2.0), "J_M": (0.019, 0.005, 0.06),
    "D_M": (0.022, 1e-4, 0.2), "Fc": (0.05, 0.0, 0.3), "Fs": (0.12, 1e-4, 0.4),
    "ws": (1.0, 0.05, 5.0), "driving": (0.12, 0.0, 0.6), "driven": (0.32, 0.0, 0.95),
    "K": (150.0, 8.0, 800.0), "D_B": (0.5, 0.01, 3.0), "half_gap": (7.7e-3, 1e-4, 0.03),
    "theta_0": (0.0, -0.05, 0.05), "sag": (0.15, 0.0, 0.5), "slew": (5.0, 4.0, 6.5),
    "reference.delay": (0.030, 0.005, 0.06),
}  # fmt: skip
PARTS: dict[str, dict[str, float]] = {
    "load-dependent friction": {"driving": 0.0, "driven": 0.0},
    "driven unlike driving": {"driven": -1.0},  # one share for both
    "half gap": {"half_gap": 0.0},
    "speed-dependent stick (Stribeck)": {"ws": 1e-2},
    "sag at full duty": {"sag": 0.0},
    "slew limit of the goal": {"slew": 100.0},
    "delay of the command": {"reference.delay": 0.0},
}


class Runs:
    """The recording: arrays (run, sample), what is a spike, and which runs are for what."""

    def __init__(self, path: Path) -> None:
        with np.load(path, allow_pickle=False) as file:
            self.data = {k: file[k] for k in file.files}
        self.q = self.data["q"].astype(float)
        self.t = self.data["t"]
        # Spikes to about -pi last one to three samples.
        windows = np.lib.stride_tricks.sliding_window_view(
            np.pad(self.q, ((0, 0), (3, 3)), mode="edge"), 7, axis=1
        )
        self.used = np.abs(self.q - np.median(windows, axis=2)) < 0.25
        load = np.c_[self.data["mass"], self.data["length"]]
        own = np.any([np.all(np.abs(load - c) < 1e-3, axis=1) for c in TRAIN], axis=0)
        self.train = np.flatnonzero(own & (self._repetition() == 0))
        self.test = np.flatnonzero(~own)

    def _repetition(self) -> np.ndarray:
        """Which repetition of its setting a run is; their names end in the time of day."""
        seen: dict[tuple, int] = {}
        found = np.zeros(len(self.q), int)
        keys = [self.data[k] for k in ("mass", "length", "kp", "trajectory")]
        for i in np.argsort(self.data["name"]):
            key = tuple(k[i] for k in keys)
            found[i] = seen[key] = seen.get(key, -1) + 1
        return found

    def machine(self, i: Any, p: dict[str, float]) -> tuple[Drive, Servo, Scenario]:
        """Run i as drive, law and scenario with the parameters p."""
        d = self.data
        load = Pendulum(d["mass"][i], d["length"][i], d["arm_mass"][i], theta_0=p["theta_0"])
        motor = {k: p[k] for k in ("J_M", "D_M", "Fc", "Fs", "ws", "driving", "driven")}
        gear = Backlash(K=p["K"], half_gap=p["half_gap"], D_B=p["D_B"])
        off = d["enable"][i] < 0.5
        release = self.t[i][np.argmax(off)] if off.any() else 1e9
        law = Servo(
            K_T=p["K_T"], D_E=p["D_E"], sag=p["sag"], slew=p["slew"], k_p=float(d["kp"][i]),
            release=release, supply=Constant(SUPPLY),
        )  # fmt: skip
        return Drive(Geared(**motor), gear, load), law, self._scenario(i, p)

    def _scenario(self, i: Any, p: dict[str, float]) -> Scenario:
        """The commanded angle; at rest, the gear wound up by the weight."""
        d, first = self.data, self.q[i][np.argmax(self.used[i])]
        weight = 9.81 * (d["mass"][i] + 0.5 * d["arm_mass"][i]) * d["length"][i]
        torque = weight * np.sin(first - p["theta_0"])
        wound = torque / p["K"] + np.sign(torque) * p["half_gap"]
        goal = np.interp(np.arange(0.0, 6.0 + DT, 0.01), self.t[i], d["goal"][i])
        reference = Delayed(Samples(goal, 0.01, "linear", on_ticks=True), p["reference.delay"])
        return Scenario(reference, start=Start(theta_L=first, theta_B=wound), duration=6.0)

    def experiment(self, i: Any, p: dict[str, float]) -> Experiment:
        """Run i for the estimator."""
        seen = measurement("theta_L", self.t[i], self.q[i], NOISE, used=self.used[i])
        return Experiment(str(self.data["name"][i]), *self.machine(i, p), (seen,))

    def errors(self, which: np.ndarray, p: dict[str, float]) -> np.ndarray:
        """|simulated - measured| of the runs, rad; nan where masked."""
        columns = zip(*(self.machine(i, p) for i in which), strict=True)
        run = jaxsim.simulate(
            *(jaxsim.stack(list(c)) for c in columns),
            dt=DT,
            deadzone=AMPLE,
            metrics=(),
            throw=False,
        )
        for member, why in run.failures().items():
            print(f"run {which[member]}: {why}")
        time, angle = np.asarray(run.time[0]), np.asarray(run.signals["theta_L"])
        simulated = [np.interp(self.t[i], time, a) for i, a in zip(which, angle, strict=True)]
        return np.where(self.used[which], np.abs(np.array(simulated) - self.q[which]), np.nan)


def problem_of(runs: Runs, start: dict[str, float], fixed: Any = ()) -> Problem:
    """The training runs with every unknown free that is not fixed."""
    experiments = [runs.experiment(i, start) for i in runs.train]
    names = [n for n in UNKNOWNS if n not in fixed]
    one = [free(experiments[0], n, *UNKNOWNS[n][1:]) for n in names]
    return Problem(experiments, one, dt=DT)


def identify(runs: Runs, start: dict[str, float], fixed: Any = (), most: int = 25) -> dict:
    """The parameters that fit the training runs."""
    problem = problem_of(runs, start, fixed)
    found = fit(
        problem, problem.initial()[None], stages=(Stage(ROOM),), loss=LOSS,
        iterations=most, tolerance=3e-4, tell=lambda p: print(f"  {p.iteration}: {p.loss:.6g}"),
    )  # fmt: skip
    names = problem.unknowns.names
    return start | dict(zip(names, found.values[found.best].tolist(), strict=True))


def summary(runs: Runs, which: np.ndarray, p: dict[str, float]) -> dict[str, float]:
    """Mean absolute error in mrad: of all samples, and by trajectory and gain.

    failed: runs that did not complete; they count up to where they stopped.
    """
    errors = runs.errors(which, p)
    lost = np.isfinite(errors).sum(axis=1) < runs.used[which].sum(axis=1)
    rows = {"all": float(1e3 * np.nanmean(errors)), "failed": int(lost.sum())}
    for key in ("trajectory", "kp"):
        values = runs.data[key][which]
        rows |= {f"{v}": float(1e3 * np.nanmean(errors[values == v])) for v in np.unique(values)}
    return rows


def without(runs: Runs, best: dict[str, float], part: str) -> dict[str, Any]:
    """The model without a part, the rest fitted anew to the training runs."""
    fixed = PARTS[part]
    if part == "driven unlike driving":
        mean = 0.5 * (best["driving"] + best["driven"])
        fixed = {"driving": mean, "driven": mean}
    p = identify(runs, best | fixed, fixed, most=10)
    scores = {k: summary(runs, w, p) for k, w in (("train", runs.train), ("test", runs.test))}
    return {"parameters": p, **scores}


def gap_interval(runs: Runs, best: dict[str, float]) -> dict[str, Any]:
    """The half gap by its profile: all else fitted anew at every value of a grid.

    The interval is a bootstrap over runs of the profile's lowest point. The curvature of the loss
    alone would take the 600 samples of a run for 600 witnesses, and runs with hundreds of stops
    have derivatives that no step of the parameters follows.
    """
    problem = problem_of(runs, best)
    column = problem.unknowns.names.index("half_gap")
    starts = np.tile([best[n] for n in problem.unknowns.names], (len(GAPS), 1))
    starts[:, column] = GAPS
    frozen = np.zeros(starts.shape, bool)
    frozen[:, column] = True
    found = fit(
        problem, starts, stages=(Stage(ROOM),), loss=LOSS, frozen=frozen, iterations=6,
        tolerance=3e-4, tell=lambda p: print(f"  profile {p.iteration}: {p.loss:.6g}", flush=True),
    )  # fmt: skip
    left = problem.evaluate(found.values, deadzone=ROOM).residuals
    loss = 0.5 * LOSS.value(left).sum(axis=(2, 3))  # (values, runs)
    good = np.isfinite(loss).all(axis=0)
    loss = loss[:, good]
    draws = np.random.default_rng(0).integers(0, loss.shape[1], (2000, loss.shape[1]))
    lowest = [_lowest(loss[:, d].sum(axis=1)) for d in draws]
    low, high = (1e3 * np.quantile(lowest, q) for q in (0.025, 0.975))
    return {
        "mrad": list(1e3 * GAPS), "loss": loss.sum(axis=1).tolist(), "runs": int(good.sum()),
        "lowest_mrad": float(1e3 * _lowest(loss.sum(axis=1))), "interval_mrad": [low, high],
    }  # fmt: skip


def _lowest(loss: np.ndarray) -> float:
    """Where a parabola through the lowest grid point and its neighbours has its bottom."""
    at = int(np.clip(np.argmin(loss), 1, len(loss) - 2))
    a, b, _ = np.polyfit(GAPS[at - 1 : at + 2], loss[at - 1 : at + 2], 2)
    return float(np.clip(-0.5 * b / a, GAPS[0], GAPS[-1])) if a > 0.0 else GAPS[np.argmin(loss)]


def main() -> None:
    """Fit, test, and with --parts leave out."""
    options = _options()
    jaxsim.configure()
    runs = Runs(options.log)
    start = {k: v[0] for k, v in UNKNOWNS.items()}
    result: dict[str, Any] = {}
    if options.start:
        result = json.loads(options.start.read_text())
        start |= result["parameters"]
    best = start if options.keep else identify(runs, start)
    result["parameters"] = best
    if not options.keep:
        for name, which in (("train", runs.train), ("test", runs.test)):
            result[name] = summary(runs, which, best)
            print(f"{name}, {len(which)} runs, mean absolute error in mrad:", result[name])
    for part in options.parts or ():
        found = result[f"without {part}"] = without(runs, best, part)
        print(
            f"without {part}: {found['train']['all']:.2f}, {found['test']['all']:.2f}", flush=True
        )
        _write(options.out, result)
    if options.gap:
        result["half gap"] = gap_interval(runs, best)
        print("half gap:", json.dumps(result["half gap"]))
    _write(options.out, result)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path, help="raw_100hz.npz")
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), help="what each part is worth")
    parser.add_argument("--gap", action="store_true", help="the half gap's profile and interval")
    parser.add_argument("--start", type=Path, help="a result to start from")
    parser.add_argument("--keep", action="store_true", help="take it as it is: no fit, no test")
    parser.add_argument("--out", type=Path, help="where to write the result")
    return parser.parse_args()


def _write(out: Path | None, result: dict[str, Any]) -> None:
    if out:
        out.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
