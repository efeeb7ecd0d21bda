"""PPO and DQN of stable-baselines3 on the lawful environment, until the time is up.

The only module that imports stable_baselines3, the extra `rl`.
"""

from __future__ import annotations

import json
import signal
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv
from torch import Tensor, nn

from hatn_sim.datatypes import MAX_NODES
from hatn_sim.envs.features import VEHICLES
from hatn_sim.errors import SimulatorError
from hatn_sim.policies.inputs import Layout
from hatn_sim.policies.lawful_env import BriefInfo, LawfulLevels
from hatn_sim.policies.network import HEAD_WIDTH, LAYERS, SETS, WIDTH, Network, save_network
from hatn_sim.whole_file import save_whole

Algorithm = Literal["ppo", "dqn"]
MakeEnv = Callable[[], LawfulLevels]
HEAD: Final = [HEAD_WIDTH, HEAD_WIDTH]
RECENT: Final = 50
"""Episodes that a row of the progress is the mean of."""
DISCOUNT: Final = 0.99
LEARNING_RATE: Final = 5e-4
ENTROPY: Final = 0.01
"""Both fall to 0 while a training with PPO goes on."""
ROLLOUT: Final = 1024
"""Decisions, of all environments, between the updates of PPO."""
SAVE_EVERY_S: Final = 60.0
START: Final = "spawn"
"""Simulators are not to be forked, nor what they share."""


@dataclass(frozen=True)
class Pace:
    """How long a training goes on: until the minutes or the decisions are used up."""

    minutes: float
    steps: int
    told_share: float = 0.0  # of it, at its beginning, with everybody's route told


@dataclass(frozen=True)
class Progress:
    """How the last `RECENT` episodes went, exploring."""

    minutes: float
    steps: int
    episodes: int
    time_s: float  # until the end, whatever it was
    arrived: float  # share
    collided: float  # share
    reward: float  # of an episode


class Sets(BaseFeaturesExtractor):
    """`Network` up to its head, to be trained."""

    def __init__(self, space: Any, sees_predictions: bool) -> None:
        super().__init__(space, len(SETS) * WIDTH)
        layout = Layout(sees_predictions)
        self._parts = layout.parts()
        self.own = _layers(layout.own, LAYERS["own"])
        self.slot = _layers(layout.slot, LAYERS["slot"])
        self.other = _layers(layout.other, LAYERS["other"])

    def forward(self, rows: Tensor) -> Tensor:
        """Features [B, 3 WIDTH] of rows [B, layout.size]."""
        own, slots, slot_mask, others, other_mask = (rows[:, part] for part in self._parts)
        return torch.cat(
            (
                self.own(own),
                _most(self.slot(slots.unflatten(1, (MAX_NODES, -1))), slot_mask),
                _most(self.other(others.unflatten(1, (VEHICLES, -1))), other_mask),
            ),
            dim=1,
        )


def _layers(inner: int, count: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for k in range(count):
        layers += [nn.Linear(inner if k == 0 else WIDTH, WIDTH), nn.ReLU()]
    return nn.Sequential(*layers)


def _most(rows: Tensor, mask: Tensor) -> Tensor:
    return (rows * mask[..., None]).amax(dim=1)


def _brief(make_env: MakeEnv) -> BriefInfo:
    torch.set_num_threads(1)  # networks are small: more threads only wait for each other
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C is for who has begun all this
    return BriefInfo(make_env())


@contextmanager
def side_by_side(makers: Sequence[MakeEnv]) -> Generator[VecEnv]:
    """Environments in a process each; makers travel there, as pickles.

    Raises SimulatorError where one of the processes dies.
    """
    envs: SubprocVecEnv | None = None
    is_in_order = False
    try:
        with _ctrl_c_later():
            envs = SubprocVecEnv([partial(_brief, one) for one in makers], START)
        yield envs
        is_in_order = True
    except (EOFError, ConnectionError) as error:
        raise SimulatorError(
            "train-policy: the process of an environment died; what was learnt up to the last time "
            "that weights were written is kept"
        ) from error
    finally:
        if envs is not None:
            _end(envs, is_in_order and not envs.waiting)


@contextmanager
def _ctrl_c_later() -> Generator[None]:
    """Processes that start in here never hear of ctrl-C; whoever starts them does afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end(envs: SubprocVecEnv, is_in_order: bool) -> None:
    """Closes environments; where nobody knows who has answered, ends their processes."""
    if is_in_order:
        envs.close()
        return
    for process in envs.processes:
        process.terminate()
    for process in envs.processes:
        process.join()


def make_learner(algorithm: Algorithm, envs: VecEnv, layout: Layout, seed: int) -> BaseAlgorithm:
    """A learner that knows nothing yet, with its environments."""
    torch.set_num_threads(1)
    common: dict[str, Any] = {"gamma": DISCOUNT, "seed": seed, "device": "cpu"}
    networks: dict[str, Any] = {
        "features_extractor_class": Sets,
        "features_extractor_kwargs": {"sees_predictions": layout.sees_predictions},
        "activation_fn": nn.ReLU,
        "net_arch": HEAD,
    }
    if algorithm == "ppo":
        return PPO(
            "MlpPolicy",
            envs,
            n_steps=ROLLOUT // envs.num_envs,
            batch_size=128,
            n_epochs=8,
            learning_rate=LEARNING_RATE,
            gae_lambda=0.95,
            ent_coef=ENTROPY,
            policy_kwargs=networks | {"share_features_extractor": False},
            **common,
        )
    return DQN(
        "MlpPolicy",
        envs,
        learning_rate=4e-4,
        buffer_size=100_000,
        learning_starts=1000,
        batch_size=128,
        train_freq=2,
        gradient_steps=envs.num_envs,
        target_update_interval=500,
        exploration_fraction=0.3,
        exploration_final_eps=0.03,
        policy_kwargs=networks,
        **common,
    )


def network_of(learner: BaseAlgorithm, layout: Layout, card: dict[str, Any]) -> Network:
    """What a learner has learnt, as it drives."""
    if isinstance(learner, PPO):
        policy = learner.policy
        sets = policy.pi_features_extractor
        head = [*policy.mlp_extractor.policy_net, policy.action_net]
    else:
        assert isinstance(learner, DQN)
        sets, head = learner.q_net.features_extractor, [*learner.q_net.q_net]
    assert isinstance(sets, Sets)
    parts = {"own": sets.own, "slot": sets.slot, "other": sets.other, "head": head}
    tensors: dict[str, np.ndarray] = {}
    for part, modules in parts.items():
        linear = [one for one in modules if isinstance(one, nn.Linear)]
        for layer, one in enumerate(linear):
            tensors[f"{part}.{layer}.weight"] = one.weight.detach().numpy().copy()
            tensors[f"{part}.{layer}.bias"] = one.bias.detach().numpy().copy()
    return Network(layout, tensors, card)


def learn(
    learner: BaseAlgorithm,
    pace: Pace,
    watch: Callable[[Progress], object],
    keep: Callable[[], object],
) -> list[Progress]:
    """Learns until the time or the decisions are used up; `keep` is called now and then."""
    diary = _Diary(pace, watch, keep)
    if isinstance(learner, PPO):
        learner.lr_schedule = lambda _: LEARNING_RATE * diary.left
    learner.learn(pace.steps, callback=diary)
    keep()
    return diary.rows


class _Diary(BaseCallback):
    """Notes how episodes end, and ends the training in time."""

    def __init__(
        self,
        pace: Pace,
        watch: Callable[[Progress], object],
        keep: Callable[[], object],
    ) -> None:
        super().__init__()
        self.rows: list[Progress] = []
        self._pace, self._watch, self._keep = pace, watch, keep
        self._are_told = pace.told_share > 0.0
        self._began = self._kept = time.monotonic()
        self._recent: deque[tuple[float, bool, bool, float]] = deque(maxlen=RECENT)
        self._episodes = 0
        self._reward = np.zeros(0)

    @property
    def left(self) -> float:
        """The share of the training that is left, by time or by decisions, whichever is less."""
        used = (time.monotonic() - self._began) / (60.0 * self._pace.minutes)
        return max(1.0 - max(used, self.num_timesteps / self._pace.steps), 0.0)

    def _on_rollout_start(self) -> None:
        if self._are_told and 1.0 - self.left > self._pace.told_share:
            self._are_told = False
            self.training_env.env_method("infer_lines")

    def _on_rollout_end(self) -> None:
        if isinstance(self.model, PPO):
            self.model.ent_coef = ENTROPY * self.left

    def _on_training_start(self) -> None:
        self._reward = np.zeros(self.training_env.num_envs)

    def _on_step(self) -> bool:
        self._reward += self.locals["rewards"]
        ended = zip(self.locals["dones"], self.locals["infos"], strict=True)
        for k, (is_over, info) in enumerate(ended):
            if is_over:
                self._note(info, float(self._reward[k]))
                self._reward[k] = 0.0
        now = time.monotonic()
        if now - self._kept > SAVE_EVERY_S:
            self._kept = now
            self._keep()
        return now - self._began < 60.0 * self._pace.minutes

    def _note(self, info: dict[str, Any], reward: float) -> None:
        end = info["end"]
        self._recent.append((info["driven_s"], end == "arrived", end == "collision", reward))
        self._episodes += 1
        if self._episodes % 10 == 0:
            minutes = (time.monotonic() - self._began) / 60.0
            means = np.array(self._recent, np.float64).mean(axis=0).tolist()
            row = Progress(minutes, self.num_timesteps, self._episodes, *means)
            self.rows.append(row)
            self._watch(row)


def write_progress(path: Path, rows: Sequence[Progress]) -> None:
    """One line of JSON for each row. Raises InputError where that cannot be."""
    save_whole(path, "".join(json.dumps(asdict(row)) + "\n" for row in rows))


def write_policy(
    path: Path, learner: BaseAlgorithm, layout: Layout, card: dict[str, Any]
) -> Network:
    """Writes what was learnt, with its card. Raises InputError where that cannot be."""
    network = network_of(learner, layout, card)
    save_network(path, network)
    return network
