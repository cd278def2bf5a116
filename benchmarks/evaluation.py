"""How much faster a policy is scored in one scan than by SB3's evaluate_policy.

The same policy, task, mode and episode length; steps of control per second, compile time apart.
evaluate_policy runs over one environment, as its users do.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import measuring
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

import envs.registration  # noqa: F401
import jaxsim
from envs.environment import build
from rl.episodes import score, unseen_keys
from rl.sb3 import network_of

TASK, ID = "backlash_position_residual", "gearlash/BacklashPositionResidual-v0"
EPISODES, MANY = 5, (256, 4096)


def main() -> None:
    jaxsim.configure(x64=False)
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", category=UserWarning)
    env = build(TASK)
    single = gymnasium.make(ID)
    model = PPO("MlpPolicy", single, seed=0, device="cpu")
    network = network_of(model, None)

    def slow() -> None:
        evaluate_policy(model, single, n_eval_episodes=EPISODES, warn=False)

    slow()
    calls: dict[str, tuple[int, Callable[[], Any]]] = {
        "evaluate_policy, one environment": (EPISODES, slow)
    }
    for count in MANY:
        keys = unseen_keys(count)
        call = (count, lambda keys=keys: score(env, network, keys))
        calls[f"one scan, {count} episodes"] = call
    timings = measuring.interleaved({name: call for name, (_, call) in calls.items()}, repeats=3)
    rate = {n: episodes * env.steps / timings[n].best_s for n, (episodes, _) in calls.items()}
    first = next(iter(rate))
    rows = [{"what": name, "steps_per_s": value} for name, value in rate.items()]
    ratios = {f"{name}, over evaluate_policy": v / rate[first] for name, v in rate.items()}
    del ratios[f"{first}, over evaluate_policy"]
    measuring.save("evaluation", {"rows": rows}, ratios)


if __name__ == "__main__":
    main()
