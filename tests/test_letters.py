"""Letters that the font of pictures lacks. What a font has is asked of its own table of letters."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from matplotlib import font_manager
from matplotlib.ft2font import FT2Font

from hatn_sim.report import letters
from hatn_sim.report.canvas import plain
from hatn_sim.report.figures import head_chart, new_chart, save_figure
from hatn_sim.report.label_width import width_pt

LENDER = "STIXGeneral"
"""Comes with matplotlib, and has letters that its DejaVu Sans has not."""


def in_font(name: str, letter: str) -> bool:
    return FT2Font(font_manager.findfont(name)).get_char_index(ord(letter)) != 0


LENT = next(chr(n) for n in range(0x2900, 0x2B00) if in_font(LENDER, chr(n))
            and not in_font("DejaVu Sans", chr(n)))  # fmt: skip
NOWHERE = "\U000f1234"  # for private use


@pytest.fixture(autouse=True)
def few_fonts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(letters, "OTHERS", ("no such font", LENDER))
    monkeypatch.setattr(letters, "_told", set())


def test_a_letter_of_another_font_is_borrowed() -> None:
    assert letters.readable(f"car {LENT}") == f"car {LENT}"
    assert letters.families_of(f"car {LENT}") == ["DejaVu Sans", LENDER]
    assert letters.families_of("ünïcode ·") == ["DejaVu Sans"]


def test_a_letter_of_no_font_is_its_number_and_told_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert plain(f"{NOWHERE}$1 {NOWHERE}") == r"U+F1234\$1 U+F1234"
    plain(f"again {NOWHERE}")
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "no font found for U+F1234" in said[0]


def test_no_figure_warns_of_letters(tmp_path: Path) -> None:
    figure = new_chart((3.0, 1.0))
    head_chart(figure, f"{LENT} and {NOWHERE}", 10.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save_figure(figure, [tmp_path / "one.png", tmp_path / "one.pdf", tmp_path / "one.svg"])
        assert width_pt(plain(f"{LENT} {NOWHERE}"), 10.0) > width_pt("U+F1234", 10.0)
