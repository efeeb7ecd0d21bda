"""A scene as a gymnasium environment: one vehicle of it is driven, and advised at every step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, Literal, cast

import gymnasium
import numpy as np

from hatn_sim.datatypes import DT_S, BoolArray, Frame
from hatn_sim.envs import SCENES
from hatn_sim.envs.action import Slots, action_space
from hatn_sim.envs.driving import driven, plan_of
from hatn_sim.envs.ego import begin_episode
from hatn_sim.envs.episode import TERMINAL, Episode
from hatn_sim.envs.errors import EpisodeOverError, NeedsResetError, OptionError, RenderError
from hatn_sim.envs.features import observation_space, observation_table
from hatn_sim.envs.mind import conclude, open_mind, predictor_of
from hatn_sim.envs.observation import (
    Observation,
)
from hatn_sim.envs.options import read_options
from hatn_sim.envs.reward import Terms
from hatn_sim.envs.seeds import number_of
from hatn_sim.envs.shown import info_of, observation_of, slots_now
from hatn_sim.envs.traffic import check_scene, ego_of, scenario_of, warm_up_s
from hatn_sim.envs.turns import Turn, taken
from hatn_sim.loop import KEPT_LINES, RELEASE_FRAMES, LineSource
from hatn_sim.planning.situation import Situation, on_route, situation_of
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_config import MAX_SEED
from hatn_sim.traffic import open_traffic

if TYPE_CHECKING:
    from hatn_sim.envs.view import View

Reset = tuple[Observation, dict[str, Any]]
Step = tuple[Observation, float, bool, bool, dict[str, Any]]
FEW_LINES: Final = 48
"""Of no more reference lines it is found out at once where they meet: a second's work."""


class SceneEnv(gymnasium.Env[Observation, Any]):
    """One vehicle drives, everybody else is the simulator's.

    Made by `gymnasium.make("hatn_sim/Scene-v0", scene=..., ...)`, after `import hatn_sim.envs`.
    `hatn_sim.envs.options` has the table of options, `hatn_sim.envs.action` that of actions,
    `hatn_sim.envs.reward` that of the reward's terms; the weighted ones are in `info`.

    **Episode.** Traffic builds up, the ego comes, and `reset` returns the first frame it is in. It
    is terminated when the ego arrives or touches somebody, and truncated after `duration_s`, when
    the scene is over or when the simulator has taken the ego off the road. `info["end"]` says
    which: "arrived", "collision", "time", "over", "gone", and "" before.

    **Info.** `seen`: a `Seen`, the scene and the typed advice as agents take them; `ego_id`;
    `seed`, with which `reset` repeats the episode; `time_s` of the scene; `end`;
    `reward_terms`; with `slot` actions `action_mask`, as int8.

    **Errors.** See `hatn_sim.envs.errors`; all are `HatnSimError`s of one line.

    **Observation.**

    TABLE

    **Versions.** v0: the first.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as gymnasium has it
        "render_modes": ["rgb_array", "human"],
        "render_fps": 10,
    }

    def __init__(
        self, render_mode: str | None = None, registered_as: str | None = None, **options: Any
    ) -> None:
        """`registered_as` is the name by which it is made, where that stands for one scene.

        Raises OptionError or another InputError for what is wrong with the options.
        """
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise OptionError(f"render_mode: expected one of {modes}, found {render_mode!r}")
        self.options = read_options(options)
        if registered_as is not None:
            check_scene(registered_as, SCENES[registered_as]["scene"], self.options)
        self.scenario = scenario_of(self.options)
        self.render_mode = render_mode
        self.metadata = self.metadata | {
            "render_fps": max(round(1.0 / (DT_S * self.options.frames_per_step)), 1)
        }
        form = self.options.action_form
        self.action_space = action_space(form)
        space: Any = observation_space(self.options.observation_form, form == "slot")
        self.observation_space = space
        self._predictor = predictor_of(self.options.predictor)
        self._simulator = open_traffic(self.scenario)
        self._episode: Episode | None = None
        self._on_this_road: Sequence[SceneEnv] = (self,)
        self._view: View | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Pickled and copied, even shallowly, it is at rest; a named predictor is loaded again."""
        if isinstance(self._simulator, SumoSimulator):
            self._simulator.check_at_rest()
        is_named = self._episode is None and isinstance(self.options.predictor, str)
        return self.__dict__ | ({"_predictor": None} if is_named else {})

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self._predictor is None:
            self._predictor = predictor_of(self.options.predictor)

    # -- gymnasium ------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Reset:
        """A new episode, of this seed or of one drawn from the environment's random numbers.

        Any seed from 0 on has an episode of its own; `info["seed"]` is what the simulator was given
        for it (see `seeds.number_of`), and repeats it.

        Raises EgoError where the ego never comes, OptionError where anything is in `options`; else
        as the simulator's `reset`.
        """
        if options:
            raise OptionError(
                f"reset: expected no options, found {sorted(options)}; give them when making the "
                "environment"
            )
        return taken([self.opening(seed)])[0]

    def opening(self, seed: int | None = None) -> Turn[Reset]:
        """What `reset` does, as a `Turn`."""
        yield None
        super().reset(seed=seed)
        self._episode = None
        drawn = int(self.np_random.integers(MAX_SEED + 1))
        number = drawn if seed is None else number_of(seed)
        yield None
        ego_id, frames = begin_episode(
            self._simulator,
            number,
            ego_of(self.options, self.scenario),
            self.options.ego_id,
            round(warm_up_s(self.options, self.scenario) / DT_S),
            np.random.default_rng(number),  # so that the number alone repeats the episode
        )
        road = self._simulator.road
        self._release_lines()
        mind = None
        if self._predictor is not None:
            lines = cast(LineSource, self.options.lines)
            advises = self.options.advice
            mind = open_mind(self._predictor, lines, ego_id, road, frames[:-1], advises=advises)
        episode = Episode(ego_id, number, road, frames[-1], mind)
        episode.begin()
        yield from self._think(episode, frames[-1:])
        if mind is not None:
            road.find_all_conflicts(FEW_LINES)  # not in the episodes to come, one by one
        self._episode = episode
        observation = self._observation(episode)
        if self.render_mode == "human":
            self._show(episode)
        return observation, info_of(episode, Terms(), self.options)

    def step(self, action: Any) -> Step:
        """Drives on for `frames_per_step` frames, or until the episode ends.

        Raises NeedsResetError, EpisodeOverError, ActionError; else as the simulator's `step`.
        """
        return taken([self.turn(action)])[0]

    def turn(self, action: Any) -> Turn[Step]:
        """What `step` does, as a `Turn`; one that is not finished ends the episode."""
        episode = self._running()
        if episode.is_over:
            raise EpisodeOverError(
                f"step: the episode is over ({episode.end}); expected a call of reset before"
            )
        plan = plan_of(episode, action, self.action_space, self.options)
        terms = Terms()
        yield None
        try:
            count = self.options.frames_per_step
            plans = {episode.ego_id: plan}
            come = driven(self._simulator, episode.frame, plans, count)
            yield None
            frames: list[Frame] = []
            for frame in come():
                frames.append(frame)
                terms += episode.advance(frame, self.options)
                if episode.is_over:
                    break
            yield from self._think(episode, frames)
            if episode.frames // RELEASE_FRAMES > (episode.frames - len(frames)) // RELEASE_FRAMES:
                self._release_lines()
        except BaseException:
            self._episode = None  # nobody knows how far it got
            raise
        reward = sum(terms.weighted(self.options.reward).values())
        is_terminal = episode.end in TERMINAL
        observation = self._observation(episode)
        if self.render_mode == "human":
            self._show(episode)
        cut = episode.is_over and not is_terminal
        return observation, reward, is_terminal, cut, info_of(episode, terms, self.options)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The moment as a picture [height, width, 3] in the mode `rgb_array`.

        In the mode `human` it is on the screen already. Raises NeedsResetError before `reset`,
        RenderError without a mode.
        """
        episode = self._running("render")
        if self.render_mode is None:
            raise RenderError("render: expected a render_mode; make the environment with one")
        if self.render_mode == "human":
            return None
        return self._picture(episode)

    def close(self) -> None:
        """Ends the simulator. May be called again; `reset` starts it anew."""
        self._episode = None
        self._simulator.close()
        view, self._view = self._view, None
        if view is not None:
            view.close()

    def share_road(self, others: Sequence[SceneEnv]) -> None:
        """Has lines drawn once for environments of one scene, this one among them.

        So all of them can be seen at once. Without effect where SUMO does not drive.
        """
        first = others[0]._simulator
        if isinstance(self._simulator, SumoSimulator) and isinstance(first, SumoSimulator):
            self._simulator.share_road(first)
            self._on_this_road = others

    @property
    def road(self) -> Road:
        """Of the scene. Raises NeedsResetError."""
        return self._running().road

    @property
    def frame(self) -> Frame:
        """The last one, its `Truth` included: for judges, not for planners. As `road`."""
        return self._running().frame

    def situation(self, has_stopped: bool) -> Situation | None:
        """What the ego sees on its own way; None where it is gone, or on no line.

        `has_stopped`: a step ago, at the stop line ahead. Raises NeedsResetError.
        """
        episode = self._running()
        if episode.thought is None or episode.row is None:
            return None
        road, row, scene = episode.road, episode.row, episode.frame.scene
        route = episode.frame.truth.routes[row]
        lines = on_route(road, scene, episode.thought.sight.lines, row, route)
        return situation_of(road, scene, lines, row, has_stopped)

    def action_masks(self) -> BoolArray:
        """The slots [M] that may be chosen now, as sb3-contrib asks for them."""
        if not isinstance(self.action_space, Slots):
            raise OptionError("action_masks: expected the environment's action to be 'slot'")
        return self.action_space.admissible.copy()

    # -- what is shown of it ----------------------------------------------------------------------

    def _think(self, episode: Episode, frames: Sequence[Frame]) -> Turn[None]:
        """Decides at the last of the frames since it last did; the mask of actions is its."""
        episode.thought = None
        if episode.mind is not None and episode.row is not None:
            foreseen = yield episode.mind, frames
            assert foreseen is not None
            mind, prediction = foreseen
            episode.mind, episode.thought = conclude(mind, frames[-1].scene, prediction)
        if isinstance(self.action_space, Slots):
            self.action_space.admissible = slots_now(episode)

    def _release_lines(self) -> None:
        """Lets go of the reference lines that nobody on this road has been near for long."""
        road, held = self._simulator.road, [np.zeros(0, np.int64)]
        for env in self._on_this_road:
            if env._episode is not None and env._episode.mind is not None:
                held.append(env._episode.mind.state.perception.line_state.line.ravel())
        road.touch(np.concatenate(held))
        # What others on this road drew since they last concluded is as young as their step.
        road.release(RELEASE_FRAMES * len(self._on_this_road), KEPT_LINES)

    def _observation(self, episode: Episode) -> Observation:
        space = cast(gymnasium.spaces.Dict, self.observation_space)
        return observation_of(episode, space, self.options)

    def _running(self, what: Literal["step", "render"] = "step") -> Episode:
        if self._episode is None:
            raise NeedsResetError(f"{what}: there is no episode; expected a call of reset before")
        return self._episode

    def _picture(self, episode: Episode) -> np.ndarray:
        from hatn_sim.envs.view import View

        if self._view is None:
            self._view = View(list(self._simulator.road.lanes.values()), self.scenario.title)
        return self._view.picture_of(episode)

    def _show(self, episode: Episode) -> None:
        picture = self._picture(episode)
        assert self._view is not None
        self._view.show(picture, self.metadata["render_fps"])


SceneEnv.__doc__ = (SceneEnv.__doc__ or "").replace(
    "TABLE", observation_table().replace("\n", "\n    ")
)
