"""Letters that the font of pictures lacks: taken from another font of the system, or their number.

Names of vehicles and scenes may be in any script. Imports matplotlib, so import this module only
where something is drawn.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, Final

from matplotlib import font_manager
from matplotlib.artist import Artist
from matplotlib.font_manager import FontProperties
from matplotlib.text import Text

OTHERS: Final = (
    *("Noto Sans CJK SC", "Noto Sans CJK JP", "Noto Sans CJK TC", "Noto Sans CJK KR"),
    *("Noto Sans SC", "Noto Sans JP", "Noto Sans TC", "Noto Sans KR", "Source Han Sans SC"),
    *("WenQuanYi Zen Hei", "WenQuanYi Micro Hei", "Droid Sans Fallback", "Arial Unicode MS"),
    *("PingFang SC", "Hiragino Sans", "Apple SD Gothic Neo", "Microsoft YaHei", "SimHei"),
    *("Yu Gothic", "Malgun Gothic", "Noto Sans Devanagari", "Noto Sans Thai", "Noto Sans Bengali"),
    *("Noto Sans Tamil", "FreeSans", "FreeSerif", "Liberation Sans"),
)
"""Asked one after the other for what the font of pictures lacks; those that are there."""
_told: set[str] = set()


def readable(text: str) -> str:
    """The text, with letters that no font has by their numbers, which is told once for each."""
    lacking = sorted({one for one in text if _is_lacking(one) and lender(one, OTHERS) is None})
    if new := [one for one in lacking if one not in _told]:
        _told.update(new)
        numbers = ", ".join(_number(one) for one in new)
        print(
            f"hatn-sim: no font found for {numbers}: pictures show numbers in place of such "
            "letters; install one that has them, as Noto Sans CJK",
            file=sys.stderr,
        )
    for one in lacking:
        text = text.replace(one, _number(one))
    return text


def families_of(text: str) -> list[str]:
    """The fonts to draw a text with: that of pictures, then those that lend letters to it."""
    lenders = [lender(one, OTHERS) for one in text if _is_lacking(one)]
    return list(dict.fromkeys([_own_family(), *(one for one in lenders if one is not None)]))


def lend_letters(artists: Iterable[Artist]) -> None:
    """Let texts among these have the letters of other fonts that they need."""
    for artist in artists:
        if isinstance(artist, Text) and not artist.get_text().isascii():
            families = families_of(artist.get_text())
            if len(families) > 1:
                artist.set_fontfamily(families)


def _number(letter: str) -> str:
    return f"U+{ord(letter):04X}"


def _own_family() -> str:
    return FontProperties(fname=font_manager.findfont(FontProperties())).get_name()


def _is_lacking(letter: str) -> bool:
    return not (letter.isascii() or letter.isspace()) and letter not in _own_letters()


def _own_letters() -> frozenset[str]:
    return _letters(font_manager.findfont(FontProperties()))


@lru_cache(maxsize=32)
def _letters(path: Any) -> frozenset[str]:
    return frozenset(map(chr, font_manager.get_font(path).get_charmap()))


@lru_cache(maxsize=1024)
def lender(letter: str, others: tuple[str, ...]) -> str | None:
    """The first of these fonts that is on this system and has a letter."""
    there = {font.name for font in font_manager.fontManager.ttflist}
    for name in others:
        if name in there and letter in _letters(font_manager.findfont(name)):
            return name
    return None
