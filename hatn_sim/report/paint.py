"""The colour a vehicle is drawn in: one that looks like the word that advice calls it by.

What a simulator calls orange may look mustard on a screen, and two words much the same to the
colour-blind. So a vehicle is drawn near the paint of its word, with a little of its own colour, in
which vehicles of one word differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from hatn_sim.assist.words import colour_word
from hatn_sim.datatypes import Kind

Colour = tuple[int, int, int]

PAINTS: Final[dict[str, Colour]] = {
    "white": (246, 246, 243),
    "silver": (188, 193, 199),
    "grey": (126, 126, 127),
    "black": (24, 25, 28),
    "red": (226, 44, 36),
    "blue": (26, 76, 190),
    "light blue": (112, 198, 246),
    "purple": (166, 84, 196),
    "green": (28, 152, 68),
    "yellow": (250, 222, 36),
    "orange": (246, 134, 14),
    "brown": (96, 58, 28),
    "beige": (228, 208, 166),
}
"""Apart from each other in lightness where the colour-blind see the same hue (tested)."""
OWN_SHARE: Final = 0.2


@lru_cache(maxsize=4096)
def paint_of(red: int, green: int, blue: int) -> Colour:
    """What a vehicle of this colour (0 to 255 each) is drawn in."""
    paint = PAINTS[colour_word(red, green, blue)]
    r, g, b = (
        round(OWN_SHARE * own + (1.0 - OWN_SHARE) * its)
        for own, its in zip((red, green, blue), paint, strict=True)
    )
    return r, g, b


def look_of(kind: int, colour: Sequence[int]) -> str:
    """What one would call a vehicle by its looks: "white car"."""
    red, green, blue = colour
    return f"{colour_word(red, green, blue)} {Kind(kind).name.lower()}"
