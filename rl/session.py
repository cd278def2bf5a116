"""One training from start to end: segments, validation, checkpoints, the best policy."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from envs.environment import Environment, build
from jaxsim.errors import InputError
from rl import store
from rl.episodes import Scores, score, unseen_keys, validation_keys
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
        self.rows: list[Row] = store.read_checkpoint(folder, self.trainer) if resume else []
        self._cpu = self.rows[-1].cpu if self.rows else 0.0
        store.write_spec(folder, spec)

    def run(self, tell: Callable[[Row], None]) -> None:
        """Train to the end. A KeyboardInterrupt leaves the last segment's checkpoint."""
        keys = validation_keys(self.spec.validation)
        while self.trainer.done < self.spec.total:
            began = time.process_time()
            loss = self.trainer.advance()
            network = self.trainer.network()
            found = score(self.env, network, keys)
            self._cpu += time.process_time() - began
            self._judge(loss, found, network)
            tell(self.rows[-1])

    def _judge(self, loss: float, found: Scores, network: object) -> None:
        validation = float(np.mean(np.where(np.isfinite(found.loss), found.loss, np.inf)))
        best = min(store.best_of(self.rows), validation)
        if validation <= best:
            policy = store.law_of(self.env, network)  # type: ignore[arg-type]
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
