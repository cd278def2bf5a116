"""A comparison as a file tells it: whose episodes, which agents, how many seeds."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from envs.task import TASKS, Task
from jaxsim.components import read_toml
from jaxsim.errors import InputError
from jaxsim.validation import check
from rl.spec import APGSpec, SB3Spec, read_spec

SHIPPED = "rl.studies"


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    about: str
    task: str
    episodes: int = Field(ge=2)
    tuning: int = Field(ge=1)
    agents: dict[str, dict[str, Any]]


class Comparison(NamedTuple):
    """agents: per name the trainings of its seeds; tuning: runs of the classical law's tuner."""

    name: str
    about: str
    task: str
    episodes: int
    tuning: int
    agents: dict[str, list[APGSpec | SB3Spec]]

    def trainings(self) -> list[tuple[str, APGSpec | SB3Spec]]:
        """All trainings, and the folder of each; the first seed of every agent comes first."""
        named = [(f"{n}-{s.seed}", s) for n, specs in self.agents.items() for s in specs]
        return sorted(named, key=lambda item: item[1].seed)


def shipped() -> list[str]:
    """Names of the comparisons that come with the project."""
    names = (file.name for file in resources.files(SHIPPED).iterdir())
    return sorted(n.removesuffix(".toml") for n in names if n.endswith(".toml"))


def read_comparison(name: str) -> Comparison:
    """The comparison in a file, or a shipped one by name.

    Raises: InputError for what is unknown, missing or wrong in it.
    """
    path = Path(name)
    if not path.is_file():
        if name not in shipped():
            raise InputError.unknown("comparison", name, shipped())
        path = Path(str(resources.files(SHIPPED) / f"{name}.toml"))
    file = check(_File, read_toml(path), path.name)
    agents = {agent: _specs(agent, table, file.task) for agent, table in file.agents.items()}
    return Comparison(path.stem, file.about, file.task, file.episodes, file.tuning, agents)


def _specs(agent: str, table: dict[str, Any], episodes_of: str) -> list[APGSpec | SB3Spec]:
    rest = dict(table)
    where = f"agents.{agent}"
    for key in ("task", "algo", "seeds"):
        if key not in rest:
            raise InputError(f"{where}.{key}", "must be given", "nothing", "add it")
    task, algo, seeds = (rest.pop(key) for key in ("task", "algo", "seeds"))
    if _episodes(TASKS.find(task)) != _episodes(TASKS.find(episodes_of)):
        rule = f"must have the episodes and the cost of {episodes_of}"
        raise InputError(f"{where}.task", rule, task, "compare it with its own kind")
    if not isinstance(seeds, list) or len(set(map(str, seeds))) != len(seeds) or not seeds:
        raise InputError(f"{where}.seeds", "must be a list of different seeds", seeds, "[0, 1]")
    return [read_spec(task, algo, seed, rest) for seed in seeds]


def _episodes(task: type[Task]) -> tuple[Any, ...]:
    return task.draw, tuple(task.terms.items()), task.duration


__all__ = ["Comparison", "read_comparison", "shipped"]
