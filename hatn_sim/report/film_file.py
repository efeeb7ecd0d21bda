"""Frames -> a film: MP4 (H.264) through PyAV, whose wheels bring all it takes, or GIF by Pillow.

The only importer of PyAV.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.errors import InputError
from hatn_sim.whole_file import write_whole

if TYPE_CHECKING:
    from PIL import Image

Pixels = NDArray[np.uint8]
"""[H, W, 3], height and width even."""
SUFFIXES: Final = (".mp4", ".gif")
QUALITY: Final = {"crf": "18", "preset": "veryfast", "tune": "animation"}
"""x264's: no loss to be seen, and no slower than drawing."""
KEY_FRAME_S: Final = 2.0
COLOURS: Final = 160
PALETTE_FRAMES: Final = 6


def check_film_file(path: Path) -> None:
    """InputError where a film of this name cannot be written here."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"--out {path}: expected a name that ends in .mp4 or .gif")
    if path.suffix == ".mp4" and find_spec("av") is None:
        raise InputError(
            f"--out {path}: MP4 takes PyAV, which is not installed; "
            "pip install 'hatn-sim[video]', or name a .gif"
        )


def write_mp4(path: Path, frames: Iterable[Pixels], per_s: Fraction) -> None:
    """Encode frames as they come; any player shows them. Raises OSError where it cannot."""
    write_whole(path, lambda file: _encode(file, frames, per_s))


def _encode(path: Path, frames: Iterable[Pixels], per_s: Fraction) -> None:
    import av

    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream: Any = container.add_stream("libx264", rate=per_s, options=dict(QUALITY))
        stream.pix_fmt = "yuv420p"
        stream.codec_context.gop_size = max(1, round(KEY_FRAME_S * per_s))
        for number, pixels in enumerate(frames):
            if not number:
                stream.height, stream.width = pixels.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            frame.pts = number
            frame.time_base = 1 / per_s
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def write_gif(path: Path, images: Sequence[Image.Image], frame_ms: int, scale: Image.Image) -> None:
    """Write images that share one palette, so that colours do not flicker.

    `scale` holds colours that are small in every frame but all needed.
    """
    from PIL import Image

    samples = images[:: max(1, len(images) // PALETTE_FRAMES)]
    wide, high = images[0].size
    strip = Image.new("RGB", (wide, high * len(samples) + scale.size[1]))
    for row, image in enumerate(samples):
        strip.paste(image, (0, row * high))
    strip.paste(scale, (0, high * len(samples)))
    palette = strip.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, kmeans=1)
    # No dithering: it would crawl, and triple the size.
    indexed = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    data = io.BytesIO()
    indexed[0].save(
        data,
        format="GIF",
        save_all=True,
        append_images=indexed[1:],
        duration=frame_ms,
        loop=0,
        optimize=False,
        disposal=1,
    )
    write_whole(path, lambda file: file.write_bytes(data.getbuffer()))
