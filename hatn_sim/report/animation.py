"""A stretch of a run as a short animation (GIF)."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray
from hatn_sim.errors import InputError
from hatn_sim.log import Run
from hatn_sim.log.road_file import ROAD_FILE, read_road
from hatn_sim.report.moment import Moment, read_moments
from hatn_sim.report.picture import camera, caption
from hatn_sim.whole_file import save_whole

if TYPE_CHECKING:
    from PIL import Image

    from hatn_sim.report.canvas import Sheet

FILM_FRAMES: Final = 80
"""Eight seconds."""
WIDTH_PX: Final = 720
COLOURS: Final = 160
PALETTE_FRAMES: Final = 6
SCALE_PX: Final = 120


def draw_animation(
    run: Run, frame: int, ego_id: str, out_gif: Path, frames: int = FILM_FRAMES
) -> None:
    """Draw the frames around a moment of an ego, in real time; a third are before it.

    A film is shorter where the run is. All of its frames share one palette, so that colours do not
    flicker. The same log gives the same bytes.

    Raises:
        InputError: the ego is in none of these frames, or as for `picture.draw_moment`.
    """
    from hatn_sim.report.canvas import FILM, open_sheet

    start = max(0, min(frame - frames // 3, run.frame_count - frames))
    moments = list(read_moments(run, range(start, start + frames), ego_id))
    with_ego = [moment for moment in moments if ego_id in moment.scene.ids]
    if not with_ego:
        raise InputError(
            f"{run.path}: vehicle {ego_id!r} is not in view in frames {start} to "
            f"{start + len(moments) - 1}; name another vehicle or time"
        )
    wide, high = FILM.map_in
    # What comes after the last choice is the ego on its way out of the picture.
    choosing = [moment for moment in with_ego if sum(slot.in_focus for slot in moment.slots) > 1]
    centre, width_m = camera(choosing or with_ego, wide / high)
    sheet = open_sheet(FILM, read_road(run.path / ROAD_FILE), centre, width_m)
    captions = [caption(run, moment) for moment in moments]
    _write_gif(list(_images(sheet, moments, captions)), out_gif)


def _images(
    sheet: Sheet, moments: Sequence[Moment], captions: Sequence[str]
) -> Iterator[Image.Image]:
    """The frames; the road is drawn once, only what moves is drawn again."""
    from PIL import Image

    from hatn_sim.report.drawing import draw_moment_on

    agg = sheet.agg
    agg.draw()
    empty = agg.copy_from_bbox(sheet.figure.bbox)
    renderer = agg.get_renderer()
    height_px = round(WIDTH_PX * sheet.style.height_in / sheet.style.width_in)
    labels: dict[str, FloatArray] = {}
    for moment, words in zip(moments, captions, strict=True):
        agg.restore_region(empty)
        artists, labels = draw_moment_on(sheet, moment, words, labels, blinking=True)
        for artist in sorted(artists, key=lambda artist: artist.get_zorder()):
            artist.draw(renderer)
            artist.remove()
        pixels = np.asarray(agg.buffer_rgba())[..., :3]
        yield Image.fromarray(pixels).resize((WIDTH_PX, height_px), Image.Resampling.LANCZOS)


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


def _write_gif(images: Sequence[Image.Image], out_gif: Path) -> None:
    from PIL import Image

    step = max(1, len(images) // PALETTE_FRAMES)
    samples = images[::step]
    wide, high = images[0].size
    strip = Image.new("RGB", (wide, high * len(samples) + SCALE_PX))
    for row, image in enumerate(samples):
        strip.paste(image, (0, row * high))
    # The probability scale is small in every frame, but all of its colours are needed.
    strip.paste(_scale_image(wide), (0, high * len(samples)))
    palette = strip.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, kmeans=1)
    # No dithering: it would crawl, and triple the size.
    indexed = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    data = io.BytesIO()
    indexed[0].save(
        data,
        format="GIF",
        save_all=True,
        append_images=indexed[1:],
        duration=round(1000 * DT_S),
        loop=0,
        optimize=False,
        disposal=1,
    )
    save_whole(out_gif, data.getbuffer())
