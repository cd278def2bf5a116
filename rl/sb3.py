"""PPO, SAC and TD3 of stable-baselines3, in segments that repeat exactly, without pickles."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
import stable_baselines3
import torch
from stable_baselines3.common.logger import configure
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from envs.sb3 import BatchedVecEnv
from jaxsim.errors import InputError
from jaxsim.laws.policy import Layer, Network
from rl import arrays
from rl.spec import SB3Spec
from rl.trainer import Trainer

_ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_LOOSE = "tensors"
_COUNTS = ("num_timesteps", "_n_updates", "_episode_num")


class SB3(Trainer):
    """The training of one agent. Each segment starts fresh episodes from a seed of its own.

    So what is between two segments is weights, moments, statistics and the replay buffer, and
    all of it goes to files that run no code when they are read: torch's with `weights_only`,
    NumPy's without pickles.
    """

    def __init__(self, spec: SB3Spec, folder: Path) -> None:
        # More threads only wait for each other at these sizes.
        torch.set_num_threads(1)
        self._spec = spec
        venv = BatchedVecEnv(spec.task, spec.envs)
        gamma = float(spec.algorithm.get("gamma", 0.99))
        self._venv = VecNormalize(venv, gamma=gamma)
        self.model = _model(spec, self._venv)
        self.model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))

    @property
    def done(self) -> int:
        return int(self.model.num_timesteps)

    @property
    def steps(self) -> int:
        return self.done

    def advance(self) -> float:
        size = min(self._spec.segment, self._spec.steps - self.done)
        words = np.random.SeedSequence([self._spec.seed, self.done]).generate_state(1, np.uint32)
        self.model.set_random_seed(int(words[0] >> 1))
        self.model._last_obs = None  # learn() resets the environments then
        self.model.ep_info_buffer = None
        self.model.learn(size, reset_num_timesteps=False, log_interval=None)
        episodes = self.model.ep_info_buffer or []
        returns = [episode["r"] for episode in episodes]
        return -float(np.mean(returns)) if returns else float("nan")

    def judged(self, loss: float, best: float) -> None:
        self.model.logger.record("validation/loss", loss)
        self.model.logger.record("validation/best", best)
        self.model.logger.dump(self.done)

    def network(self) -> Network:
        return network_of(self.model, self._venv)

    def save(self, folder: Path) -> None:
        # SAC's temperature is a tensor of its own, which `get_parameters` leaves out.
        loose = {name: getattr(self.model, name).detach() for name in self._loose()}
        parameters = self.model.get_parameters() | {_LOOSE: loose}
        torch.save(parameters, folder / "parameters.pt")
        own: dict[str, Any] = {name: np.asarray(getattr(self.model, name)) for name in _COUNTS}
        for name in ("obs_rms", "ret_rms"):
            statistics = getattr(self._venv, name)
            for part in ("mean", "var", "count"):
                own[f"{name}.{part}"] = np.asarray(getattr(statistics, part))
        np.savez(folder / "statistics.npz", **own)
        replay = getattr(self.model, "replay_buffer", None)
        if replay is not None:
            filled = replay.buffer_size if replay.full else replay.pos
            kept = {name: getattr(replay, name)[:filled] for name in _REPLAY}
            place: dict[str, Any] = {"pos": np.asarray(replay.pos), "full": np.asarray(replay.full)}
            np.savez(folder / "replay.npz", **kept, **place)

    def _loose(self) -> list[str]:
        """Names of the tensors that are trained and belong to no module."""
        return list(self.model._get_torch_save_params()[1])

    def load(self, folder: Path) -> None:
        parameters = _read_torch(folder / "parameters.pt")
        loose = parameters.pop(_LOOSE, {})
        if set(loose) != set(self._loose()):
            rule, found = f"must hold the tensors {self._loose()}", sorted(loose)
            raise InputError(str(folder / "parameters.pt"), rule, found, "train anew")
        self.model.set_parameters(parameters, device="cpu")
        for name in self._loose():
            getattr(self.model, name).data = loose[name]
        own = arrays.read(folder / "statistics.npz")
        for name in _COUNTS:
            setattr(self.model, name, int(own[name]))
        for name in ("obs_rms", "ret_rms"):
            statistics: RunningMeanStd = getattr(self._venv, name)
            statistics.mean, statistics.var = own[f"{name}.mean"], own[f"{name}.var"]
            statistics.count = float(own[f"{name}.count"])
        replay = getattr(self.model, "replay_buffer", None)
        if replay is not None:
            stored = arrays.read(folder / "replay.npz")
            for name in _REPLAY:
                getattr(replay, name)[: len(stored[name])] = stored[name]
            replay.pos, replay.full = int(stored["pos"]), bool(stored["full"])


def _model(spec: SB3Spec, venv: VecNormalize) -> Any:
    kind = getattr(stable_baselines3, spec.algo.upper())
    policy = {
        "net_arch": list(spec.hidden),
        "activation_fn": _ACTIVATIONS[spec.activation],
        **spec.policy,
    }
    options = {"policy_kwargs": policy, "seed": spec.seed, "device": "cpu"}
    try:
        return kind("MlpPolicy", venv, **options, **spec.algorithm)
    except TypeError as error:
        rule = f"must be arguments of stable_baselines3.{spec.algo.upper()}"
        raise InputError("training.algorithm", rule, str(error), "mend the preset") from None


def _read_torch(path: Path) -> Any:
    """Weights and moments; never other objects.

    Raises: InputError where the file is missing, incomplete or holds more than that.
    """
    try:
        return torch.load(path, weights_only=True)
    except FileNotFoundError:
        raise InputError(str(path), "must be a file", "nothing there", "check the path") from None
    except Exception as error:  # torch raises what the damaged byte led to
        rule, words = "must be a complete file of weights", str(error).partition("\n")[0]
        found = f"a damaged one ({words})"
        raise InputError(str(path), rule, found, "train anew, or bring it back") from None


def network_of(model: Any, venv: VecNormalize | None) -> Network:
    """The deterministic policy of a model as a `Network`, normalisation included."""
    modules, squash = _modules(model)
    linear = [m for m in modules if isinstance(m, torch.nn.Linear)]
    relu = any(isinstance(m, torch.nn.ReLU) for m in modules)
    layers = [
        Layer(m.weight.detach().numpy().copy(), m.bias.detach().numpy().copy()) for m in linear
    ]
    size = linear[0].in_features
    mean, scale, bound = np.zeros(size), np.ones(size), 1e9
    if venv is not None:
        statistics: Any = venv.obs_rms
        mean, bound = statistics.mean.copy(), float(venv.clip_obs)
        scale = np.sqrt(statistics.var + venv.epsilon)
    return Network(
        layers, mean, scale, bound=bound, activation="relu" if relu else "tanh", squash=squash
    )


def _modules(model: Any) -> tuple[list[torch.nn.Module], Literal["tanh", "clip"]]:
    """The layers from observation to action, and what keeps the action in the box."""
    policy = model.policy
    if hasattr(policy, "action_net"):
        return [*policy.mlp_extractor.policy_net, policy.action_net], "clip"
    actor = policy.actor
    if hasattr(actor, "latent_pi"):
        return [*actor.latent_pi, actor.mu], "tanh"
    return list(actor.mu), "tanh"


def network_of_zip(path: Path, algo: str) -> Network:
    """The policy in a zip that stable-baselines3 saved; without `VecNormalize`.

    Reading one can run any code that whoever made it put there: it warns, always.

    Raises: InputError for a file that is none, or an unknown algorithm.
    """
    warnings.warn(f"{path} is unpickled: it can run code of whoever made it", stacklevel=2)
    kinds = {name: getattr(stable_baselines3, name.upper()) for name in ("ppo", "sac", "td3")}
    if algo not in kinds:
        raise InputError.unknown("--algo", algo, kinds)
    try:
        return network_of(kinds[algo].load(path, device="cpu"), None)
    except (OSError, ValueError, KeyError, AssertionError) as error:
        rule = f"must be a zip that {algo} saved"
        raise InputError(str(path), rule, str(error), "check file and --algo") from None


__all__ = ["SB3", "network_of", "network_of_zip"]
