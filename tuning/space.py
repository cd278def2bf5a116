"""Free parameters on the unit cube, and the points from which a search starts."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import qmc

from jaxsim import tree
from tuning.spec import Free, Spec


def to_gains(free: tuple[Free, ...], z: Any) -> np.ndarray:
    """Values in SI units (..., P) of unit coordinates z (..., P); linear, or in the logarithm."""
    z = np.asarray(z, float)
    low, high, log = _columns(free)
    linear = low + z * (high - low)
    # Powers of the ratio: they stay exact at both bounds and for negative parameters.
    ratio = np.where(log, high / np.where(log, low, 1.0), 1.0)
    return np.clip(np.where(log, low * ratio**z, linear), low, high)


def to_unit(free: tuple[Free, ...], gains: Any) -> np.ndarray:
    """Unit coordinates of values in SI units; values outside their bounds go to the bound."""
    low, high, log = _columns(free)
    gains = np.clip(np.asarray(gains, float), low, high)
    safe = np.where(log, low, 1.0)
    ratio = np.where(log, gains / safe, 1.0)
    share = np.log(ratio) / np.log(np.where(log, high / safe, np.e))
    return np.clip(np.where(log, share, (gains - low) / (high - low)), 0.0, 1.0)


def slope(free: tuple[Free, ...], z: Any) -> np.ndarray:
    """d gain/d z (..., P)."""
    low, high, log = _columns(free)
    rate = np.log(np.where(log, high / np.where(log, low, 1.0), 1.0))
    return np.where(log, to_gains(free, z) * rate, high - low)


def _columns(free: tuple[Free, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    low, high = (np.array([getattr(f, k) for f in free]) for k in ("lower", "upper"))
    return low, high, np.array([f.log for f in free])


def gains_of(law: Any, free: tuple[Free, ...]) -> np.ndarray:
    """The free parameters as they stand in a law (P,); of tied ones the first."""
    return np.array([float(tree.get(law, f.ties[0].path)) for f in free])


def with_gains(law: Any, free: tuple[Free, ...], gains: Any) -> Any:
    """The law with its free parameters set; gains (P,), numbers or traced."""
    return tree.replace(law, leaves(free, gains))


def leaves(free: tuple[Free, ...], gains: Any) -> dict[str, Any]:
    """The parameters of the law by path that gains (..., P) set."""
    return {t.path: t.value(gains[..., i]) for i, f in enumerate(free) for t in f.ties}


def starting_points(law: Any, spec: Spec) -> np.ndarray:
    """(starts, P) in unit coordinates: the law as it is, then a Latin hypercube."""
    first = to_unit(spec.free, gains_of(law, spec.free))[None]
    if spec.starts == 1:
        return first
    sampler = qmc.LatinHypercube(len(spec.free), rng=np.random.default_rng([spec.seed, 1]))
    return np.concatenate([first, sampler.random(spec.starts - 1)])


def spanning(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of `count` points that span all: the first, then always the farthest from those.

    Points are compared in units of their range.
    """
    width = np.ptp(points, axis=0)
    scaled = points / np.where(width > 0.0, width, 1.0)
    chosen = [0]
    distance = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        distance = np.minimum(distance, np.linalg.norm(scaled - scaled[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.array(chosen)
