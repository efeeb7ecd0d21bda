"""Pictures and films of a run, on a crossing made by hand: where things are and what they show."""

from __future__ import annotations

import colorsys
import gzip
import json
import subprocess
import sys
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.text import Text
from PIL import Image

from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
    Advice,
    Alert,
    Frame,
    Gate,
    Kind,
    Lane,
    Prediction,
    Scene,
    Suggestion,
    Truth,
)
from hatn_sim.errors import InputError
from hatn_sim.graph import build_graphs
from hatn_sim.log import Run, RunWriter, read_run
from hatn_sim.log.road_file import ROAD_FILE, read_road, write_road
from hatn_sim.perception import begin, perceive
from hatn_sim.report.animation import around, draw_animation
from hatn_sim.report.canvas import CLOSED, FILM, POSTER, SCREEN, Style, open_sheet
from hatn_sim.report.drawing import draw_moment_on
from hatn_sim.report.label_places import Label, place_labels
from hatn_sim.report.moment import alerts_at, moment_at
from hatn_sim.report.paint import PAINTS, look_of, paint_of
from hatn_sim.report.picture import (
    camera,
    caption,
    choose_moment,
    draw_moment,
    holding,
    told_of,
)
from hatn_sim.report.road_shapes import Box, road_shapes
from hatn_sim.report.run_figures import where
from hatn_sim.report.vehicle_shapes import outline, vehicle_parts
from hatn_sim.road import Road

CARS = frozenset({Kind.CAR})
FRAMES = 70
SPEED_MPS = 8.0
# Both lanes run straight through (0, 0); the eastbound car gets there first.
START_M = {"eastbound": -20.0, "northbound": -36.0}
COLOUR = {"eastbound": (30, 200, 60), "northbound": (210, 40, 40)}
# A fifth of that and four of the paint of green (28, 152, 68) and of red (226, 44, 36).
PAINTED = {"eastbound": [28, 162, 66], "northbound": [223, 43, 37]}
SURE_OF_PASS = 0.8


def lane(name: str, start: tuple[float, float], end: tuple[float, float], **more: object) -> Lane:
    points = np.linspace(start, end, 3)
    return Lane(name, points, 3.5, 13.9, (), CARS, **more)  # type: ignore[arg-type]


CROSSING = [
    lane("east", (-80.0, 0.0), (80.0, 0.0)),
    lane("north", (0.0, -80.0), (0.0, 80.0), gate=Gate.GIVE_WAY_LINE),
]


def scene_at(frame: int, names: tuple[str, ...]) -> Scene:
    count = len(names)
    along = np.array([START_M[name] for name in names]) + SPEED_MPS * DT_S * frame
    east = np.array([name == "eastbound" for name in names])
    return Scene(
        time_s=100.0 + DT_S * frame,
        ids=names,
        xy_m=np.stack((np.where(east, along, 0.0), np.where(east, 0.0, along)), axis=1),
        yaw_rad=np.where(east, 0.0, 0.5 * np.pi),
        speed_mps=np.full(count, SPEED_MPS),
        size_m=np.tile([4.0, 1.8], (count, 1)),
        kind=np.zeros(count, dtype=np.int64),
        colour=np.array([COLOUR[name] for name in names], dtype=np.int64).reshape(-1, 3),
        blinker=np.zeros(count, dtype=np.int64),
        signal_closed=np.zeros(0, dtype=bool),
    )


def write_run(
    out: Path, frames: int = FRAMES, names: tuple[str, ...] = tuple(START_M), finished: bool = True
) -> Run:
    """Two cars at a crossing; the first is told to pass, the second (wrongly) to pass as well."""
    writer = RunWriter(out, {"scene": "crossing", "lines": "inferred"})
    state = begin(Road(CROSSING))
    for frame in range(frames):
        scene = scene_at(frame, names)
        state = perceive(state, scene, None)
        graphs = build_graphs(state.road, state.seen)
        ahead_m = SPEED_MPS * DT_S * np.arange(1, HORIZON_FRAMES + 1)
        heading = np.stack((np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)), axis=1)
        chance = np.zeros(graphs.node_mask.shape)
        chance[:, 0], chance[:, 1] = 1.0 - SURE_OF_PASS, SURE_OF_PASS
        prediction = Prediction(
            ids=scene.ids,
            xy_m=(scene.xy_m[:, None] + heading[:, None] * ahead_m[:, None])[:, None],
            mode_probability=np.ones((len(names), 1)),
            fallback=np.zeros(len(names), dtype=bool),
            adapted=np.zeros(len(names), dtype=bool),
            lines=state.seen.lines,
            graphs=graphs,
            slot_probability=np.where(graphs.has_conflict[:, None], chance, 0.0),
        )
        truth = Truth((None,) * len(names))
        writer.write(frame, Frame(scene, truth, False), {"made_up": Advice(prediction, (), ())})
    writer.close(finished=finished)
    write_road(out / ROAD_FILE, CROSSING)
    return read_run(out)


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return write_run(tmp_path_factory.mktemp("runs") / "crossing")


# -- the lanes beside the log ---------------------------------------------------------------------


def test_lanes_are_read_as_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    lanes = [
        Lane(
            id=f":weg_{n}",
            xy_m=rng.normal(size=(n + 2, 2)) * 1e5,
            width_m=float(rng.random()),
            speed_limit_mps=float(rng.random()),
            successors=("a", "ü"),
            kinds=frozenset({Kind.CAR, Kind.TRAM}),
            gate=Gate.SIGNAL,
            signals=None if n else {"a": 3},
            turn=-1,
            is_connection=True,
        )
        for n in range(3)
    ]
    write_road(tmp_path / "one", lanes)
    write_road(tmp_path / "two", lanes)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    for before, after in zip(lanes, read_road(tmp_path / "one"), strict=True):
        np.testing.assert_array_equal(before.xy_m, after.xy_m)
        for name in set(before.__dataclass_fields__) - {"xy_m"}:
            assert getattr(before, name) == getattr(after, name)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "found no such file"),
        (b"no gzip", "damaged"),
        (gzip.compress(b"[]", mtime=0), "damaged"),
        (gzip.compress(json.dumps({"format": 1, "lanes": [{}]}).encode(), mtime=0), "damaged"),
        (gzip.compress(json.dumps({"format": 9}).encode(), mtime=0), "format 1, found 9"),
    ],
)
def test_bad_lanes_are_one_clear_line(tmp_path: Path, content: bytes | None, words: str) -> None:
    path = tmp_path / ROAD_FILE
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=words) as error:
        read_road(path)
    assert "make the run again" in str(error.value)
    assert "\n" not in str(error.value)


# -- which moment ---------------------------------------------------------------------------------


def test_the_moment_is_one_whose_advice_turned_out_right(crossing: Run) -> None:
    frame, ego_id = choose_moment(crossing)
    # "Pass" is right for the eastbound car only: it is first at (0, 0), after 2.5 s.
    assert ego_id == "eastbound"
    assert START_M[ego_id] + SPEED_MPS * DT_S * frame < 0.0
    assert frame + HORIZON_FRAMES < FRAMES
    assert choose_moment(crossing) == (frame, ego_id)


def test_time_and_ego_can_be_named(crossing: Run) -> None:
    assert choose_moment(crossing, time_s=101.04) == (10, "eastbound")
    assert choose_moment(crossing, ego_id="northbound")[1] == "northbound"
    # In the last 3 s nobody is in view for long enough, but whoever asks gets it.
    assert choose_moment(crossing, time_s=106.9, ego_id="northbound") == (69, "northbound")


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({"time_s": 99.0}, "no time 99 s; expected 100.0 to 106.9 s"),
        ({"ego_id": "eastbond"}, "did you mean 'eastbound'"),
    ],
)
def test_wrong_time_or_ego(crossing: Run, named: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        choose_moment(crossing, **named)  # type: ignore[arg-type]


def test_runs_with_nothing_to_show(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no vehicles in this run"):
        choose_moment(write_run(tmp_path / "empty", names=()))
    with pytest.raises(InputError, match="no vehicles in this run"):
        choose_moment(write_run(tmp_path / "nothing", frames=0))
    with pytest.raises(InputError, match="make a longer run"):
        choose_moment(write_run(tmp_path / "short", frames=HORIZON_FRAMES))
    alone = write_run(tmp_path / "alone", names=("eastbound",))
    assert choose_moment(alone) == (0, "eastbound")


# -- what there is to show ------------------------------------------------------------------------


def test_slots_lie_between_bumper_and_conflict(crossing: Run) -> None:
    frame = 10  # eastbound at x = -12, northbound at y = -28, bumpers 2 m ahead
    moment = moment_at(crossing, frame, "eastbound")
    own, other = moment.slots
    assert own.is_own and own.rear_id == "eastbound" and other.rear_id == "northbound"
    assert own.probability == pytest.approx(1.0 - SURE_OF_PASS)
    assert other.probability == pytest.approx(SURE_OF_PASS)
    np.testing.assert_allclose(own.strip_xy_m[[0, -1]], [[-10.0, 0.0], [0.0, 0.0]], atol=0.3)
    np.testing.assert_allclose(other.strip_xy_m[[0, -1]], [[0.0, -26.0], [0.0, 0.0]], atol=0.3)
    assert other.conflict_xy_m is not None
    np.testing.assert_allclose(other.conflict_xy_m, [0.0, 0.0], atol=0.3)
    assert list(moment.choice) == ["eastbound", "northbound"]


def test_forecasts_start_now_and_end_with_the_log(crossing: Run) -> None:
    forecast = moment_at(crossing, 60, "eastbound").forecasts["eastbound"]
    assert forecast.predicted_xy_m.shape == (1, HORIZON_FRAMES + 1, 2)
    assert len(forecast.actual_xy_m) == FRAMES - 60
    np.testing.assert_allclose(forecast.actual_xy_m[-1], [-20.0 + 0.8 * 69, 0.0])
    # These cars keep their speed, and that is what was predicted.
    np.testing.assert_allclose(
        forecast.predicted_xy_m[0, : FRAMES - 60], forecast.actual_xy_m, atol=1e-4
    )


def test_alerts_stand_from_their_onset_to_their_end() -> None:
    first, second = (Alert(k, "onset", "CONFLICT", 1.0, "a", "b", 0.5, "") for k in "12")
    edges = (
        (3, first),
        (5, second),
        (9, replace(first, edge="peak")),
        (9, replace(first, edge="end")),
    )
    run: Any = SimpleNamespace(alerts=edges)
    assert [alerts_at(run, frame) for frame in (2, 3, 5, 8, 9)] == [
        (), (first,), (first, second), (first, second), (second,),
    ]  # fmt: skip


def test_the_legend_tells_of_alerts_where_there_are_any(crossing: Run) -> None:
    moment = moment_at(crossing, 10, "eastbound")
    alert = Alert("1", "onset", "CONFLICT", 1.0, "eastbound", "northbound", 0.5, "")
    for shown, count in ((moment, 0), (replace(moment, alerts=(alert,)), 1)):
        sheet = open_sheet(POSTER, [], np.zeros(2), 50.0)
        artists, _ = draw_moment_on(sheet, shown, "")
        keys = [one for one in artists if isinstance(one, Text) and one.get_text() == "alert"]
        size_pt = 0.84 * POSTER.font_pt
        assert [one.get_fontsize() for one in keys].count(size_pt) == count


@pytest.mark.parametrize("style", [POSTER, FILM, SCREEN])
def test_signs_in_the_legend_lie_beside_each_other(crossing: Run, style: Style) -> None:
    """With all there may be, asked of what matplotlib drew: signals, an alert, the scale."""
    stop = lane("west", (-40.0, 0.0), (-5.0, 0.0), gate=Gate.SIGNAL, signals={"east": 0})
    moment = moment_at(crossing, 10, "eastbound")
    alert = Alert("1", "onset", "CONFLICT", 1.0, "eastbound", "northbound", 0.5, "", text="Brake")
    scene = replace(moment.scene, signal_closed=np.array([True]))
    moment = replace(moment, scene=scene, alerts=(alert,))
    sheet = open_sheet(style, [stop], np.zeros(2), 62.0)
    draw_moment_on(sheet, moment, "crossing")
    sheet.figure.canvas.draw()
    middle = 0.5 * style.footer_in
    legend = [t for t in sheet.page.texts if t.get_position()[1] == middle]
    assert {"slot, 0", "signal closed", "open", "alert", "5 m"} <= {t.get_text() for t in legend}
    (bar,) = [one for one in sheet.map.collections if one.get_zorder() == 3.2]
    assert np.allclose(bar.get_facecolor(), [to_rgba(CLOSED)])  # filled where it is closed
    ends = sorted((t.get_window_extent().x0, t.get_window_extent().x1) for t in legend)
    assert all(one[1] + 4.0 < other[0] for one, other in pairwise(ends))
    # The scale, 5 m long, ends at the margin; its words stand before it.
    scale_px = style.dpi * (style.width_in - style.margin_in - 5.0 * style.map_in[0] / 62.0)
    assert ends[-1][1] < scale_px
    # Nor does a sign lie under words: each line of the legend is clear of all of them.
    for line in sheet.page.lines:
        low, high = np.array(line.get_xdata(), dtype=float)[[0, -1]] * style.dpi
        if line.get_ydata()[0] == middle and line.get_marker() in ("", "None"):
            assert all(high <= left or right <= low for left, right in ends)


def test_an_alert_is_the_headline_and_advice_that_contradicts_it_is_not_said(
    crossing: Run,
) -> None:
    moment = moment_at(crossing, 10, "eastbound")
    said = Suggestion(
        "eastbound", 101.0, "abstain", "northbound", 0.5, 0.0, None, None, True, "Watch it"
    )
    alert = Alert("1", "onset", "CONFLICT", 1.0, "eastbound", "northbound", 0.5, "", text="Brake")
    minding = replace(alert, ego_id="northbound", other_id="eastbound")
    elsewhere = replace(alert, ego_id="northbound", other_id="somebody")
    for alerts, words, is_alarmed in (
        ((), "Watch it", False),
        ((elsewhere,), "Watch it", False),
        ((minding,), "northbound is told: Brake", True),
        ((minding, alert), "Brake", True),
        ((replace(alert, text="Earlier"), alert), "Brake", True),
    ):
        shown = replace(moment, suggestion=said, alerts=alerts)
        assert (shown.headline, shown.alarmed) == (words, is_alarmed)
        sheet = open_sheet(POSTER, [], np.zeros(2), 70.0)
        artists, _ = draw_moment_on(sheet, shown, "")
        drawn = [a.get_text() for a in artists if isinstance(a, Text)]
        assert (f"\u201c{words}\u201d" in drawn, f"\u26a0  {words}" in drawn) == (
            not is_alarmed, is_alarmed,
        )  # fmt: skip
        assert is_alarmed != any("Watch it" in one for one in drawn)
    assert replace(moment, alerts=(elsewhere,)).headline is None


def test_wrong_frame_or_ego_of_a_moment(crossing: Run) -> None:
    with pytest.raises(InputError, match="no frame 70; expected 0 to 69"):
        moment_at(crossing, FRAMES, "eastbound")
    with pytest.raises(InputError, match="no vehicle 'westbound'"):
        moment_at(crossing, 0, "westbound")


# -- the picture ----------------------------------------------------------------------------------


def test_vehicles_are_where_they_were(crossing: Run, tmp_path: Path) -> None:
    from hatn_sim.report.canvas import PAPER, POSTER

    draw_moment(crossing, 10, "eastbound", [tmp_path / "one.png"])
    draw_moment(crossing, 10, "eastbound", [tmp_path / "two.png"])
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    pixels = np.asarray(Image.open(tmp_path / "one.png").convert("RGB")).astype(int)
    assert pixels.shape == (round(POSTER.height_in * 200), round(POSTER.width_in * 200), 3)
    np.testing.assert_array_equal(pixels[2, 2], [int(PAPER[k : k + 2], 16) for k in (1, 3, 5)])

    wide_in, high_in = POSTER.map_in
    centre, width_m = camera([moment_at(crossing, 10, "eastbound")], wide_in / high_in)

    def at(x_m: float, y_m: float) -> list[int]:
        per_m = 200 * wide_in / width_m
        column = 200 * (POSTER.margin_in + 0.5 * wide_in) + (x_m - centre[0]) * per_m
        row = 200 * (POSTER.header_in + 0.5 * high_in) - (y_m - centre[1]) * per_m
        return pixels[round(row), round(column)].tolist()

    # The roof of a car is around a point 0.4 m behind its centre.
    assert at(-12.4, 0.0) == PAINTED["eastbound"]
    assert at(0.0, -28.4) == PAINTED["northbound"]
    verge, asphalt = at(-12.0, -12.0), at(-22.0, 0.9)
    assert min(verge) > 200 and max(asphalt) < 130


FAR = [(-20.0, 0.0), (-150.0, 0.0), (0.0, -140.0), (30.0, 90.0)]


@pytest.mark.parametrize("at", FAR)
@pytest.mark.parametrize("is_warned", [False, True])
def test_the_ego_those_it_is_told_of_and_their_conflict_are_in_the_picture(
    crossing: Run, at: tuple[float, float], is_warned: bool
) -> None:
    """However far away, they are where nothing lies over the map: asked of what matplotlib drew."""
    moment = moment_at(crossing, 10, "eastbound")
    scene = moment.scene
    xy_m = scene.xy_m.copy()
    xy_m[scene.ids.index("northbound")] = at
    said = Suggestion("eastbound", 101.0, "yield", "northbound", 0.9, 0.8, None, 5.0, True, "Yield")
    alert = Alert("1", "onset", "CONFLICT", 1.0, "eastbound", "northbound", 0.5, "", text="Brake")
    moment = replace(moment, scene=replace(scene, xy_m=xy_m), suggestion=said)
    moment = replace(moment, alerts=(alert,) if is_warned else ())
    wide, high = POSTER.map_in
    view = camera([moment], wide / high)
    centre, width_m = holding(*view, wide / high, told_of(moment))
    sheet = open_sheet(POSTER, [], centre, width_m)
    artists, _ = draw_moment_on(sheet, moment, "")
    sheet.figure.canvas.draw()
    frame = sheet.map.get_window_extent()
    fields = [a for a in artists if isinstance(a, Text) and "Brake" in a.get_text()]
    assert len(fields) == is_warned
    lies_over = [a.get_bbox_patch().get_window_extent() for a in fields]  # type: ignore[union-attr]
    for place in (*xy_m, (0.0, 0.0)):  # the lanes cross at (0, 0)
        x, y = sheet.map.transData.transform(place)
        assert frame.x0 < x < frame.x1 and frame.y0 < y < frame.y1
        assert not any(box.contains(x, y) for box in lies_over)
    words = {a.get_text() for a in artists if isinstance(a, Text)}
    assert "red car: pass before 80 %" in words


def test_a_view_that_holds_all_is_kept_and_others_are_moved_no_more_than_it_takes() -> None:
    centre, points = np.zeros(2), np.array([[-10.0, 5.0], [10.0, -5.0]])
    kept, width_m = holding(centre, 60.0, 2.0, points)
    assert (kept.tolist(), width_m) == ([0.0, 0.0], 60.0)
    # 40 m and 2.5 m around it have to lie within 30 m of the centre.
    moved, width_m = holding(centre, 60.0, 2.0, np.array([[40.0, 0.0]]))
    assert (moved.tolist(), width_m) == ([12.5, 0.0], 60.0)
    # 60 m and the rims are 65 m high, a view twice as wide as high 130 m.
    tall = np.array([[0.0, 0.0], [0.0, 60.0]])
    assert holding(centre, 60.0, 2.0, tall)[1] == pytest.approx(130.0)


def test_pictures_of_an_unfinished_run_say_so(tmp_path: Path) -> None:
    for is_finished in (True, False):
        run = write_run(tmp_path / str(is_finished), frames=40, finished=is_finished)
        for words in (caption(run, moment_at(run, 2, "eastbound")), where(run)):
            assert ("unfinished" in words) != is_finished


# Sight without one kind of cones: Machado, Oliveira and Fernandes, A Physiologically-based
# Model for Simulation of Color Vision Deficiency, 2009, severity 1.
SIGHT = {
    "all": np.eye(3),
    "without long": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
    "without middle": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
}  # fmt: skip
TO_XYZ = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]


def lab(colour: tuple[int, int, int], sight: str) -> np.ndarray:
    """CIELAB of an sRGB colour."""
    part = np.array(colour) / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    seen = np.clip(SIGHT[sight] @ linear, 0.0, 1.0)
    xyz = np.array(TO_XYZ) @ seen / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
def test_paints_are_told_apart_by_the_colour_blind(sight: str) -> None:
    for one, other in combinations(PAINTS.values(), 2):
        assert np.linalg.norm(lab(one, sight) - lab(other, sight)) > 13.0


@pytest.mark.parametrize(
    ("colour", "word", "hue_deg"),
    [((208, 176, 64), "orange", 31.0), ((90, 110, 140), "grey", None)],
)
def test_vehicles_look_like_the_word_they_are_called_by(
    colour: tuple[int, int, int], word: str, hue_deg: float | None
) -> None:
    assert look_of(int(Kind.CAR), colour) == f"{word} car"
    hue, saturation, _ = colorsys.rgb_to_hsv(*(part / 255.0 for part in paint_of(*colour)))
    if hue_deg is None:
        assert saturation < 0.1  # the colour itself: 0.36
    else:
        assert abs(360.0 * hue - hue_deg) < 4.0 and saturation > 0.8  # itself: 47 and 0.69


def test_a_moment_without_slots_is_drawn(tmp_path: Path) -> None:
    alone = write_run(tmp_path / "alone", frames=3, names=("eastbound",))
    draw_moment(alone, 2, "eastbound", [tmp_path / "alone.png"])
    assert (tmp_path / "alone.png").stat().st_size > 10_000


def test_matplotlib_is_imported_only_to_draw() -> None:
    code = (
        "import sys, hatn_sim.report.picture, hatn_sim.report.animation; "
        "sys.exit('matplotlib' in sys.modules or 'PIL' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# -- the film -------------------------------------------------------------------------------------


def test_a_film_of_an_unfinished_run(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", frames=14, finished=False)
    assert not run.finished
    for name in ("one.gif", "two.gif"):
        draw_animation(run, around(run, 9, "eastbound", 6), tmp_path / name)
    assert (tmp_path / "one.gif").read_bytes() == (tmp_path / "two.gif").read_bytes()
    film = Image.open(tmp_path / "one.gif")
    assert (film.n_frames, film.size) == (6, (720, 480))
    frames = [_frame(film, k) for k in range(film.n_frames)]
    assert film.info["duration"] == 100
    colours = np.unique(np.stack(frames) @ np.array([0x10000, 0x100, 1]))
    assert len(colours) <= 256
    # What does not move does not flicker: the legend is the same in all frames.
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame[-40:], frames[0][-40:])
        assert (frame != frames[0]).any()


def _frame(film: Image.Image, index: int) -> np.ndarray:
    film.seek(index)
    return np.asarray(film.convert("RGB"))


def test_a_film_is_shorter_where_the_run_is(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", frames=4)
    draw_animation(run, around(run, 1, "northbound"), tmp_path / "film.gif")
    assert Image.open(tmp_path / "film.gif").n_frames == 4


# -- shapes and labels ----------------------------------------------------------------------------

AROUND = Box(-30.0, -20.0, 30.0, 20.0)


def _outside_m(lanes: list[Lane], x_m: float, y_m: float) -> float:
    surface = road_shapes(lanes, AROUND).asphalt
    assert surface is not None
    row, column = np.abs(surface.y_m - y_m).argmin(), np.abs(surface.x_m - x_m).argmin()
    return float(surface.outside_m[row, column])


def test_asphalt_is_as_wide_as_the_lane_and_round_at_corners() -> None:
    assert _outside_m(CROSSING, 15.0, 1.0) == pytest.approx(-0.75, abs=0.1)
    assert _outside_m(CROSSING, 15.0, 4.75) == pytest.approx(3.0, abs=0.15)
    # A kerb of radius 3 m around (4.75, 4.75): its corner is paved, its centre 3 m outside.
    assert _outside_m(CROSSING, 2.2, 2.2) < 0.0
    kerb_m = 4.75 - 3.0 / np.sqrt(2.0)
    assert _outside_m(CROSSING, kerb_m, kerb_m) == pytest.approx(0.0, abs=0.15)
    assert _outside_m(CROSSING, 4.75, 4.75) == pytest.approx(3.0, abs=0.2)


def test_markings_between_lanes() -> None:
    right = lane("right", (-60.0, 0.0), (60.0, 0.0))
    left = lane("left", (-60.0, 3.5), (60.0, 3.5))
    oncoming = lane("oncoming", (60.0, 7.0), (-60.0, 7.0), gate=Gate.STOP_LINE)
    shapes = road_shapes([right, left, oncoming], AROUND)
    (dashed,) = shapes.dashed_xy_m
    np.testing.assert_allclose(dashed[:, 1], 1.75, atol=1e-9)
    # Each direction draws the line between them on its own left.
    assert {round(float(line[0, 1]), 6) for line in shapes.solid_xy_m} == {5.25}
    (stop,) = shapes.stop_lines
    assert stop.gate is Gate.STOP_LINE
    assert np.ptp(stop.corners_xy_m[:, 1]) == pytest.approx(3.5 - 2 * 0.18)
    assert stop.corners_xy_m[:, 0].min() == pytest.approx(-60.0)


@pytest.mark.parametrize("kind", list(Kind))
def test_vehicles_are_drawn_to_scale(kind: Kind) -> None:
    length_m, width_m = (0.7, 0.7) if kind is Kind.PEDESTRIAN else (8.0, 2.4)
    drawn = np.concatenate([part.xy_m for part in vehicle_parts(kind, length_m, width_m)])
    assert np.abs(drawn[:, 0]).max() == pytest.approx(0.5 * length_m, abs=0.01)
    assert np.abs(drawn[:, 1]).max() == pytest.approx(0.5 * width_m, abs=0.01)
    np.testing.assert_allclose(np.ptp(outline(length_m, width_m), axis=0), (length_m, width_m))


@pytest.mark.parametrize("seed", range(5))
def test_labels_overlap_neither_each_other_nor_the_border(seed: int) -> None:
    rng = np.random.default_rng(seed)
    labels = [
        Label(str(n), rng.uniform((-28.0, -18.0), (28.0, 18.0)), (9.0, 1.6)) for n in range(6)
    ]
    places = place_labels(labels, rng.uniform(-30.0, 30.0, (300, 2)), AROUND)
    for n, label in enumerate(labels):
        x, y = places[label.key]
        assert abs(x) <= 30.0 - 4.5 and abs(y) <= 20.0 - 0.8
        for other in labels[n + 1 :]:
            away = np.abs(places[label.key] - places[other.key])
            assert away[0] >= 9.0 or away[1] >= 1.6


def test_a_label_stays_where_it_was() -> None:
    label = Label("a", np.zeros(2), (9.0, 1.6))
    before = {"a": np.array([-7.0, 3.0])}
    nothing = np.zeros((0, 2))
    assert place_labels([label], nothing, AROUND, before)["a"].tolist() == [-7.0, 3.0]


@pytest.mark.parametrize("name", [r"$\frac{a$_^<b>", "bus$1$x_2", "one$", "plain"])
def test_names_are_no_formulas(name: str) -> None:
    """Ids may have dollars; matplotlib is asked how it reads them."""
    from matplotlib.text import Text
    from matplotlib.textpath import TextPath

    from hatn_sim.report.canvas import plain

    assert Text()._preprocess_math(plain(name)) == (name, False)
    assert len(TextPath((0, 0), plain(name)).vertices) > 0
