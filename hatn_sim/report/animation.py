"""A stretch of a run as a film: MP4 or GIF."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.ndimage import maximum_filter1d

from hatn_sim.datatypes import DT_S, FloatArray
from hatn_sim.errors import InputError
from hatn_sim.log import Run
from hatn_sim.report.film_file import Pixels, write_gif, write_mp4
from hatn_sim.report.moment import Moment, read_moments
from hatn_sim.report.picture import WIDE_M, WIDEST_M, caption, framed, holding, told_of

if TYPE_CHECKING:
    from PIL import Image

FILM_FRAMES: Final = 80
"""Eight seconds."""
GIF_WIDTH_PX: Final = 720
LONGEST_GIF: Final = 600
"""Frames; all of them are in memory at once."""
FRAMES_PER_S: Final = 10
SCALE_PX: Final = 120
SMOOTH_FRAMES: Final = 20
"""The camera follows the ego's mean place over so many frames before and behind."""
TURN_FRAMES: Final = 5
"""Where those told of change sides, the camera takes no less than so many before and behind."""


@dataclass(frozen=True)
class Stretch:
    """What of a run is shown: an ego from one frame up to another that is not."""

    ego_id: str
    start: int
    stop: int
    follow: bool = False  # the camera goes with the ego; else it stands over where it chooses
    speed: float = 1.0  # times real time

    @property
    def frames(self) -> range:
        return range(self.start, self.stop)


def around(run: Run, frame: int, ego_id: str, frames: int = FILM_FRAMES) -> Stretch:
    """The frames around a moment, a third of them before it; fewer where the run is shorter."""
    start = max(0, min(frame - frames // 3, run.frame_count - frames))
    return Stretch(ego_id, start, min(start + frames, run.frame_count))


def draw_animation(
    run: Run,
    stretch: Stretch,
    path: Path,
    tell: Callable[[int], None] = lambda _: None,
) -> None:
    """Draw a stretch into a .gif or .mp4; `tell` is told how many frames are done.

    The same log gives the same bytes.

    Raises:
        InputError: the ego is in none of these frames, a GIF would be too long, or as for
            `picture.draw_moment`.
        OSError: the file cannot be written.
    """
    if path.suffix == ".mp4":
        per_s = Fraction(stretch.speed).limit_denominator(1000) * FRAMES_PER_S
        write_mp4(path, _told(_pixels(run, stretch, path.suffix), tell), per_s)
        return
    if len(stretch.frames) > LONGEST_GIF:
        raise InputError(
            f"{path}: a GIF of {len(stretch.frames)} frames; expected {LONGEST_GIF} at most: name "
            "an .mp4, or a shorter stretch with --from and --to"
        )
    images = [_small(pixels) for pixels in _told(_pixels(run, stretch, path.suffix), tell)]
    write_gif(path, images, round(1000 * DT_S / stretch.speed), _scale_image(images[0].size[0]))


def _told(frames: Iterator[Pixels], tell: Callable[[int], None]) -> Iterator[Pixels]:
    for number, pixels in enumerate(frames, start=1):
        yield pixels
        tell(number)


def _pixels(run: Run, stretch: Stretch, suffix: str) -> Iterator[Pixels]:
    """The frames; the road is drawn once, only what moves is drawn again."""
    from hatn_sim.report.canvas import FILM, SCREEN
    from hatn_sim.report.moving_sheet import MovingSheet

    style = FILM if suffix == ".gif" else SCREEN
    wide, high = style.map_in
    centres, width_m, moments = _camera(run, stretch, wide / high)
    sheet = MovingSheet(style, run.lanes, centres[0], width_m, moves=stretch.follow)
    for moment, centre in zip(moments, centres, strict=False):
        yield sheet.draw(moment, caption(run, moment), centre)


def _camera(
    run: Run, stretch: Stretch, aspect: float
) -> tuple[FloatArray, float, Iterator[Moment] | Sequence[Moment]]:
    """Centres [N, 2] of the camera, the width of what it sees, and the moments to be shown."""
    frames = np.arange(stretch.start, stretch.stop)
    again = partial(read_moments, run, stretch.frames, stretch.ego_id)
    found = again()
    if stretch.ego_id in run.ids:
        ego = run.ids.index(stretch.ego_id)
        xy_m, seen = run.trajectories.xy_at(ego, frames)
        if not seen.any():
            raise InputError(
                f"{run.path}: vehicle {stretch.ego_id!r} is not in view in frames {stretch.start} "
                f"to {stretch.stop - 1}; name another vehicle or time"
            )
        if stretch.follow:
            return *_following(_smooth(frames, xy_m, seen), aspect, found), again()
    moments = list(found)
    with_ego = [moment for moment in moments if stretch.ego_id in moment.scene.ids]
    # What comes after the last choice is the ego on its way out of the picture.
    choosing = [moment for moment in with_ego if sum(slot.in_focus for slot in moment.slots) > 1]
    centre, width_m = framed(choosing or with_ego, aspect)
    return np.tile(centre, (len(frames), 1)), width_m, moments


def _smooth(frames: Any, xy_m: FloatArray, seen: Any) -> FloatArray:
    """The mean place of the ego around each frame; where it is out of view it stays."""
    near = np.arange(-SMOOTH_FRAMES, SMOOTH_FRAMES + 1)
    at = np.clip(frames[:, None] + near, frames[0], frames[-1])
    return np.stack(
        [np.interp(at, frames[seen], xy_m[seen, k]).mean(axis=1) for k in (0, 1)], axis=1
    )


def _following(
    centres: FloatArray, aspect: float, moments: Iterator[Moment]
) -> tuple[FloatArray, float]:
    """Centres [N, 2] that give way from those of the ego for whom it is told of, and the width.

    The way is given before it has to be, and slowly.
    """
    told = [told_of(moment) for moment in moments]
    wide = [holding(centre, WIDE_M, aspect, p)[1] for centre, p in zip(centres, told, strict=False)]
    width_m = max([WIDE_M, *(one for one in wide if one <= WIDEST_M)])
    aside = np.zeros_like(centres)
    for k, points in enumerate(told):
        held, needed_m = holding(centres[k], width_m, aspect, points)
        aside[k] = held - centres[k] if needed_m <= width_m else 0.0
    return centres + np.stack([_given_way(along) for along in aside.T], axis=1), width_m


def _given_way(aside_m: FloatArray) -> FloatArray:
    """[N] how far to one axis' side the camera goes where it has to go as far as told [N], or 0.

    Before and after it has to, it is as far aside as it will be or was; and it goes there slowly.
    Between two sides it turns half-way in time, as slowly as still holds both.
    """
    size = 2 * SMOOTH_FRAMES + 1
    up, down = (
        maximum_filter1d(np.maximum(sign * aside_m, 0.0), size, mode="nearest") for sign in (1, -1)
    )
    wanted = up - down
    has_to, torn = np.flatnonzero(aside_m), np.flatnonzero((up > 0.0) & (down > 0.0))
    for frame in torn:
        wanted[frame] = aside_m[has_to[np.abs(has_to - frame).argmin()]]
    frames = np.arange(len(wanted))
    reach = np.full(len(wanted), SMOOTH_FRAMES)
    for turn in np.flatnonzero(wanted[1:] * wanted[:-1] < 0.0) + 1:
        reach = np.minimum(reach, np.maximum(frames - turn, turn - 1 - frames))
    reach = np.maximum(reach, TURN_FRAMES)
    total = np.cumsum(np.pad(wanted, (SMOOTH_FRAMES + 1, SMOOTH_FRAMES), mode="edge"))
    first = frames + SMOOTH_FRAMES - reach
    mean: FloatArray = (total[first + 2 * reach + 1] - total[first]) / (2 * reach + 1)
    return mean


def _small(pixels: Pixels) -> Image.Image:
    from PIL import Image

    height_px = round(GIF_WIDTH_PX * pixels.shape[0] / pixels.shape[1])
    image = Image.fromarray(pixels)
    return image.resize((GIF_WIDTH_PX, height_px), Image.Resampling.LANCZOS)


def _scale_image(wide_px: int) -> Image.Image:
    """The colours of slots as they are in the legend and over asphalt."""
    from matplotlib.colors import to_rgb
    from PIL import Image

    from hatn_sim.report.canvas import ASPHALT, PROBABILITY
    from hatn_sim.report.drawing import STRIP_ALPHA

    pure = PROBABILITY(np.linspace(0.0, 1.0, wide_px))[None, :, :3]
    over = STRIP_ALPHA * pure + (1.0 - STRIP_ALPHA) * np.array(to_rgb(ASPHALT))
    rows = np.concatenate((pure, over)).repeat(SCALE_PX // 2, axis=0)
    return Image.fromarray((255.0 * rows).round().astype(np.uint8))
