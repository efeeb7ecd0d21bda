"""Pictures of an environment, as arrays or in a window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hatn_sim.datatypes import Lane
from hatn_sim.envs.episode import Episode
from hatn_sim.envs.errors import RenderError
from hatn_sim.envs.observation import Sight
from hatn_sim.envs.seen import Seen
from hatn_sim.envs.shown import seen_in
from hatn_sim.report.live import LiveSheet, live_moment, predicted_moment
from hatn_sim.road import Road


class View:
    """What `render` shows. A window is opened by the first `show`."""

    def __init__(self, lanes: Sequence[Lane], title: str) -> None:
        self._sheet = LiveSheet(lanes)
        self._title = title
        self._window: Window | None = None

    def picture_of(self, episode: Episode) -> np.ndarray:
        """The moment of an episode, as `picture`."""
        thought, mind = episode.thought, episode.mind
        sight, road = (thought and thought.sight), (mind and mind.road)
        is_advised = mind is not None and mind.advises
        return self.picture(seen_in(episode), sight, road, is_advised=is_advised)

    def picture(
        self, seen: Seen, sight: Sight | None, road: Road | None, *, is_advised: bool = True
    ) -> np.ndarray:
        """A moment [height, width, 3], as uint8."""
        scene, ego_id = seen.scene, seen.ego_id
        said = seen.advice.suggestions if seen.advice is not None else ()
        suggestion = next((one for one in said if one.action != "abstain"), None)
        if sight is None or road is None:
            moment = live_moment(scene, ego_id, suggestion)
        else:
            moment = predicted_moment(
                scene, ego_id, suggestion, road, sight.prediction, sight.graphs, sight.lines
            )
        moment = replace(moment, is_advised=is_advised)
        words = [self._title, f"t = {scene.time_s:.1f} s"]
        if ego_id in scene.ids:
            speed_mps = scene.speed_mps[scene.ids.index(ego_id)]
            words.append(f"ego: {ego_id} at {speed_mps:.1f} m/s")
        return self._sheet.picture(moment, "  ·  ".join(words))

    def show(self, picture: np.ndarray, rate_hz: float) -> None:
        """Puts a picture on the screen. Raises RenderError where there is none."""
        if self._window is None:
            self._window = Window(picture.shape[1], picture.shape[0], self._title)
        self._window.show(picture, rate_hz)

    def close(self) -> None:
        """Closes the window, if there is one."""
        window, self._window = self._window, None
        if window is not None:
            window.close()


class Window:
    """A window of pygame, which highway-env brings."""

    def __init__(self, width_px: int, height_px: int, title: str) -> None:
        """Raises RenderError where there is no screen."""
        import pygame

        self._pygame = pygame
        try:
            pygame.display.init()
            self._surface = pygame.display.set_mode((width_px, height_px))
        except pygame.error as error:
            raise RenderError(
                f"render_mode: 'human' needs a screen, found none ({error}); choose 'rgb_array'"
            ) from None
        pygame.display.set_caption(title)
        self._clock = pygame.time.Clock()

    def show(self, picture: np.ndarray, rate_hz: float) -> None:
        """Shows a picture, not sooner than 1 / rate after the one before."""
        pygame = self._pygame
        pygame.event.pump()
        pygame.surfarray.blit_array(self._surface, picture.swapaxes(0, 1))
        pygame.display.flip()
        self._clock.tick(rate_hz)

    def close(self) -> None:
        """May be called once."""
        self._pygame.display.quit()
