"""What is shown of an episode: the slots that may be chosen, the observation, `info`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Dict

from hatn_sim.datatypes import DT_S, MAX_NODES, BoolArray
from hatn_sim.envs.episode import Episode
from hatn_sim.envs.observation import (
    Ego,
    Observation,
    admissible_slots,
    observe_slots,
    observe_vehicles,
)
from hatn_sim.envs.options import EnvOptions
from hatn_sim.envs.reward import Terms
from hatn_sim.envs.seen import Seen


def slots_now(episode: Episode) -> BoolArray:
    """The slots [M] that may be chosen; to yield alone where the ego is gone."""
    if episode.thought is None or episode.row is None:
        return np.arange(MAX_NODES) == 0
    return admissible_slots(episode.thought.sight, episode.row)


def observation_of(episode: Episode, space: Dict, options: EnvOptions) -> Observation:
    """All arrays of the space; 0 where the ego is gone."""
    row, thought, scene = episode.row, episode.thought, episode.frame.scene
    whole: Observation
    if row is None:
        whole = {key: np.zeros(box.shape or (), np.float32) for key, box in space.items()}
    else:
        left = 1.0 - episode.frames * DT_S / options.duration_s
        ego = Ego(row, episode.acceleration_mps2, left)
        if options.observation_form == "slots":
            assert thought is not None
            whole = observe_slots(scene, ego, thought.sight)
        else:
            whole = observe_vehicles(scene, ego)
    if options.action_form == "slot":
        whole["action_mask"] = slots_now(episode).astype(np.float32)
    return whole


def seen_in(episode: Episode) -> Seen:
    """The moment, as agents take it."""
    thought = episode.thought
    advice = None if thought is None else thought.advice
    return Seen(episode.ego_id, episode.frame.scene, advice)


def info_of(episode: Episode, terms: Terms, options: EnvOptions) -> dict[str, Any]:
    """What stands in `info`, `terms` being those of the step."""
    info: dict[str, Any] = {
        "seen": seen_in(episode),
        "ego_id": episode.ego_id,
        "seed": episode.seed,
        "time_s": episode.frame.scene.time_s,
        "end": episode.end,
        "reward_terms": terms.weighted(options.reward),
    }
    if options.action_form == "slot":
        info["action_mask"] = slots_now(episode).astype(np.int8)
    return info
