"""One training from start to end: segments, validation, checkpoints, the best policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from envs.environment import Environment, build
from jaxsim.errors import InputError
from jaxsim.laws.policy import Network
from rl import store
from rl.episodes import Scores, score, unseen_keys, validation_keys
from rl.networks import idle_network
from rl.regret import nominal_of, regret
from rl.spec import APGSpec, SB3Spec
from rl.store import Row
from rl.trainer import Trainer

_TEST = 256


class Session:
    """A training in a folder. Everything that took time is in files after each segment."""

    def __init__(self, spec: APGSpec | SB3Spec, folder: Path, *, resume: bool) -> None:
        self.spec, self.folder = spec, folder
        self.env: Environment = build(spec.task)
        self.trainer = trainer_of(spec, folder)
        self._exams = exams(self.env, spec)
        self.rows: list[Row] = store.read_checkpoint(folder, self.trainer) if resume else []
        self._cpu = self.rows[-1].cpu if self.rows else 0.0
        store.write_spec(folder, spec)

    def run(self, tell: Callable[[Row], None]) -> None:
        """Train to the end. A KeyboardInterrupt leaves the last segment's checkpoint."""
        while self.trainer.done < self.spec.total:
            began = time.process_time()
            loss = self.trainer.advance()
            network = self.trainer.network()
            validation, found = _examined(self._exams, network)
            self._cpu += time.process_time() - began
            self._judge(loss, validation, found, network)
            tell(self.rows[-1])

    def _judge(self, loss: float, validation: float, found: Scores, network: Network) -> None:
        best = min(store.best_of(self.rows), validation)
        if validation <= best:
            policy = store.law_of(self.env, network)
            about = f"{self.spec.algo} on {self.spec.task}, seed {self.spec.seed}"
            store.write_policy(self.folder, policy, about)
        self.trainer.judged(validation, best)
        cost = float(np.median(found.cost))
        trainer = self.trainer
        row = Row(trainer.done, trainer.steps, loss, validation, cost, best, self._cpu)
        self.rows.append(row)
        store.write_checkpoint(self.folder, trainer, self.rows)
        store.write_progress(self.folder, self.rows)

    def test(self) -> Scores:
        """The best policy on episodes that nothing was trained or chosen on."""
        policy = store.read_policy(self.folder)
        return score(self.env, policy.network, unseen_keys(_TEST))


class _Exam(NamedTuple):
    """Episodes that choose among policies.

    weight: of their mean loss; price: of their regret, against `own`, the metrics of the law
    alone in them; margin: see `regret`.
    """

    weight: float
    env: Environment
    keys: Any
    price: float = 0.0
    margin: float = 0.0
    own: dict[str, np.ndarray] | None = None


def exams(env: Environment, spec: APGSpec | SB3Spec) -> list[_Exam]:
    """What a policy is chosen by: the objective of its training, in exact mode, on other episodes.

    The first one is of random episodes.
    """
    keys = validation_keys(spec.validation)
    if not isinstance(spec, APGSpec) or not spec.regret:
        return [_Exam(1.0, env, keys)]
    idle = idle_network(env)
    shares = [(1.0 - spec.nominal, env, keys)]
    if spec.nominal:
        shares.append((spec.nominal, nominal_of(env), keys[:1]))
    price = spec.regret, spec.margin
    return [_Exam(*share, *price, score(share[1], idle, share[2]).numbers) for share in shares]


def _examined(exams: Sequence[_Exam], network: Network) -> tuple[float, Scores]:
    """The loss that a policy is chosen by, and its scores in random episodes."""
    found = [score(exam.env, network, exam.keys) for exam in exams]
    total = 0.0
    for exam, scores in zip(exams, found, strict=True):
        loss = np.where(np.isfinite(scores.loss), scores.loss, np.inf)
        if exam.own is not None:
            worse = regret(exam.env.task, scores.numbers, exam.own, exam.margin)
            loss = loss + exam.price * np.asarray(worse)
        total += exam.weight * float(np.mean(loss))
    return total, found[0]


def trainer_of(spec: APGSpec | SB3Spec, folder: Path) -> Trainer:
    """The algorithm of a spec; torch is imported only where it is asked for."""
    if isinstance(spec, APGSpec):
        from rl.apg import APG

        return APG(spec)
    try:
        from rl.sb3 import SB3
    except ModuleNotFoundError as error:
        fix = "pip install 'gearlash[rl]'"
        raise InputError("--algo", "needs the extra rl", str(error), fix) from None
    return SB3(spec, folder)


__all__ = ["Session", "trainer_of"]
