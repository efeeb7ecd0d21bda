"""SUMO's own window, and what is drawn in it."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from hatn_sim.cli import main
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import HORIZON_FRAMES, Advice, Alert, Prediction, Scene, Suggestion
from hatn_sim.errors import InputError
from hatn_sim.report.window_shapes import (
    ALERTED_RINGS,
    EGO_RINGS,
    MOST_LINES,
    alerted_after,
    most_pressed,
    picture_of,
    words_of,
)
from hatn_sim.resources import scenarios_dir
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_config import VIEW_FILE, start_options
from hatn_sim.simulators.sumo_messages import Drawn, Picture
from hatn_sim.simulators.sumo_window import (
    PREFIX,
    SHOWN_M,
    WORDS_PARAMETER,
    Canvas,
    display_trouble,
    window_options,
)
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
    alert = Alert("1", "onset", "CONFLICT", 1.0, "b", "c", 0.5, "", text="Brake")
    chosen = picture_of(scene, Road([]), Advice(prediction, (), ()), {"a"}, [alert])
    assert set(chosen.ribbons) == {"way:a:0", "way:a:1"}  # who stands has no way
    assert chosen.ribbons["way:a:0"].paint[3] == 255
    assert chosen.ribbons["way:a:1"].paint[3] == 85  # a third as probable
    assert chosen.ribbons["way:a:0"].xy_m[0].tolist() == [0.0, 0.0]
    assert chosen.ribbons["way:a:0"].xy_m[-1].tolist() == [30.0, 0.0]
    assert chosen.rings == {"a": EGO_RINGS, "b": ALERTED_RINGS, "c": ALERTED_RINGS}
    assert chosen.begin_xy_m is None  # nobody has a conflict
    other = picture_of(scene, Road([]), Advice(prediction, (), ()), ())
    assert set(other.ribbons) == {"thin:a"} and not other.rings and not other.words
    assert most_pressed(scene, prediction, None) is None


def test_alerts_stand_until_they_end() -> None:
    onset = Alert("1", "onset", "CONFLICT", 1.0, "a", "b", 0.5, "")
    standing = alerted_after({}, (onset,))
    assert set(standing) == {"1"}
    assert set(alerted_after(standing, (replace(onset, edge="peak"),))) == {"1"}
    assert alerted_after(standing, (replace(onset, edge="end"),)) == {}


def test_words_are_of_alerts_the_latest_first_and_of_what_egos_are_told() -> None:
    _, prediction = scene_and_prediction()
    said = Suggestion("a", 1.0, "yield", "b", 0.9, 0.8, None, 3.0, True, "Yield to the red car")
    advice = Advice(prediction, (said, replace(said, ego_id="b")), ())
    first = Alert("1", "onset", "CONFLICT", 1.0, "b", "c", 0.5, "danger 0.5", text="Brake")
    then = replace(first, alert_id="2", ego_id="d", text=None)
    assert words_of(advice, {"a"}, [first, then]) == (
        "Alert! d: danger 0.5",
        "Alert! b: Brake",
        "a: Yield to the red car",
    )
    assert len(words_of(advice, {"a", "b"}, [first, then])) == MOST_LINES
    assert words_of(advice, (), ()) == ()


def test_who_is_shown_is_in_view_and_who_is_warned_goes_first() -> None:
    """Three egos, 5, 10 and 20 m before their conflicts; d is nearer and has no choice."""
    three: Any = SimpleNamespace(
        ids=("a", "b", "c", "d"),
        xy_m=np.array([[0.0, 0.0], [50.0, 0.0], [100.0, 0.0], [10.0, 0.0]]),
        speed_mps=np.array([5.0, 5.0, 5.0, 5.0]),
    )
    mask = np.array([[True, True], [True, True], [True, True], [True, False]])
    graphs = SimpleNamespace(
        ego=np.arange(4),
        node_mask=mask,
        focus_mask=np.ones((4, 2), np.bool_),
        has_conflict=np.ones(4, np.bool_),
        ego_to_conflict_m=np.array([[0.0, 10.0], [0.0, 5.0], [0.0, 20.0], [0.0, 1.0]]),
        ego_at_red=np.zeros(4, np.bool_),
    )
    prediction: Any = SimpleNamespace(graphs=graphs, slot_probability=np.ones((4, 2)))
    scene: Scene = three
    assert most_pressed(scene, prediction, None) == "b"
    assert most_pressed(scene, prediction, "a") == "a"  # stays
    assert most_pressed(scene, prediction, "d") == "b"  # has no choice any more
    assert most_pressed(scene, prediction, "a", {"c", "d"}) == "c"  # is warned
    assert most_pressed(scene, prediction, "a", {"d", "gone"}) == "a"
    assert most_pressed(scene, prediction, "b", (), (-10.0, -10.0, 10.0, 10.0)) == "a"
    assert most_pressed(scene, prediction, "b", {"c"}, (-10.0, -10.0, 60.0, 10.0)) == "b"
    assert most_pressed(scene, prediction, "b", (), (200.0, 0.0, 300.0, 10.0)) is None
    graphs.ego_at_red[1] = True
    assert most_pressed(scene, prediction, "b") == "a"  # b waits at red: it has nothing to choose


class FakeDomain:
    """Keeps what was asked of it."""

    def __init__(self, ids: tuple[str, ...] = ()) -> None:
        self.ids = set(ids)
        self.shape: dict[str, object] = {}

    def add(self, name: str, shape: object, *_: object) -> None:
        assert name not in self.ids
        self.ids.add(name)
        self.shape[name] = shape

    def remove(self, name: str) -> None:
        self.ids.remove(name)

    def setShape(self, name: str, shape: object) -> None:  # noqa: N802
        assert name in self.ids
        self.shape[name] = shape

    def setColor(self, name: str, _: object) -> None:  # noqa: N802
        assert name in self.ids

    def setPosition(self, name: str, *_: float) -> None:  # noqa: N802
        assert name in self.ids

    def setParameter(self, name: str, key: str, value: str) -> None:  # noqa: N802
        assert name in self.ids and key == "hatn-sim"
        self.shape[name] = value

    def getIDList(self) -> tuple[str, ...]:  # noqa: N802
        return tuple(self.ids)


class FakeVehicles(FakeDomain):
    """Two cars of 5 x 2 m, front bumpers at 10 and 20 m, heading east."""

    x_m: dict[str, float]

    def __init__(self) -> None:
        super().__init__(("a", "b"))
        self.x_m = {"a": 10.0, "b": 20.0}

    def getPosition(self, name: str) -> tuple[float, float]:  # noqa: N802
        return self.x_m[name], 0.0

    def getAngle(self, _: str) -> float:  # noqa: N802
        return 90.0

    def getLength(self, _: str) -> float:  # noqa: N802
        return 5.0

    def getWidth(self, _: str) -> float:  # noqa: N802
        return 2.0


class FakeGui(FakeDomain):
    """A view of 200 x 100 m about the origin."""

    tracked = ""

    def __init__(self) -> None:
        super().__init__(("View #0",))
        self.went_to: list[tuple[float, ...]] = []

    def getBoundary(self, _: str) -> tuple[tuple[float, float], tuple[float, float]]:  # noqa: N802
        return (-100.0, -50.0), (100.0, 50.0)

    def setBoundary(self, _: str, *box_m: float) -> None:  # noqa: N802
        self.went_to.append(box_m)

    def getOffset(self, _: str) -> tuple[float, float]:  # noqa: N802
        return 0.0, 0.0

    def setOffset(self, *_: object) -> None:  # noqa: N802
        pass

    def trackVehicle(self, _: str, name: str) -> None:  # noqa: N802
        self.tracked = name

    def getTrackedVehicle(self, _: str) -> str:  # noqa: N802
        return self.tracked


class FakeSumo:
    def __init__(self) -> None:
        self.polygon, self.poi = FakeDomain(("house",)), FakeDomain(("tree",))
        self.vehicle, self.gui = FakeVehicles(), FakeGui()


def test_what_is_drawn_goes_again_and_the_users_own_stays() -> None:
    sumo = FakeSumo()
    canvas, (scene, prediction) = Canvas(sumo), scene_and_prediction()
    said = Suggestion("a", 1.0, "yield", "b", 0.9, 0.8, None, 3.0, True, "Yield to the red car")
    drawn = picture_of(scene, Road([]), Advice(prediction, (said,), ()), {"a", "not here"})
    ways = {f"{PREFIX}way:a:0", f"{PREFIX}way:a:1"}
    for _ in range(2):
        assert canvas.draw(drawn) == Drawn("", (-100.0, -50.0, 100.0, 50.0))
        assert sumo.polygon.ids == {"house", *ways, f"{PREFIX}ring:0:a", f"{PREFIX}ring:1:a"}
        assert sumo.poi.ids == {"tree", f"{PREFIX}words:0"}
        assert sumo.poi.shape[f"{PREFIX}words:0"] == "a: Yield to the red car"
    canvas.draw(Picture({}, {}, {}))
    assert sumo.polygon.ids == {"house"} and sumo.poi.ids == {"tree"}


def test_rings_go_with_their_vehicles() -> None:
    sumo = FakeSumo()
    canvas = Canvas(sumo)
    canvas.draw(Picture({}, {}, {"a": EGO_RINGS, "b": EGO_RINGS}))
    ring = f"{PREFIX}ring:0:a"
    assert sumo.polygon.shape[ring] == [pytest.approx((4.45, 0.0)), pytest.approx((10.55, 0.0))]
    sumo.vehicle.x_m["a"] = 11.0
    sumo.vehicle.ids.remove("b")  # it has arrived
    canvas.keep_up()
    assert sumo.polygon.shape[ring] == [pytest.approx((5.45, 0.0)), pytest.approx((11.55, 0.0))]
    assert sumo.polygon.ids == {"house", ring, f"{PREFIX}ring:1:a"}


def test_the_window_goes_where_there_is_something_to_see_once_and_with_whom_is_followed() -> None:
    sumo = FakeSumo()
    canvas = Canvas(sumo)
    for x_m in (0.0, 7.0):
        canvas.draw(Picture({}, {}, {}, begin_xy_m=np.array([x_m, 0.0])))
    half_m = 0.5 * SHOWN_M
    assert sumo.gui.went_to == [(-half_m, -half_m, half_m, half_m)]
    assert canvas.draw(Picture({}, {}, {}, followed="b")).followed == "b"
    assert sumo.gui.went_to[1:] == [(20.0 - half_m, -half_m, 20.0 + half_m, half_m)]
    sumo.gui.tracked = "a"  # by the user
    assert canvas.draw(Picture({}, {}, {}, followed="b")).followed == "a"


def test_the_look_that_ships_shows_the_words() -> None:
    look = ElementTree.parse(scenarios_dir() / VIEW_FILE)
    points = look.find("scheme/pois")
    assert points is not None
    assert points.get("poiTextParam") == WORDS_PARAMETER and points.get("poiText_show") == "1"


def test_a_users_own_look_is_kept_and_told_of(tmp_path: Path) -> None:
    ours = load_scenario("intersection5")
    text = ours.config_path.read_text(encoding="utf-8").replace("../view.xml", "mine.xml")
    config = tmp_path / "a.sumocfg"
    config.write_text(text, encoding="utf-8")
    words, notices = start_options(replace(ours, config_path=config, driver_path=None), True)
    assert "--gui-settings-file" not in words
    assert notices and notices[0].startswith("gui-settings-file in a.sumocfg: kept")
    words, notices = start_options(replace(ours, config_path=config, driver_path=None))
    assert words[words.index("--gui-settings-file") + 1] == "" and not notices


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

    def watched(simulator: SumoSimulator, picture: Picture) -> Drawn:
        shown.append(picture)
        return draw(simulator, picture)

    monkeypatch.setattr(SumoSimulator, "draw", watched)
    words = ["run", "intersection5", "--duration", "1.5", "--warm-up", "20", "--no-picture"]
    assert main([*words, "--quiet", "--out", str(tmp_path / "without")]) == 0
    window = ["--gui", "--delay", "0"]
    assert main([*words, *window, "--quiet", "--out", str(tmp_path / "with")]) == 0
    assert len(shown) == 15 and all(picture.ribbons for picture in shown)
    parts = sorted((tmp_path / "without").rglob("*.parquet"))
    assert parts
    for part in parts:
        other = tmp_path / "with" / part.relative_to(tmp_path / "without")
        assert part.read_bytes() == other.read_bytes(), part.name
