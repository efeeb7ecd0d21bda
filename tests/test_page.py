"""The page of a run: its bytes, read by a second decoder, against the log."""

from __future__ import annotations

import base64
import hashlib
import html.parser
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_runs import HOSTILE, hostile_run, made_up_run

from hatn_sim.cli import main
from hatn_sim.log import read_run
from hatn_sim.report.page.pack import (
    first_differences,
    packed,
    packed_json,
    second_differences,
    varints,
)
from hatn_sim.report.page.page import PAGE_FILE, page, write_page


class Reader(html.parser.HTMLParser):
    """What a browser makes of a page: its elements, and the text of those with an id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.texts: dict[str, str] = {}
        self.inside: str | None = None
        self.policy = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append(tag)
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"] or ""
        self.inside = given.get("id") or tag
        assert not any(name.startswith("on") or name == "style" for name in given)

    def handle_endtag(self, tag: str) -> None:
        self.inside = None

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.texts[self.inside] = self.texts.get(self.inside, "") + data


def unpacked(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text), -zlib.MAX_WBITS)


def numbers_of(data: bytes) -> list[int]:
    """Zigzag varints, one at a time."""
    out: list[int] = []
    value = shift = 0
    for octet in data:
        value |= (octet & 127) << shift
        shift += 7
        if not octet & 128:
            out.append((value >> 1) ^ -(value & 1))
            value = shift = 0
    return out


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up_run(tmp_path_factory.mktemp("page") / "crossing")


def test_numbers_survive() -> None:
    rng = np.random.default_rng(1)
    values = np.concatenate([rng.integers(-(2**31), 2**31, 500), rng.integers(-70, 70, 500), [0]])
    assert numbers_of(varints([values[:10], values[10:]])) == values.tolist()
    assert numbers_of(unpacked(packed(varints([values])))) == values.tolist()
    assert varints([]) == b""


def test_differences_are_undone_by_sums() -> None:
    rng = np.random.default_rng(2)
    values = rng.integers(-1000, 1000, 40)
    starts = rng.random(40) < 0.2
    starts[0] = True
    once, twice = first_differences(values, starts), second_differences(values, starts)
    for stretch in np.split(np.arange(40), np.flatnonzero(starts)[1:]):
        assert np.cumsum(once[stretch]).tolist() == values[stretch].tolist()
        own = twice[stretch]
        back = np.cumsum(np.concatenate((own[:1], np.cumsum(own[1:]))))
        assert back.tolist() == values[stretch].tolist()


def test_the_first_chunk_holds_the_tracks_of_the_log(crossing: Path) -> None:
    run = read_run(crossing)
    read = Reader(page(run))
    head = json.loads(unpacked(read.texts["head"]))
    numbers = numbers_of(unpacked(read.texts["chunk-0"]))
    frames, stretches, rows = numbers[:3]
    assert (frames, rows) == (min(100, run.frame_count), (run.tracks.frame < 100).sum())
    table = np.array(numbers[3 : 3 + 3 * stretches]).reshape(3, stretches)
    at = 3 + 3 * stretches
    xy = np.array(numbers[at : at + 2 * rows]).reshape(2, rows)
    row = 0
    for vehicle, first, count in table.T.tolist():
        own = xy[:, row : row + count].copy()
        own[:, 1:] = np.cumsum(own[:, 1:], axis=1)
        found = np.cumsum(own, axis=1).T / 50.0 + head["origin_m"]
        mine = (run.tracks.vehicle == vehicle) & (run.tracks.frame >= first)
        expected = run.tracks.xy_m[mine][:count]
        assert np.abs(found - expected).max() <= 0.0101
        row += count
    assert row == rows


def test_one_log_gives_one_page(crossing: Path) -> None:
    assert page(read_run(crossing)) == page(read_run(crossing))
    assert page(read_run(crossing)).isascii()


def test_nothing_but_its_own_script_and_style_may_run(crossing: Path) -> None:
    text = page(read_run(crossing))
    policy = Reader(text).policy
    for kind, tag in (("script-src", "script"), ("style-src", "style")):
        content = re.search(f"<{tag}>(.*?)</{tag}>", text, re.DOTALL)
        assert content is not None
        digest = base64.b64encode(hashlib.sha256(content[1].encode()).digest()).decode()
        assert f"{kind} 'sha256-{digest}'" in policy
    assert "default-src 'none'" in policy and "unsafe" not in policy
    assert not re.search(r"https?://", text)


def test_names_of_a_file_cannot_become_markup(crossing: Path, tmp_path: Path) -> None:
    hostile = Reader(page(read_run(hostile_run(tmp_path / "run"))))
    head = json.loads(unpacked(hostile.texts["head"]))
    assert {vehicle["id"] for vehicle in head["vehicles"]} >= set(HOSTILE)
    assert hostile.tags == Reader(page(read_run(crossing))).tags
    assert packed_json(HOSTILE).isascii() and "<" not in packed_json(HOSTILE)


@pytest.mark.parametrize("frames", [1, 5])
def test_an_empty_or_unfinished_run_has_a_page(tmp_path: Path, frames: int) -> None:
    path = made_up_run(tmp_path / "run", frames=frames, names=(), finished=False)
    written = write_page(read_run(path), tmp_path)
    head: dict[str, Any] = json.loads(unpacked(Reader(written.read_text()).texts["head"]))
    assert (head["finished"], head["frames"], head["vehicles"]) == (False, frames, [])


@pytest.mark.slow
def test_a_crowd_takes_a_quarter_of_the_room_that_it_may(tmp_path: Path) -> None:
    """60 vehicles for 120 s, all predicted, have to go into 12 MB: 166 bytes for each at each
    frame. A real crowd, so that nothing is easier to pack than it will be."""
    out = tmp_path / "run"
    asked = ["--density", "dense", "--duration", "30", "--no-picture", "--quiet"]
    assert main(["run", "roundabout8", *asked, "--out", str(out)]) == 0
    predicted = len(read_run(out).predicted("hatn")[0])
    size = (out / PAGE_FILE).stat().st_size
    print(f"{size:,} bytes, {size / predicted:.0f} for each vehicle at each frame")
    assert size / predicted < 40.0


def test_report_writes_the_page(crossing: Path, tmp_path: Path) -> None:
    assert main(["report", str(crossing), "--no-animation", "--out", str(tmp_path)]) == 0
    assert (tmp_path / PAGE_FILE).is_file() and (tmp_path / "moment.png").is_file()
