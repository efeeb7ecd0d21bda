"""Somebody's own environment of highway-env, with predictions added to what it observes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from hatn_sim.datatypes import DT_S, Frame, Predictor
from hatn_sim.envs.errors import NeedsResetError, OptionError
from hatn_sim.envs.features import observation_space, observation_table
from hatn_sim.envs.mind import Mind, glance, open_mind, predictor_of, think
from hatn_sim.envs.observation import Ego, observe_slots
from hatn_sim.envs.seen import Seen
from hatn_sim.errors import InputError
from hatn_sim.loop import KEPT_LINES, RELEASE_FRAMES
from hatn_sim.simulators.highway_scene import EGO
from hatn_sim.simulators.highway_watched import Watched

OWN_KEY: Final = "observation"


class PredictionObservation(
    gymnasium.Wrapper[dict[str, Any], Any, Any, Any], RecordConstructorArgs
):
    """Adds ego, neighbours, slots and predicted trajectories to what an environment observes.

        env = gymnasium.make("intersection-v2", config={"duration": 20})
        env = PredictionObservation(env, predictor="hatn")
        observation, info = env.reset(seed=1)
        observation["observation"]  # the environment's own, untouched
        observation["trajectories"], observation["mode_probability"]

    Actions, rewards, ends, random numbers and pictures stay those of the environment, whatever its
    settings and the wrappers inside this one. The lanes come from its road; predictions are made
    at every step from what was to be seen at 0.1 s a frame since `reset`: right after it there is
    no history yet. Everything is as seen by its first controlled vehicle.

    `info["seen"]` is a `Seen`, the scene and the typed advice as agents take them.

    **Observation.** "observation" is the environment's own. The others:

    TABLE

    (without the `action_mask`: actions are the environment's)

    **Versions.** v0: the first.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], predictor: str | Predictor = "hatn") -> None:
        """`predictor` is a name, `module:Class`, or a predictor.

        Raises OptionError where there is no such predictor, where the environment is none of
        highway-env with roads or has predictions already, or where its steps are no multiples of
        0.1 s.
        """
        _check_bare(env)
        RecordConstructorArgs.__init__(self, predictor=predictor)
        super().__init__(env)
        try:
            self._watched = Watched(env.unwrapped)
        except InputError as error:
            raise OptionError(f"PredictionObservation: {error}") from None
        found = predictor_of(predictor)
        if found is None or not hasattr(found, "observe"):
            raise OptionError(
                f"predictor: expected a name, module:Class or a predictor, found {found!r}"
            )
        self._predictor = found
        ours = observation_space("slots", has_slots=False)
        self.observation_space = gymnasium.spaces.Dict(
            {OWN_KEY: env.observation_space, **ours.spaces}
        )
        self._mind: Mind | None = None
        self._newest: Frame | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """As the environment's own.

        Raises InputError where `options` set rates with which steps are no multiples of 0.1 s.
        """
        return self._begin(*self.env.reset(seed=seed, options=options))

    def _begin(self, own: Any, info: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        frame = self._watched.begin()
        road = self._watched.road
        road.release(RELEASE_FRAMES, KEPT_LINES)
        mind = open_mind(self._predictor, "inferred", EGO, road)
        return self._seen(own, info, mind, [frame])

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """As the environment's own. Raises NeedsResetError before the first `reset`."""
        if self._mind is None or self._newest is None:
            raise NeedsResetError("step: there is no episode; expected a call of reset before")
        own, reward, terminated, truncated, info = self.env.step(action)
        if self._watched.is_begun_anew:
            observation, info = self._begin(own, info)
            return observation, reward, terminated, truncated, info
        frames = [self._newest, *self._watched.frames()]
        mind = self._mind
        for frame in frames[1:-1]:
            mind = glance(mind, frame)
        observation, info = self._seen(own, info, mind, frames)
        return observation, reward, terminated, truncated, info

    def _seen(
        self, own: Any, info: dict[str, Any], mind: Mind, frames: Sequence[Frame]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """What is observed at the last of the frames, on which the mind has not thought yet."""
        now = frames[-1]
        self._mind, thought = think(mind, now)
        self._newest = now
        speeds_mps = [one.scene.speed_mps[one.scene.ids.index(EGO)] for one in frames[-2:]]
        acceleration_mps2 = float(speeds_mps[-1] - speeds_mps[0]) / DT_S
        ego = Ego(now.scene.ids.index(EGO), acceleration_mps2, self._watched.time_left)
        observation = {OWN_KEY: own, **observe_slots(now.scene, ego, thought.sight)}
        return observation, {**info, "seen": Seen(EGO, now.scene, thought.advice)}


def _check_bare(env: gymnasium.Env[Any, Any]) -> None:
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, PredictionObservation):
            raise OptionError(
                "PredictionObservation: the environment has predictions already, expected one "
                "without; wrap it once"
            )
        env = env.env


PredictionObservation.__doc__ = (PredictionObservation.__doc__ or "").replace(
    "TABLE", observation_table().replace("\n", "\n    ")
)
