"""What a training is asked to do: a preset of its algorithm, and what was changed of it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from envs.task import TASKS
from jaxsim.errors import InputError, called
from jaxsim.validation import check

ALGORITHMS = ("apg", "ppo", "sac", "td3")


class _Common(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    task: str
    algo: str
    seed: int = Field(ge=0)
    hidden: tuple[int, ...] = Field(min_length=1)
    validation: int = Field(ge=1)


class APGSpec(_Common):
    """Analytic policy gradients; see rl/presets/apg.toml for the meanings."""

    iterations: int = Field(ge=1)
    batch: int = Field(ge=1)
    rate: float = Field(gt=0)
    final: float = Field(gt=0, le=1)
    decay: float = Field(gt=0, le=1)
    clip: float = Field(gt=0)
    width: float = Field(gt=0)
    speed_width: float = Field(gt=0)
    validate_every: int = Field(ge=1)
    regret: float = Field(default=0.0, ge=0)
    margin: float = Field(default=0.0, ge=0, lt=1)
    nominal: float = Field(default=0.0, ge=0, le=1)

    @property
    def total(self) -> int:
        """Length of the training in its own unit."""
        return self.iterations


class SB3Spec(_Common):
    """An algorithm of stable-baselines3; `algorithm` and `policy` go to it as they are."""

    steps: int = Field(ge=1)
    envs: int = Field(ge=1)
    segment: int = Field(ge=1)
    activation: Literal["tanh", "relu"]
    algorithm: dict[str, Any] = {}
    policy: dict[str, Any] = {}

    @property
    def total(self) -> int:
        """Length of the training in its own unit."""
        return self.steps


def read_spec(task: str, algo: str, seed: int, changes: Mapping[str, Any]) -> APGSpec | SB3Spec:
    """The preset of an algorithm for a task, with changes; `a.b` names an entry of a table in it.

    Raises: InputError for unknown tasks, algorithms and entries, and for values that are wrong.
    """
    if algo not in ALGORITHMS:
        raise InputError.unknown("--algo", algo, ALGORITHMS)
    with called("task"):
        TASKS.find(task)
    text = resources.files("rl.presets").joinpath(f"{algo}.toml").read_text("utf-8")
    preset = tomllib.loads(text)
    table = _merged(preset["default"], preset.get(task, {}))
    for name, value in changes.items():
        owner, _, entry = name.rpartition(".")
        table = _merged(table, {owner: {entry: value}} if owner else {name: value})
    return from_table({**table, "task": task, "algo": algo, "seed": seed})


def from_table(table: Mapping[str, Any]) -> APGSpec | SB3Spec:
    """The spec in a table, such as that of training.toml."""
    if table.get("algo") not in ALGORITHMS:
        raise InputError.unknown("training.algo", str(table.get("algo")), ALGORITHMS)
    return check(APGSpec if table["algo"] == "apg" else SB3Spec, table, "training")


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for name, value in over.items():
        old = merged.get(name)
        both = isinstance(value, Mapping) and isinstance(old, Mapping)
        merged[name] = _merged(old, value) if both else value  # type: ignore[arg-type]
    return merged


__all__ = ["ALGORITHMS", "APGSpec", "SB3Spec", "from_table", "read_spec"]
