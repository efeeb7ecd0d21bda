"""SUMO's own window, and what is drawn in it."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hatn_sim.cli import main
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import HORIZON_FRAMES, Alert, Prediction, Scene
from hatn_sim.errors import InputError
from hatn_sim.report.window_shapes import (
    ALERTED_PAINT,
    EGO_PAINT,
    alerted_after,
    most_pressed,
    picture_of,
)
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_messages import Picture
from hatn_sim.simulators.sumo_window import PREFIX, Canvas, display_trouble, window_options
from hatn_sim.traffic import open_traffic


def scene_and_prediction() -> tuple[Scene, Prediction]:
    """Two cars; the first has two ways, three to one, at 10 m/s, the second stands."""
    scene = Scene(
        time_s=1.0,
        ids=("a", "b"),
        xy_m=np.array([[0.0, 0.0], [50.0, 50.0]]),
        yaw_rad=np.zeros(2),
        speed_mps=np.array([10.0, 0.0]),
        size_m=np.full((2, 2), [5.0, 1.8]),
        kind=np.zeros(2, np.int64),
        colour=np.zeros((2, 3), np.int64),
        blinker=np.zeros(2, np.int64),
        signal_closed=np.zeros(0, np.bool_),
    )
    ahead_m = np.arange(1, HORIZON_FRAMES + 1) * 1.0
    xy_m = np.zeros((2, 2, HORIZON_FRAMES, 2))
    xy_m[0, 0, :, 0] = ahead_m
    xy_m[0, 1, :, 1] = ahead_m
    xy_m[1] = 50.0
    chances = np.array([[0.75, 0.25], [0.5, 0.5]])
    no = np.zeros(2, np.bool_)
    return scene, Prediction(("a", "b"), xy_m, chances, no, no)


def test_an_ego_has_all_its_ways_and_others_the_likeliest() -> None:
    scene, prediction = scene_and_prediction()
    chosen = picture_of(scene, Road([]), prediction, {"a"}, {"b"})
    assert set(chosen.ribbons) == {"way:a:0", "way:a:1"}  # who stands has no way
    assert chosen.ribbons["way:a:0"].paint[3] == 255
    assert chosen.ribbons["way:a:1"].paint[3] == 85  # a third as probable
    assert chosen.ribbons["way:a:0"].xy_m[0].tolist() == [0.0, 0.0]
    assert chosen.ribbons["way:a:0"].xy_m[-1].tolist() == [30.0, 0.0]
    assert chosen.vehicles == {"a": EGO_PAINT, "b": ALERTED_PAINT}
    other = picture_of(scene, Road([]), prediction, ())
    assert set(other.ribbons) == {"thin:a"} and not other.vehicles
    assert most_pressed(scene, prediction, None) is None


def test_alerts_stand_until_they_end() -> None:
    onset = Alert("1", "onset", "CONFLICT", 1.0, "a", "b", 0.5, "")
    standing = alerted_after({}, (onset,))
    assert set(standing) == {"1"}
    assert set(alerted_after(standing, (replace(onset, edge="peak"),))) == {"1"}
    assert alerted_after(standing, (replace(onset, edge="end"),)) == {}


class FakeDomain:
    """Keeps what was asked of it."""

    def __init__(self, ids: tuple[str, ...] = ()) -> None:
        self.ids = set(ids)
        self.colour = dict.fromkeys(ids, (1, 2, 3, 255))

    def add(self, name: str, *_: object) -> None:
        assert name not in self.ids
        self.ids.add(name)

    def remove(self, name: str) -> None:
        self.ids.remove(name)

    def setShape(self, name: str, _: object) -> None:  # noqa: N802
        assert name in self.ids

    def setColor(self, name: str, colour: tuple[int, int, int, int]) -> None:  # noqa: N802
        self.colour[name] = colour

    def getColor(self, name: str) -> tuple[int, int, int, int]:  # noqa: N802
        return self.colour[name]

    def getIDList(self) -> tuple[str, ...]:  # noqa: N802
        return tuple(self.ids)


class FakeSumo:
    def __init__(self) -> None:
        self.polygon, self.poi = FakeDomain(("house",)), FakeDomain(("tree",))
        self.vehicle, self.gui = FakeDomain(("a", "b")), FakeDomain()


def test_what_is_drawn_goes_again_and_the_users_own_stays() -> None:
    sumo = FakeSumo()
    canvas, (scene, prediction) = Canvas(sumo), scene_and_prediction()
    drawn = picture_of(scene, Road([]), prediction, {"a"})
    for _ in range(2):
        canvas.draw(drawn)
        assert sumo.polygon.ids == {"house", f"{PREFIX}way:a:0", f"{PREFIX}way:a:1"}
        assert sumo.vehicle.colour == {"a": EGO_PAINT, "b": (1, 2, 3, 255)}
    canvas.draw(Picture({}, {}, {}))
    assert sumo.polygon.ids == {"house"} and sumo.poi.ids == {"tree"}
    assert sumo.vehicle.colour["a"] == (1, 2, 3, 255)


def test_no_display_and_no_sumo_are_one_line_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(InputError, match="no DISPLAY"):
        window_options(100.0)
    with pytest.raises(InputError, match="--gui opens SUMO's window"):
        open_traffic(load_scenario("highway_merge"), 100.0)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "no DISPLAY"),
        (":987654", "no X server answers on DISPLAY :987654"),
        ("localhost:1.0", "no X server answers on DISPLAY localhost:1.0"),
        ("screen", "names no display"),
    ],
)
def test_a_display_that_does_not_answer_is_one_line(
    name: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", name)
    assert main(["run", "tjunction", "--gui", "--duration", "1", "--quiet"]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_a_display_that_answers_is_one() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind("\0/tmp/.X11-unix/X98765")
        server.listen()
        assert display_trouble(":98765.0") == ""


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A screen that nobody looks at."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb here: a window cannot be opened")
    read, write = os.pipe()
    words = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1000x800x24"]
    server = subprocess.Popen(words, pass_fds=(write,), stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as told:
        number = told.readline().strip()
    try:
        if not number:
            pytest.skip("Xvfb does not start here")
        monkeypatch.setenv("DISPLAY", f":{number}")
        yield
    finally:
        server.terminate()
        server.wait()


@pytest.mark.window
def test_a_run_in_the_window_is_to_the_byte_the_run_without(
    display: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[Picture] = []
    draw = SumoSimulator.draw

    def watched(simulator: SumoSimulator, picture: Picture) -> str:
        shown.append(picture)
        return draw(simulator, picture)

    monkeypatch.setattr(SumoSimulator, "draw", watched)
    words = ["run", "intersection5", "--duration", "3", "--warm-up", "20", "--no-picture"]
    assert main([*words, "--quiet", "--out", str(tmp_path / "without")]) == 0
    window = ["--gui", "--delay", "0"]
    assert main([*words, *window, "--quiet", "--out", str(tmp_path / "with")]) == 0
    assert len(shown) == 30 and all(picture.ribbons for picture in shown)
    parts = sorted((tmp_path / "without").rglob("*.parquet"))
    assert parts
    for part in parts:
        other = tmp_path / "with" / part.relative_to(tmp_path / "without")
        assert part.read_bytes() == other.read_bytes(), part.name
