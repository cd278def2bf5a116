"""Is a tuned torque law stable at every angle and payload? Poles over a mesh, by eigenvalues.

    python examples/torque_stability.py [OUT] [LAW]

LAW: a law file such as `law.toml` of `gearlash tune arm_tune`; without it the study's own law.
The load stiffness is positive definite where cos(q1) > 0 and cos(q1 + q2) > 0. Elsewhere zeros of
the joint torque lie in the right half plane, and no positive feedback can make the loop stable.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxsim
from jaxsim import plots

STUDY = "arm_tune"
PAYLOADS = (0.0, 0.05, 0.1)  # kg
CELLS = 24  # per turn; their middles, so that no cosine is zero
NAMES = ("rightmost_pole_per_s", "torque_gain_margin_dB")


class Mesh(NamedTuple):
    """Arrays (payloads, q1, q1 + q2): angles rad, the numbers, and where cos, cos > 0."""

    q1: np.ndarray
    q12: np.ndarray
    pole: np.ndarray
    margin: np.ndarray
    definite: np.ndarray


def mesh(law: str | None = None) -> Mesh:
    study = jaxsim.load(STUDY, law=law)
    turn = (np.arange(CELLS) + 0.5) * 2.0 * np.pi / CELLS - np.pi
    payload, q1, q12 = (v.ravel() for v in np.meshgrid(PAYLOADS, turn, turn, indexing="ij"))
    scenario = jaxsim.Scenario(
        study.scenario.reference, study.scenario.load_torque, study.scenario.start, study.run.dt
    )
    paths = {"start[0].theta_L": q1, "start[1].theta_L": q12 - q1}
    run = jaxsim.simulate(
        jaxsim.spread(study.drive, payload=payload),
        study.law,
        jaxsim.spread(scenario, **paths),
        dt=study.run.dt,
        metrics=NAMES,
        store=None,
    )
    pole, margin = (np.asarray(run.metrics[name]) for name in NAMES)
    definite = (np.cos(q1) > 0.0) & (np.cos(q12) > 0.0)
    shape = (len(PAYLOADS), CELLS, CELLS)
    columns = (q1, q12, pole[:, 0], margin.min(axis=1), definite)
    return Mesh(*(np.asarray(v).reshape(shape) for v in columns))


def told(found: Mesh) -> list[str]:
    inside = found.definite
    lines = []
    for k, payload in enumerate(PAYLOADS):
        at = inside[k]
        pole, stable = found.pole[k], found.pole[k] < 0.0
        lines.append(
            f"payload {payload:g} kg: {stable[at].sum()} of {at.sum()} points with cos q1 > 0 and "
            f"cos(q1 + q2) > 0 are stable, rightmost pole {pole[at].max():.4g} 1/s, least gain "
            f"margin {found.margin[k][at].min():.3g} dB; elsewhere {(~stable)[~at].sum()} of "
            f"{(~at).sum()} are unstable, poles up to {pole[~at].max():.3g} 1/s"
        )
    return lines


def write(found: Mesh, path: Path) -> None:
    payload = np.broadcast_to(np.array(PAYLOADS)[:, None, None], found.q1.shape)
    columns = (payload, found.q1, found.q12 - found.q1, found.pole, found.margin, found.definite)
    table = np.stack([np.asarray(c, float).ravel() for c in columns], axis=1)
    head = "payload_kg,q1_rad,q2_rad,rightmost_pole_1_s,torque_gain_margin_dB,definite"
    np.savetxt(path, table, "%.8g", ",", header=head, comments="")


def draw(found: Mesh, path: Path) -> None:
    from matplotlib.colors import SymLogNorm

    size = (4.2 * len(PAYLOADS) + 0.8, 4.4)
    norm = SymLogNorm(0.01, vmin=-10.0, vmax=10.0)  # stable poles are those of the load, slow
    with plots.figure(path, 1, len(PAYLOADS), squeeze=False, size=size) as axes:
        for ax, payload, q1, q12, pole in zip(
            axes[0], PAYLOADS, found.q1, found.q12, found.pole, strict=True
        ):
            ax.grid(visible=False)
            image = ax.pcolormesh(np.degrees(q1), np.degrees(q12), pole, cmap="RdBu_r", norm=norm)
            ax.plot(
                [-90, 90, 90, -90, -90], [-90, -90, 90, 90, -90], "k--", lw=1.2,
                label="stiffness positive definite inside",
            )  # fmt: skip
            ax.set_xlabel("q1 [deg]")
            ax.set_title(f"payload {payload:g} kg")
            ax.set_xticks(range(-180, 181, 90))
            ax.set_yticks(range(-180, 181, 90))
        axes[0, 0].set_ylabel("q1 + q2 [deg]")
        axes[0, 0].legend(loc="upper left", frameon=True, facecolor="white", framealpha=1.0)
        axes[0, 0].figure.colorbar(image, ax=axes[0].tolist(), label="rightmost pole [1/s]")


def main(out: Path, law: str | None = None) -> None:
    jaxsim.configure()
    found = mesh(law)
    print("\n".join(told(found)))
    out.mkdir(parents=True, exist_ok=True)
    write(found, out / "torque_stability.csv")
    draw(found, out / "torque_stability.png")


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(Path(arguments[0] if arguments else "results/examples"), *arguments[1:2])
