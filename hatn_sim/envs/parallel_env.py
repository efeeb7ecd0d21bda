"""Several driven vehicles in one scene, as a parallel environment of PettingZoo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, Literal, cast

import numpy as np

from hatn_sim.datatypes import DT_S, Frame
from hatn_sim.envs.action import Slots, action_space
from hatn_sim.envs.driving import driven, plan_of
from hatn_sim.envs.ego import begin_together
from hatn_sim.envs.episode import TERMINAL, Episode
from hatn_sim.envs.errors import (
    ActionError,
    ActionTypeError,
    EpisodeOverError,
    MissingPackageError,
    NeedsResetError,
    OptionError,
    RenderError,
)
from hatn_sim.envs.features import observation_space
from hatn_sim.envs.mind import Mind, Thought, glance, open_mind, predictor_of, think
from hatn_sim.envs.observation import Observation
from hatn_sim.envs.options import read_options
from hatn_sim.envs.reward import Terms
from hatn_sim.envs.seeds import number_of
from hatn_sim.envs.shown import info_of, observation_of, slots_now
from hatn_sim.envs.traffic import scenario_of, warm_up_s
from hatn_sim.errors import nearest
from hatn_sim.loop import KEPT_LINES, RELEASE_FRAMES, LineSource
from hatn_sim.simulators.highway_scene import ego_name
from hatn_sim.simulators.sumo_config import MAX_SEED
from hatn_sim.traffic import open_traffic

try:
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as error:
    if error.name != "pettingzoo":
        raise
    raise MissingPackageError(
        "several egos need PettingZoo, which is not installed: pip install 'hatn-sim[marl]'"
    ) from None

if TYPE_CHECKING:
    from hatn_sim.envs.view import View

MOST_EGOS: Final = 64
_Infos = dict[str, dict[str, Any]]


class SceneParallelEnv(ParallelEnv[str, Observation, Any]):
    """Several vehicles of one scene are driven at once, everybody else is the simulator's.

        from hatn_sim.envs.parallel_env import SceneParallelEnv

        env = SceneParallelEnv(scene="intersection5", egos=4, predictor="hatn")

    Options are those of `hatn_sim.envs.options`, but for `ego` and `ego_id`: all egos are spawned,
    into scenes of SUMO; of highway-env they are its own `controlled_vehicles`. What an agent
    observes, does and earns is as in `SceneEnv`, each for itself. There is one simulator, and one
    prediction of everybody for all agents.

    **Agents** are "ego", "ego2", "ego3" ..., which are the ids of their vehicles, too. They begin
    together, in the first frame that all of them are in, and leave one by one: terminated when they
    arrive or touch somebody, truncated as in `SceneEnv`. What all of them observe is the end of the
    step, also of those that left in it, whose vehicle is the simulator's from then on.

    **Reset.** The seed alone says what happens; `info` tells it. `options` are ignored, as in
    PettingZoo's own environments.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as pettingzoo has it
        "name": "hatn_sim_scene_v0",
        "render_modes": ["rgb_array", "human"],
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(self, egos: int = 2, render_mode: str | None = None, **options: Any) -> None:
        """Raises OptionError or another InputError for what is wrong with the options."""
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise OptionError(f"render_mode: expected one of {modes}, found {render_mode!r}")
        if isinstance(egos, bool) or not isinstance(egos, int) or not 1 <= egos <= MOST_EGOS:
            raise OptionError(f"egos: expected a whole number, 1 to {MOST_EGOS}, found {egos!r}")
        for key in ("ego", "ego_id"):
            if key in options:
                raise OptionError(f"{key}: all egos are spawned here; leave it out")
        self.options = read_options(options)
        self.scenario = scenario_of(self.options)
        if self.scenario.recorded is not None:
            raise OptionError(
                f"{self.scenario.name}: a recording has nobody but those recorded, expected a "
                "scene into which egos can be spawned; choose one of SUMO"
            )
        self.render_mode = render_mode
        self.metadata = self.metadata | {
            "render_fps": max(round(1.0 / (DT_S * self.options.frames_per_step)), 1)
        }
        self.possible_agents = list(map(ego_name, range(egos)))
        self.agents: list[str] = []
        form = self.options.action_form
        self.observation_spaces = {}
        self.action_spaces = {name: action_space(form) for name in self.possible_agents}
        for name in self.possible_agents:
            space: Any = observation_space(self.options.observation_form, form == "slot")
            self.observation_spaces[name] = space
        self._predictor = predictor_of(self.options.predictor)
        self._simulator = open_traffic(self.scenario)
        self._random = np.random.default_rng()
        self._episodes: dict[str, Episode] = {}  # of those who are still driving
        self._last: Episode | None = None  # whose moment is shown
        self._view: View | None = None

    # -- pettingzoo -------------------------------------------------------------------------------

    def observation_space(self, agent: str) -> Any:
        """A `Dict`, the same object at every call; so is `action_space`."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """`Slots` or `Box`, see `hatn_sim.envs.action`."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], _Infos]:
        """A new episode, of this seed or of one drawn from the environment's random numbers.

        Seeds are taken as by `SceneEnv.reset`.

        Raises EgoError where not all egos come, OptionError where the scene has no place for them;
        else as the simulator's `reset`.
        """
        self._episodes, self._last, self.agents = {}, None, []
        if seed is not None:
            self._random = np.random.default_rng(seed)
        drawn = int(self._random.integers(MAX_SEED + 1))
        number = drawn if seed is None else number_of(seed)
        names, frames = begin_together(
            self._simulator,
            number,
            len(self.possible_agents),
            round(warm_up_s(self.options, self.scenario) / DT_S),
            np.random.default_rng(number),  # so that the number alone repeats the episode
        )
        road = self._simulator.road
        road.release(RELEASE_FRAMES, KEPT_LINES)
        mind = None
        if self._predictor is not None:
            lines = cast(LineSource, self.options.lines)
            advises = self.options.advice
            egos = frozenset(names)
            mind = open_mind(self._predictor, lines, egos, road, frames[:-1], advises=advises)
        episodes = {name: Episode(name, number, road, frames[-1], mind) for name in names}
        for episode in episodes.values():
            episode.begin()
        self._think(episodes, mind, frames[-1])
        self._episodes, self._last = episodes, episodes[names[0]]
        self.agents = list(names)
        infos = {name: info_of(one, Terms(), self.options) for name, one in episodes.items()}
        observations = self._observations(episodes)
        if self.render_mode == "human":
            self._show()
        return observations, infos

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], _Infos]:
        """Drives on for `frames_per_step` frames, or until nobody is left.

        Raises NeedsResetError, EpisodeOverError, ActionError; else as the simulator's `step`.
        """
        episodes = self._running()
        if not episodes:
            raise EpisodeOverError("step: all agents have left; expected a call of reset before")
        self._check(actions)
        first = next(iter(episodes.values()))
        plans = {
            name: plan_of(one, actions[name], self.action_spaces[name], self.options)
            for name, one in episodes.items()
        }
        terms = dict.fromkeys(episodes, Terms())
        mind, frame = first.mind, first.frame
        try:
            count = self.options.frames_per_step
            for k, now in enumerate(driven(self._simulator, frame, plans, count)()):
                if k and mind is not None:
                    mind = glance(mind, frame)
                frame = now
                for name, one in episodes.items():
                    if not one.is_over:
                        terms[name] += one.advance(now, self.options)
                if all(one.is_over for one in episodes.values()):
                    break
                if max(one.frames for one in episodes.values()) % RELEASE_FRAMES == 0:
                    self._simulator.road.release(RELEASE_FRAMES, KEPT_LINES)
            self._think(episodes, mind, frame)
        except BaseException:
            self._episodes, self._last, self.agents = {}, None, []  # nobody knows how far they got
            raise
        infos = {name: info_of(one, terms[name], self.options) for name, one in episodes.items()}
        rewards = {name: float(sum(info["reward_terms"].values())) for name, info in infos.items()}
        observations = self._observations(episodes)
        terminated = {name: one.end in TERMINAL for name, one in episodes.items()}
        truncated = {name: one.is_over and not terminated[name] for name, one in episodes.items()}
        self._episodes = {name: one for name, one in episodes.items() if not one.is_over}
        self._last = next(iter(self._episodes.values()), self._last)
        self.agents = list(self._episodes)
        if self.render_mode == "human":
            self._show()
        return observations, rewards, terminated, truncated, infos

    def render(self) -> np.ndarray | None:
        """The moment as a picture [height, width, 3] in the mode `rgb_array`, with the first agent.

        In the mode `human` it is on the screen already. Raises NeedsResetError before `reset`,
        RenderError without a mode.
        """
        self._running("render")
        if self.render_mode is None:
            raise RenderError("render: expected a render_mode; make the environment with one")
        return None if self.render_mode == "human" else self._picture()

    def close(self) -> None:
        """Ends the simulator. May be called again; `reset` starts it anew."""
        self._episodes, self._last, self.agents = {}, None, []
        self._simulator.close()
        view, self._view = self._view, None
        if view is not None:
            view.close()

    # -- one moment -------------------------------------------------------------------------------

    def _running(self, what: Literal["step", "render"] = "step") -> dict[str, Episode]:
        if self._last is None:
            raise NeedsResetError(f"{what}: there is no episode; expected a call of reset before")
        return self._episodes

    def _check(self, actions: object) -> None:
        if not isinstance(actions, Mapping):
            raise ActionTypeError(
                f"actions: expected one by each agent's name, found {actions!r}; give a dict"
            )
        for name in actions:
            if name not in self.agents:
                raise ActionError(
                    f"actions: there is no agent {name!r}{nearest(str(name), self.agents)}"
                )
        if missing := [name for name in self.agents if name not in actions]:
            raise ActionError(
                f"actions: expected one of each agent, none found of {missing[0]!r}; add it"
            )

    def _think(self, episodes: Mapping[str, Episode], mind: Mind | None, frame: Frame) -> None:
        """One prediction for all; the masks of actions are those of this frame."""
        thought: Thought | None = None
        if mind is not None and not episodes.keys().isdisjoint(frame.scene.ids):
            mind, thought = think(mind, frame)
        for name, one in episodes.items():
            one.frame, one.mind, one.thought = frame, mind, thought
            space = self.action_spaces[name]
            if isinstance(space, Slots):
                space.admissible = slots_now(one)

    def _observations(self, episodes: Mapping[str, Episode]) -> dict[str, Observation]:
        return {
            name: observation_of(one, self.observation_space(name), self.options)
            for name, one in episodes.items()
        }

    def _picture(self) -> np.ndarray:
        from hatn_sim.envs.view import View

        assert self._last is not None
        if self._view is None:
            self._view = View(list(self._simulator.road.lanes.values()), self.scenario.title)
        return self._view.picture_of(self._last)

    def _show(self) -> None:
        picture = self._picture()
        assert self._view is not None
        self._view.show(picture, self.metadata["render_fps"])
