"""The choice of the reference line: by motion, blinker and habit, and never by the future."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of, slow_but

from hatn_sim.candidates import REST_FRAMES
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import FloatArray, IntArray, Kind, Lane, Lines, Scene
from hatn_sim.geometry import arc_length_m
from hatn_sim.habits import Habits, fresh_habits, learn, share_nats, silent_nats
from hatn_sim.line_choice import HAND_MADE_CHOICE, LineChoice
from hatn_sim.lines import LineState, empty_lines, follow_lines
from hatn_sim.road import Road
from hatn_sim.score.line_accuracy import LineJudge, line_scores
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_lanes import edge_of
from hatn_sim.tracks import empty_tracks, extend

SCENES = (
    "intersection5",
    "intersection4_allway",
    "tjunction",
    "roundabout8",
    "roundabout4_two_lane",
)
Pose = tuple[float, float, float, float]
Points = list[tuple[float, float]]


def arc(centre: tuple[float, float], radius_m: float, start: float, end: float) -> Points:
    """Points of an arc from one angle to another, in radians."""
    angles = np.linspace(start, end, 40)
    return [(centre[0] + radius_m * np.cos(t), centre[1] + radius_m * np.sin(t)) for t in angles]


LEFT = arc((0.0, 12.0), 12.0, -np.pi / 2, 0.0)
RIGHT = arc((0.0, -8.0), 8.0, np.pi / 2, 0.0)
AROUND = arc((0.0, 6.2), 3.0, -np.pi / 2, np.pi / 2)


def fork_lanes(angle_rad: float = 0.0, shift_m: tuple[float, float] = (0.0, 0.0)) -> list[Lane]:
    """Two lanes eastwards, `a` and on its left `b` (3.2 m), to a junction that begins at x = 0.

    From `a` straight on, left (radius 12 m) and right (8 m); from `b` straight on, and round by
    180 degrees (3 m) into the lane that leads back. Optionally turned and shifted.
    """
    lanes = [
        lane("a", [(-120, 0), (0, 0)], "a_s", "a_l", "a_r"),
        lane("b", [(-120, 3.2), (0, 3.2)], "b_s", "b_u"),
        lane("a_s", [(0, 0), (20, 0)], "east_a", is_connection=True),
        lane("a_l", LEFT, "north", is_connection=True, turn=1),
        lane("a_r", RIGHT, "south", is_connection=True, turn=-1),
        lane("b_s", [(0, 3.2), (20, 3.2)], "east_b", is_connection=True),
        lane("b_u", AROUND, "west", is_connection=True, turn=1),
        lane("east_a", [(20, 0), (220, 0)]),
        lane("east_b", [(20, 3.2), (220, 3.2)]),
        lane("north", [(12, 12), (12, 200)]),
        lane("south", [(8, -8), (8, -200)]),
        lane("west", [(0, 9.2), (-200, 9.2)]),
    ]
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    return [replace(one, xy_m=one.xy_m @ turn + np.array(shift_m)) for one in lanes]


def drive(
    path: Sequence[tuple[float, float]], step_m: float = 0.5, from_m: float = 5.0
) -> list[Pose]:
    """A car of 5 m whose front and rear run along a path, one pose a frame."""
    points = np.array(path, dtype=np.float64)
    s_m = arc_length_m(points)
    poses: list[Pose] = []
    for front_m in np.arange(from_m, s_m[-1], step_m).tolist():
        front, rear = (
            np.array([np.interp(at, s_m, points[:, axis]) for axis in (0, 1)])
            for at in (front_m, front_m - 5.0)
        )
        (dx, dy), (x, y) = (front - rear).tolist(), (0.5 * (front + rear)).tolist()
        poses.append((x, y, float(np.arctan2(dy, dx)), 10.0 * step_m))
    return poses


class Watcher:
    """Follows one car over frames and tells its line by the names of the lanes."""

    def __init__(self, road: Road, choice: LineChoice | None = None) -> None:
        self.road, self.choice = road, choice
        self.state: LineState = empty_lines()
        self.tracks = empty_tracks()
        self.lines: Lines | None = None
        self.time_s = 0.0

    def see(self, pose: Pose, blinker: int = 0, name: str = "v") -> tuple[str, ...]:
        """The lanes of its line after one more frame; none where there is no line."""
        scene = scene_of(self.time_s, {name: pose}, blinker)
        self.tracks = extend(self.tracks, scene)
        self.state, self.lines = follow_lines(
            self.state, self.road, self.tracks, scene, choice=self.choice
        )
        self.time_s += 0.1
        line = int(self.lines.line[0])
        return self.road.lines[line].route if line >= 0 else ()

    @property
    def probability(self) -> float:
        assert self.lines is not None
        return float(self.lines.probability[0])


def route_at(road: Road, poses: Sequence[Pose], blinker: int = 0) -> tuple[str, ...]:
    watcher = Watcher(road)
    return [watcher.see(pose, blinker) for pose in poses][-1]


APPROACH: Points = [(-60.0, 0.0), (0.0, 0.0)]


@pytest.mark.parametrize(
    ("path", "connection"),
    [([*APPROACH, (20, 0)], "a_s"), (APPROACH + LEFT[1:], "a_l"), (APPROACH + RIGHT[1:], "a_r")],
)
def test_motion_decides_soon_after_the_fork(path: Points, connection: str) -> None:
    """With the front 3 m in, the turns are 0.4 and 0.6 m off the straight."""
    watcher = Watcher(Road(fork_lanes()))
    for front_m, pose in zip(np.arange(5.0, 100.0, 0.5), drive(path), strict=False):
        route = watcher.see(pose)
        if front_m >= 63.0:
            assert connection in route
            assert watcher.probability > 0.9


@pytest.mark.parametrize(("blinker", "connection"), [(1, "a_l"), (-1, "a_r")])
def test_a_blinker_decides_before_the_fork(blinker: int, connection: str) -> None:
    route = route_at(Road(fork_lanes()), drive([(-70.0, 0.0), (-20.0, 0.0)]), blinker)
    assert connection in route


@pytest.mark.xfail(strict=True, reason="the learnt choice takes no blinker for no news")
def test_no_blinker_means_straight_on() -> None:
    route = route_at(Road(fork_lanes()), drive([(-70.0, 0.0), (-20.0, 0.0)]))
    assert "a_s" in route


def test_no_blinker_means_straight_on_by_hand() -> None:
    watcher = Watcher(Road(fork_lanes()), HAND_MADE_CHOICE)
    poses = drive([(-70.0, 0.0), (-20.0, 0.0)])
    assert "a_s" in [watcher.see(pose) for pose in poses][-1]


def test_a_blinker_that_is_set_late_counts_at_once() -> None:
    watcher = Watcher(Road(fork_lanes()))
    *before, last = drive([(-70.0, 0.0), (-5.0, 0.0)])
    assert "a_l" not in [watcher.see(pose, blinker=-1) for pose in before][-1]
    assert "a_l" in watcher.see(last, blinker=1)


def test_where_lines_tie_the_probability_says_so() -> None:
    """Far from the junction, three equal ways; the two on the lane beside are out of question."""
    watcher = Watcher(Road(fork_lanes()), HAND_MADE_CHOICE)
    for pose in drive([(-120.0, 0.0), (-70.0, 0.0)]):
        watcher.see(pose)
    assert watcher.probability == pytest.approx(1.0 / 3.0, abs=0.02)


def test_a_change_of_lanes_is_followed_at_once() -> None:
    watcher = Watcher(Road(fork_lanes()))
    for x, y, *rest in drive([(-100, 0), (-70, 0), (-45, 3.2), (-10, 3.2)]):
        route = watcher.see((x, y, *rest))
        assert route, "never without a line"
        assert "a" in route or y > 1.0
        assert "b" in route or y < 2.5


def test_overtaking_leads_back_to_the_own_lane() -> None:
    road = Road(fork_lanes())
    narrow = [(-100, 0), (-80, 0), (-70, 1.3), (-50, 1.3), (-40, 0), (-20, 0)]
    watcher = Watcher(road)
    assert all("a" in watcher.see(pose) for pose in drive(narrow)), "half a lane is no change"
    wide = [(-110, 0), (-90, 0), (-75, 3.2), (-50, 3.2), (-30, 0), (-10, 0)]
    assert "a" in route_at(road, drive(wide))


def test_who_cuts_the_corner_keeps_the_line() -> None:
    """Round an arc of 12 m that begins 4 m early: up to 1.7 m inside the right turn of 8 m."""
    cut = arc((-4.0, -12.0), 12.0, np.pi / 2, 0.0)
    watcher = Watcher(Road(fork_lanes()))
    for x, y, *rest in drive([(-60.0, 0.0), *cut, (8.0, -60.0)]):
        route = watcher.see((x, y, *rest))
        assert y > -1.5 or "a_r" in route


def test_who_strays_has_no_line_and_is_seldom_searched_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    road = Road(fork_lanes())
    searches: list[int] = []
    search = road.lane_graph.near

    def counted(xy_m: FloatArray, yaw_rad: float, kind: Kind) -> list[str]:
        searches.append(1)
        return search(xy_m, yaw_rad, kind)

    monkeypatch.setattr(road.lane_graph, "near", counted)
    watcher = Watcher(road)
    off_road = drive([(-60, 0), (-50, 0), (-40, -8), (20, -30), (60, -30)])
    routes = [watcher.see(pose) for pose in off_road]
    assert all(route == () for (_, y, *_), route in zip(off_road, routes, strict=True) if y < -6)
    assert watcher.probability == 0.0
    assert len(searches) <= len(off_road) / REST_FRAMES + 3


def test_against_the_direction_there_is_no_line() -> None:
    assert route_at(Road(fork_lanes()), [(-50.0, 0.0, np.pi, 5.0)] * 5) == ()


def test_turning_around_is_believed_when_it_is_seen() -> None:
    road = Road(fork_lanes())
    before: Points = [(-60.0, 3.2), (0.0, 3.2)]
    assert "b_s" in route_at(road, drive(before)), "rare, so not expected"
    assert "b_u" in route_at(road, drive(before), blinker=1), "the only turn to that side"
    watcher = Watcher(road)
    path = [*before, *AROUND[1:], (-40.0, 9.2)]
    for front_m, pose in zip(np.arange(5.0, 200.0, 0.5), drive(path), strict=False):
        route = watcher.see(pose)
        assert front_m < 63.0 or "b_u" in route


def test_waiting_inside_the_junction_changes_nothing() -> None:
    """A left turn begun waits for a minute for oncoming traffic, its blinker on or forgotten."""
    watcher = Watcher(Road(fork_lanes()))
    poses = drive([*APPROACH, *LEFT[1:]])[:118]
    routes = [watcher.see(pose, blinker=1) for pose in poses]
    assert "a_l" in routes[-1]
    before = watcher.probability
    for frame in range(600):
        assert watcher.see((*poses[-1][:3], 0.0), blinker=frame % 2) == routes[-1]
    assert watcher.see(poses[-1], blinker=1) == routes[-1]
    assert watcher.probability == pytest.approx(before, abs=1e-6)


def test_a_wrong_choice_is_mended_inside_the_junction() -> None:
    """The blinker lies: it drives straight on nevertheless."""
    watcher = Watcher(Road(fork_lanes()))
    routes = [watcher.see(pose, blinker=1) for pose in drive([*APPROACH, (20, 0), (60, 0)])]
    assert "a_l" in routes[100]
    assert "a_s" in routes[-1]


def test_what_others_did_is_expected_of_the_next() -> None:
    """Two exits on the right, signalled alike: the habit of those before tells."""
    wide = arc((0.0, -30.0), 30.0, np.pi / 2, 0.3)
    lanes = fork_lanes()
    lanes[0] = replace(lanes[0], successors=("a_w", "a_r", "a_s"))
    lanes += [
        lane("a_w", wide, "far", is_connection=True, turn=-1),
        lane("far", [wide[-1], (wide[-1][0] + 30.0, wide[-1][1] - 100.0)]),
    ]
    watcher = Watcher(Road(lanes), HAND_MADE_CHOICE)
    for number, (way, name) in enumerate([(RIGHT, "a_r")] * 4 + [(wide, "a_w")] * 12):
        (x, y), (x_before, y_before) = way[-1], way[-2]
        onward = (x + 5.0 * (x - x_before), y + 5.0 * (y - y_before))
        out = drive([*APPROACH, *way[1:], onward])
        routes = [watcher.see(pose, blinker=-1, name=f"{name}{number}") for pose in out]
        assert name in routes[-1]
    *_, route = (watcher.see(pose, -1, "next") for pose in drive(APPROACH))
    assert "a_w" in route
    # One and four, one and twelve; who signals hardly drives straight on.
    assert watcher.probability == pytest.approx(13.0 / 18.0, abs=0.03)


def test_habits_by_hand() -> None:
    road = Road(fork_lanes())
    number = {name: row for row, name in enumerate(road.lanes)}
    habits = fresh_habits(road)

    def shares(known: Habits, *names: str) -> list[float]:
        connections: IntArray = np.array([number[name] for name in names])
        return np.exp(-share_nats(known, connections)).tolist()

    assert shares(habits, "a_s", "a_l", "a_r") == pytest.approx([1 / 3] * 3)
    assert shares(habits, "b_s", "b_u") == pytest.approx([1 / 1.05, 0.05 / 1.05])
    left = np.array([number["a_l"], number["a_l"], number["b_u"]])
    nobody = np.zeros(0, dtype=np.int64)
    later = learn(habits, left, nobody, nobody)
    assert shares(later, "a_s", "a_l", "a_r") == pytest.approx([1 / 5, 3 / 5, 1 / 5])
    assert shares(later, "b_s", "b_u") == pytest.approx([1 / 2.05, 1.05 / 2.05])
    assert shares(habits, "a_l") == pytest.approx([1 / 3]), "the old habits are as they were"
    # Three of four signal; then four turn, one of them signals: four of eight.
    assert silent_nats(habits) == pytest.approx(np.log(4.0))
    turning = learn(habits, nobody, np.array([1, 1, -1, -1]), np.array([1, 0, 0, 0]))
    assert silent_nats(turning) == pytest.approx(np.log(2.0))


def three_cars(angle_rad: float, shift_m: tuple[float, float], order: list[int]) -> list[Scene]:
    """Frames of one car that turns left, one that changes lanes and one far behind."""
    paths = [
        [*APPROACH, *LEFT[1:]],
        [(-100, 0), (-70, 0), (-45, 3.2), (-10, 3.2)],
        [(-118, 3.2), (-40, 3.2)],
    ]
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    frames: list[Scene] = []
    for frame, poses in enumerate(zip(*(drive(path) for path in paths), strict=False)):
        moved = {
            f"v{k}": (
                cos * poses[k][0] - sin * poses[k][1] + shift_m[0],
                sin * poses[k][0] + cos * poses[k][1] + shift_m[1],
                float(np.angle(np.exp(1j * (poses[k][2] + angle_rad)))),
                poses[k][3],
            )
            for k in order
        }
        frames.append(scene_of(0.1 * frame, moved))
    return frames


def outcome(
    road: Road, frames: Sequence[Scene]
) -> list[dict[str, tuple[tuple[str, ...], FloatArray]]]:
    """The route of every car and its s, d, heading and probability, frame by frame."""
    state, tracks = empty_lines(), empty_tracks()
    told: list[dict[str, tuple[tuple[str, ...], FloatArray]]] = []
    for scene in frames:
        tracks = extend(tracks, scene)
        state, lines = follow_lines(state, road, tracks, scene)
        values = np.stack((lines.s_m, lines.d_m, lines.phi_rad, lines.probability), axis=1)
        told.append(
            {
                name: (road.lines[int(lines.line[k])].route, values[k])
                for k, name in enumerate(scene.ids)
            }
        )
    return told


@pytest.mark.parametrize(
    ("angle_rad", "shift_m", "order"),
    [
        (0.0, (0.0, 0.0), [2, 0, 1]),
        (2.3, (1000.0, -400.0), [0, 1, 2]),
        (-0.7, (5.0, 5.0), [1, 2, 0]),
    ],
)
def test_turned_shifted_and_in_another_order_the_lines_are_the_same(
    angle_rad: float, shift_m: tuple[float, float], order: list[int]
) -> None:
    base = outcome(Road(fork_lanes()), three_cars(0.0, (0.0, 0.0), [0, 1, 2]))
    other = outcome(Road(fork_lanes(angle_rad, shift_m)), three_cars(angle_rad, shift_m, order))
    assert len(base) > 50
    for one, two in zip(base, other, strict=True):
        for name, (route, values) in one.items():
            assert two[name][0] == route
            np.testing.assert_allclose(two[name][1], values, atol=1e-5)


def test_nobody_in_view() -> None:
    road = Road(crossing_lanes())
    scene = scene_of(0.0, {})
    state, lines = follow_lines(empty_lines(), road, extend(empty_tracks(), scene), scene)
    assert state.line.shape[0] == 0
    assert len(lines.line) == 0


@pytest.mark.parametrize("scene", slow_but(SCENES, "intersection5", "roundabout4_two_lane"))
def test_inferred_lines_are_the_routes(scene: str) -> None:
    """Against the simulator's routes, from the first metre of the junction on."""
    with SumoSimulator(load_scenario(scene)) as simulator:
        frame = simulator.reset(5)
        judge = LineJudge(simulator.road, edge_of, scene)
        for index in range(900):
            judge.see(frame, counts=index % 5 == 0)
            frame = simulator.step()
    scores = {score.measure: score for score in line_scores(judge.samples(), scene)}
    inside, blinking = scores["line_right_inside"], scores["line_right_20m_blinker"]
    assert inside.n > 50
    assert inside.value is not None and blinking.value is not None
    assert inside.value > 0.94
    # Two exits on one side are told apart by nothing before the stop line of an all-way stop.
    assert blinking.value > (0.5 if scene == "intersection5" else 0.95)
    assert scores["line_fallback_share"].value == 0.0


def test_lanes_of_no_length_and_points_twice_are_no_trouble() -> None:
    lanes = [
        lane("a", [(0, 0), (50, 0), (50, 0)], "c"),
        lane("c", [(50, 0), (50, 0)], "b", is_connection=True, turn=1),
        lane("b", [(50, 0), (50, 0), (100, 0)]),
        lane("point", [(50, 0)], "c"),
    ]
    poses = drive([(0.0, 0.0), (90.0, 0.0)])
    assert route_at(Road(lanes), poses) == ("a", "c", "b")
    assert route_at(Road([]), poses) == ()
