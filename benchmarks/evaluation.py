"""How much faster a policy is scored in one scan than by SB3's evaluate_policy.

    python benchmarks/evaluation.py

The same policy, task, mode and episode length; steps of control per second, compile time apart,
the best of three. evaluate_policy runs over one environment, as its users do.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import gymnasium
import numpy as np
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


def best(function: Callable[[], object], repeats: int = 3) -> float:
    """The shortest of several calls, s."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


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
    rate = EPISODES * env.steps / best(slow)
    print(f"evaluate_policy, one environment: {rate:12,.0f} steps/s")
    for count in MANY:
        keys = unseen_keys(count)
        score(env, network, keys)
        fused = count * env.steps / best(lambda keys=keys: score(env, network, keys))
        print(f"one scan, {count:5d} episodes:         {fused:12,.0f} steps/s, {fused / rate:.0f}x")
    found = score(env, network, unseen_keys(MANY[0]))
    print(f"median cost {np.median(found.cost):.4f} of {MANY[0]} episodes")


if __name__ == "__main__":
    main()
