"""Suggestions: what is advised, to whom, in which words, and for how long."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of, with_signal_at_south

from hatn_sim.assist.at_signals import without
from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.assist.outlook import in_the_way, look_ahead, plausible_travel_m
from hatn_sim.assist.suggest import SuggestionState, _gap_is_there, slot_profiles, suggest
from hatn_sim.assist.told import Told
from hatn_sim.assist.words import names
from hatn_sim.datatypes import Kind, Prediction, Scene, Suggestion
from hatn_sim.graph import build_graphs
from hatn_sim.perception import begin, perceive
from hatn_sim.predictors.constant_velocity import extrapolate
from hatn_sim.road import Road

NORTH = np.pi / 2
ROAD = Road(crossing_lanes())


def moment(
    vehicles: dict[str, tuple[float, float, float, float]], chances: dict[str, list[float]]
) -> tuple[Scene, Prediction]:
    """A scene at the hand-drawn crossing, predicted at constant velocity, with given slots."""
    return moment_of(ROAD, scene_of(0.0, vehicles), chances)


def moment_of(
    road: Road, scene: Scene, chances: dict[str, list[float]] | None = None
) -> tuple[Scene, Prediction]:
    state = begin(road)
    for frame in range(3):
        state = perceive(state, replace(scene, time_s=0.1 * frame), None)
    scene, graphs = state.seen.scene, build_graphs(road, state.seen)
    probability = np.zeros(graphs.node_mask.shape)
    for e, ego in enumerate(graphs.ego.tolist()):
        given = (chances or {}).get(scene.ids[ego], [1.0])
        probability[e, : len(given)] = given
    count = len(scene.ids)
    return scene, Prediction(
        ids=scene.ids,
        xy_m=extrapolate(scene)[:, None],
        mode_probability=np.ones((count, 1)),
        fallback=np.zeros(count, dtype=np.bool_),
        adapted=np.zeros(count, dtype=np.bool_),
        lines=state.seen.lines,
        graphs=graphs,
        slot_probability=probability,
    )


TWO = {"ego": (-40.0, 0.0, 0.0, 10.0), "other": (0.0, -20.0, NORTH, 8.0)}


OPEN = {"ego": (0.0, -30.0, NORTH, 10.0), "other": (-58.0, 0.0, 0.0, 5.0)}
"""The ego is long gone when the other comes."""


def advise(
    vehicles: dict[str, tuple[float, float, float, float]],
    chance: list[float],
    state: SuggestionState | None = None,
    frames: int | None = None,
) -> tuple[SuggestionState, Suggestion]:
    """What the ego is told at the last of so many moments that differ in time alone.

    By default at the first if it was told something before, else at the fourth: advice begins when
    it has been the best for 0.3 s.
    """
    if frames is None:
        told = state.told.get("ego") if state is not None else None
        frames = 4 if told is None or told.action == "abstain" else 1
    scene, prediction = moment(vehicles, {"ego": chance})
    state = state or SuggestionState()
    found: list[Suggestion] = []
    for frame in range(frames):
        now = replace(scene, time_s=0.1 * frame)
        state, found[:] = suggest(state, ROAD, now, prediction, frozenset({"ego"}))
    return state, found[0]


def test_a_yield_names_whom_to_let_go_and_when() -> None:
    state, told = advise(TWO, [0.9, 0.1])
    assert (told.action, told.slot_id, told.feasible) == ("yield", "other", True)
    assert told.probability == pytest.approx(0.9)
    assert told.margin == pytest.approx(0.8)
    # The other's rear bumper is out after 20 + 2.5 + 1 m at 8 m/s; but there is a stop line.
    assert told.text == "Yield to the car from the right; wait until the way is clear"
    assert told.target_time_s is None
    assert len(told.profile_mps) == 50 and max(told.profile_mps) <= 10.0
    assert state.told["ego"].slot_id == "ego"


def test_a_pass_is_advised_where_it_is_safe() -> None:
    _, told = advise(OPEN, [0.1, 0.9])
    assert (told.action, told.slot_id, told.feasible) == ("pass", "other", True)
    # 26.5 m to the area: 2.65 s at 10 m/s, 2.16 s at 2 m/s^2 from now on; the jerk is bounded.
    assert told.target_time_s is not None and 2.2 < told.target_time_s < 2.65
    assert told.text == "Pass before the car from the left"


@pytest.mark.parametrize(("frames", "expected"), [(3, "abstain"), (4, "yield")])
def test_advice_begins_when_it_has_been_the_best_for_a_while(frames: int, expected: str) -> None:
    assert advise(TWO, [0.9, 0.1], None, frames)[1].action == expected


def test_advice_does_not_begin_that_is_over_before_a_driver_can_react() -> None:
    # 5 m to the point where the lines cross, at 10 m/s and more.
    late = {"ego": (0.0, -5.0, NORTH, 10.0), "other": (-58.0, 0.0, 0.0, 5.0)}
    assert advise(late, [0.1, 0.9])[1].action == "abstain"


THREE = TWO | {"third": (0.0, 34.0, -NORTH, 8.0)}
"""Whom the ego has to let go: one comes 20 m from the right, the other 34 m from the left."""
SOUTH = Road([*crossing_lanes(), lane("north_south", [(0, 60), (0, -60)], is_connection=True)])


@pytest.mark.parametrize(
    ("closed", "speed_mps", "expected"),
    [
        (False, 8.0, ["yield"]),
        (True, 8.0, []),  # 9.5 m to the signal: 3.4 m/s^2
        (True, 9.2, []),  # 4.5 m/s^2
        (True, 9.3, ["yield"]),  # will hardly stop
    ],
)
def test_nothing_is_said_of_one_whom_a_closed_signal_holds(
    closed: bool, speed_mps: float, expected: list[str]
) -> None:
    road = Road(with_signal_at_south(crossing_lanes()))
    scene = scene_of(0.0, TWO | {"other": (0.0, -20.0, NORTH, speed_mps)})
    scene = replace(scene, signal_closed=np.array([closed]))
    scene, prediction = moment_of(road, scene, {"ego": [0.9, 0.1]})
    state, said = SuggestionState(), ()
    for frame in range(4):
        now = replace(scene, time_s=0.1 * frame)
        state, said = suggest(state, road, now, prediction, frozenset({"ego"}))
    assert [one.action for one in said] == expected


def test_whom_a_signal_holds_leaves_his_chance_to_the_others() -> None:
    lanes = [*crossing_lanes(), lane("north_south", [(0, 60), (0, -60)], is_connection=True)]
    road = Road(with_signal_at_south(lanes))
    scene = replace(scene_of(0.0, THREE), signal_closed=np.array([True]))
    scene, prediction = moment_of(road, scene, {"ego": [0.1, 0.6, 0.3]})
    graphs = prediction.graphs
    assert graphs is not None
    row = graphs.ego.tolist().index(scene.ids.index("ego"))
    nodes = [scene.ids[v] for v in graphs.rear[row, :3].tolist()]
    assert sorted(nodes) == ["ego", "other", "third"]
    _, (told,) = suggest(SuggestionState(), road, scene, prediction, frozenset({"ego"}))
    assert told.slot_id == "third"
    # A yield, with 0.1; to go first has 0.6 + 0.3, whoever of the others comes next.
    assert (told.probability, told.margin) == pytest.approx((0.1, 0.1 - 0.9))
    # As if he were not there.
    alone = replace(scene_of(0.0, {k: v for k, v in THREE.items() if k != "other"}))
    alone = replace(alone, signal_closed=np.array([True]))
    scene, prediction = moment_of(road, alone, {"ego": [0.1, 0.9]})
    _, (without,) = suggest(SuggestionState(), road, scene, prediction, frozenset({"ego"}))
    assert (told.action, told.reason, told.text) == (without.action, without.reason, without.text)


@pytest.mark.parametrize("closed", [True, False])
def test_who_has_stopped_at_a_signal_stays_there_while_it_is_closed(closed: bool) -> None:
    road = Road(with_signal_at_south(crossing_lanes()))
    # Its front bumper is half a metre before the line; the other is far away.
    vehicles = {"ego": (0.0, -11.0, NORTH, 0.0), "other": (-55.0, 0.0, 0.0, 5.0)}
    scene = replace(scene_of(0.0, vehicles), signal_closed=np.array([closed]))
    scene, prediction = moment_of(road, scene)
    outlook = look_ahead(road, scene, prediction)
    row = np.flatnonzero(outlook.graphs.ego == scene.ids.index("ego")).repeat(2)
    stopped = SuggestionState(stopped=frozenset({"ego"}))
    ways = slot_profiles(stopped, outlook, row, np.array([0, 1]), np.array([1, 1]))
    went_m = 0.1 * ways.tick_speed_mps().sum(axis=1)
    assert (went_m < 0.5).all() if closed else went_m[1] > 5.0


def test_a_pass_before_one_who_is_held_is_a_pass_before_the_rest_evenly() -> None:
    scene, prediction = moment_of(SOUTH, scene_of(0.0, THREE | {"late": (0, -31, NORTH, 8.0)}))
    graphs = prediction.graphs
    assert graphs is not None
    row = graphs.ego.tolist().index(scene.ids.index("ego"))
    of = np.zeros(graphs.node_mask.shape)
    of[:, 0] = 1.0
    of[row, :4] = 0.25, 0.75, 0.0, 0.0
    held = np.zeros(of.shape, dtype=np.bool_)
    held[row, 1] = True
    rest = without(replace(prediction, slot_probability=of), held)
    assert rest.graphs is not None and rest.slot_probability is not None
    np.testing.assert_allclose(rest.slot_probability[row, [0, 2, 3]], [0.25, 0.375, 0.375])
    assert rest.graphs.focus_mask[row].tolist()[:4] == [True, False, True, True]
    others = np.arange(len(of)) != row
    np.testing.assert_array_equal(rest.slot_probability[others], of[others])


def test_a_yield_names_the_same_vehicle_while_it_has_to_be_let_go() -> None:
    state, said = SuggestionState(), list[tuple[str, str | None, str]]()
    for frame in range(30):
        chance = [0.9, 0.08, 0.02] if frame // 3 % 2 else [0.9, 0.02, 0.08]
        scene, prediction = moment_of(SOUTH, scene_of(0.0, THREE), {"ego": chance})
        now = replace(scene, time_s=0.1 * frame)
        state, (one,) = suggest(state, SOUTH, now, prediction, frozenset({"ego"}))
        said.append((one.action, one.slot_id, one.text.split(";")[0]))
    assert len(set(said[3:])) == 1 and said[3][0] == "yield"
    assert said[3][2].endswith("and 1 more")
    # Without a pause, and at once, of the one who is left.
    scene, prediction = moment(TWO, {"ego": [0.9, 0.1]})
    _, (one,) = suggest(state, ROAD, replace(scene, time_s=3.0), prediction, frozenset({"ego"}))
    assert (one.action, one.slot_id) == ("yield", "other") and "more" not in one.text


@pytest.mark.parametrize(
    ("std_m", "told"), [(0.1, "; go after it in "), (12.0, "; wait until the way is clear")]
)
def test_a_time_is_told_only_where_the_gap_behind_is_there(std_m: float, told: str) -> None:
    # At constant speed the third, 49.5 m from the place, is there after 5 s: the ego is there in
    # 2.8 s, and out of it in less than 5.
    vehicles = {
        "ego": (0.0, -17.0, NORTH, 5.0),
        "other": (-8.0, 0.0, 0.0, 10.0),
        "third": (-56.0, 0.0, 0.0, 10.0),
    }
    scene, prediction = moment(vehicles, {"ego": [0.9, 0.1, 0.0]})
    goal_m = 3.0 * scene.speed_mps[:, None]
    weight, spread = np.ones_like(goal_m), np.full_like(goal_m, std_m)
    goals = replace(prediction, goal_weight=weight, goal_mean_m=goal_m, goal_std_m=spread)
    state = SuggestionState()
    for frame in range(4):
        now = replace(scene, time_s=0.1 * frame)
        state, (one,) = suggest(state, ROAD, now, goals, frozenset({"ego"}))
    assert (one.action, one.slot_id) == ("yield", "other")
    assert told in one.text
    if one.target_time_s is None:
        assert "wait" in told
    else:
        assert 2.7 < one.target_time_s < 2.95 and "go after it in 2.8 s" in one.text


@pytest.mark.parametrize(
    ("kind", "soonest_s", "is_there"),
    [(0, 9.2, False), (0, 10.0, True), (1, 10.0, False), (1, 10.8, True)],
)
def test_a_gap_is_there_until_the_last_area_is_left(
    kind: int, soonest_s: float, is_there: bool
) -> None:
    """Whom it lets go crosses 10 to 17 m ahead, another one 40 to 47 m, at 20 m/s.

    The ego is there after 3.4 s; from a stand, 37 m at 2 m/s2 take 6.1 s, to 12.2 m/s: with the
    margin of a pass, 9.8 s. Where they merge, the other brakes from 20 m/s by 3 m/s2, which costs
    7.8^2 / (2 x 3 x 20) = 0.5 s.
    """
    outlook = SimpleNamespace(
        graphs=SimpleNamespace(
            focus_mask=np.ones((1, 3), np.bool_),
            rear=np.array([[0, 1, 2]]),
            conflict_type=np.full((1, 3), kind),
        ),
        scene=SimpleNamespace(speed_mps=np.array([5.0, 8.0, 20.0])),
        room_m=np.array([[0.0, 10.0, 40.0]]),
        clear_m=np.array([[0.0, 17.0, 47.0]]),
        soonest_s=np.array([[0.0, 1.0, soonest_s]]),
    )
    options: Any = SimpleNamespace(let_go=np.array([[False, True, False]]))
    profiles: Any = SimpleNamespace(arrival_s=lambda way_m: np.where(way_m > 20.0, 60.0, 3.4))
    chosen: Any = SimpleNamespace(node=np.array([1]))
    seen: Any = outlook
    found = _gap_is_there(seen, np.array([0]), options, chosen, profiles, np.array([3.4]))
    assert found.tolist() == [is_there]


def test_why_there_is_no_advice_can_be_read_before_it_is_something_else() -> None:
    state, said = SuggestionState(), list[str]()
    for frame in range(30):
        # As likely as not, then a pass that is not safe, in turns.
        scene, prediction = moment(TWO, {"ego": [0.5, 0.5] if frame % 2 else [0.05, 0.95]})
        now = replace(scene, time_s=0.1 * frame)
        state, (one,) = suggest(state, ROAD, now, prediction, frozenset({"ego"}))
        assert (one.action, one.slot_id) == ("abstain", "other")
        said.append(one.reason)
    changes = [k for k in range(1, 30) if said[k] != said[k - 1]]
    assert set(said) == {"unsure", "unsafe_pass"}
    assert changes and min(np.diff([0, *changes])) >= 10
    # Nothing is kept once there is advice.
    _, told = advise(TWO, [0.95, 0.05], state, 35)
    assert (told.action, told.reason) == ("yield", "likely")


def test_a_yield_to_one_who_has_gone_is_none_to_whoever_comes_next() -> None:
    gone = SuggestionState({"ego": Told("ego", "another", "yield", True)})
    assert advise(TWO, [0.3, 0.7], gone)[1].action == "abstain"
    assert advise(TWO, [0.9, 0.1], gone)[1].action == "yield"


@pytest.mark.parametrize(("since_s", "stays"), [(-0.5, True), (-1.1, False)])
def test_whether_it_is_feasible_stays_for_a_second_unless_in_danger(
    since_s: float, stays: bool
) -> None:
    told = Told("ego", "other", "yield", True, since_s=since_s)
    # From 10 m/s to a stand in 15 m takes 3.3 m/s^2 (4.4 as brakes are built up), in 10.5 m 4.8.
    for ego_m, expected in ((-18.5, stays), (-14.0, False)):
        vehicles = NEAR | {"ego": (0.0, ego_m, NORTH, 10.0)}
        _, found = advise(vehicles, [0.9, 0.1], SuggestionState({"ego": told}))
        assert found.feasible == expected, ego_m


NEAR = {"ego": (0.0, -14.0, NORTH, 10.0), "other": (-10.0, 0.0, 0.0, 8.0)}
"""The ego is out after 17.5 m, the other in after 6.5 m: 0.8 s."""


def test_what_people_do_is_not_advised_where_it_is_unsafe_nor_its_opposite() -> None:
    _, told = advise(NEAR, [0.02, 0.98])
    assert (told.action, told.profile_mps) == ("abstain", ())


def test_a_yield_told_before_stands_though_it_takes_hard_braking() -> None:
    before = SuggestionState({"ego": Told("ego", "other", "yield", True)})
    _, told = advise(NEAR, [0.9, 0.1], before)
    # It takes 10^2 / (2 * 10.5) = 4.8 m/s^2 to stay out.
    assert (told.action, told.slot_id, told.feasible) == ("yield", "other", False)
    assert told.text == "Brake hard: yield to the car from the left"
    assert told.probability == pytest.approx(0.9) and told.margin == pytest.approx(0.8)
    at_m = 0.1 * np.cumsum(told.profile_mps)
    assert at_m[: int(1.7 / 0.1)].max() < 10.75


BEHIND = {"ego": (0.0, -40.0, NORTH, 10.0), "other": (-40.0, 0.0, 0.0, 8.0)}
"""The ego can yield in comfort: 36.5 m to the area, which takes 1.4 m/s^2 to stop before."""


def said_behind(
    told: str, vehicles: dict[str, tuple[float, float, float, float]], lorry: tuple[float, float]
) -> Suggestion:
    """What the ego goes on to be told behind a lorry at a y with a speed."""
    y_m, speed_mps = lorry
    vehicles = vehicles | {"lorry": (0.0, y_m, NORTH, speed_mps)}
    scene = scene_of(0.0, vehicles)
    scene.kind[2] = Kind.LORRY
    chance = [0.95, 0.05] if told == "yield" else [0.05, 0.95]
    scene, prediction = moment_of(ROAD, scene, {"ego": chance})
    slot_id = "ego" if told == "yield" else "other"
    state = SuggestionState({"ego": Told(slot_id, "other", told, True)})
    _, (found,) = suggest(state, ROAD, scene, prediction, frozenset({"ego"}))
    assert found.action == told
    return found


@pytest.mark.parametrize(
    ("lorry", "expected"),
    [
        # 11 m from bumper to bumper: 10^2 / (2 * (11 - 2)) = 5.6 m/s^2.
        ((-24.0, 0.0), "Brake hard: the lorry ahead stands; then yield to the car from the left"),
        # 8 m/s slower, 7 m: 8^2 / (2 * (7 - 2)) = 6.4 m/s^2.
        ((-28.0, 2.0), "Brake hard for the lorry ahead; then yield to the car from the left"),
    ],
)
def test_hard_braking_names_the_leader_who_asks_for_it(
    lorry: tuple[float, float], expected: str
) -> None:
    found = said_behind("yield", BEHIND, lorry)
    assert found.text == expected and found.slot_id == "other"
    # Without the lorry there is nothing to brake hard for; the car comes in 4.6 s.
    state = SuggestionState({"ego": Told("ego", "other", "yield", True)})
    _, alone = advise(BEHIND, [0.95, 0.05], state)
    assert "rake" not in alone.text


def test_a_pass_names_the_leader_too() -> None:
    found = said_behind("pass", OPEN, (-16.0, 3.0))
    assert found.text == "Brake hard for the lorry ahead; then pass before the car from the left"


@pytest.mark.parametrize(
    ("speed_mps", "kind", "expected"),
    [
        (
            0.0,
            Kind.CAR,
            "Brake hard: the car from the right stands; then yield to another car from the right",
        ),
        (
            1.0,
            Kind.CAR,
            "Brake hard for the car from the right; then yield to another car from the right",
        ),
        (
            1.0,
            Kind.LORRY,
            "Brake hard for the car from the right; then yield to the lorry from the right",
        ),
    ],
)
def test_two_of_the_same_name_are_told_apart(speed_mps: float, kind: Kind, expected: str) -> None:
    # One has come from the left and is in the way with its tail, half across, 2.5 m before the
    # ego's nose. The other comes from the right on a further street.
    road = Road([*crossing_lanes(), lane("east_west", [(100, 7), (-100, 7)], is_connection=True)])
    vehicles = {
        "ego": (0.0, -6.0, NORTH, 6.0),
        "other": (16.0, 7.0, np.pi, 8.0),
        "across": (2.5, 0.0, 0.0, speed_mps),
    }
    scene = scene_of(0.0, vehicles)
    scene.kind[1] = kind
    scene, prediction = moment_of(road, scene, {"ego": [0.9, 0.1]})
    state = SuggestionState({"ego": Told("ego", "other", "yield", True)})
    _, (found,) = suggest(state, road, scene, prediction, frozenset({"ego"}))
    assert (found.action, found.slot_id) == ("yield", "other")
    # At 6 m/s it takes 6^2 / (2 * 2.5) = 7.2 m/s^2 to stop before the one that is in the way.
    assert found.text == expected


@pytest.mark.parametrize(("own_yield", "reason"), [(0.02, "which_gap"), (0.3, "unsure")])
def test_who_is_likely_to_go_before_somebody_is_told_that_it_is_open_before_whom(
    own_yield: float, reason: str
) -> None:
    vehicles = TWO | {"next": (0.0, -34.0, NORTH, 8.0)}
    scene, prediction = moment(vehicles, {})
    assert prediction.graphs is not None and prediction.slot_probability is not None
    row = int(np.flatnonzero(prediction.graphs.ego == scene.ids.index("ego"))[0])
    nodes = np.flatnonzero(prediction.graphs.focus_mask[row])
    assert len(nodes) == 3
    left = 1.0 - own_yield
    prediction.slot_probability[row, nodes] = own_yield, 0.52 * left, 0.48 * left
    _, (told,) = suggest(SuggestionState(), ROAD, scene, prediction, frozenset({"ego"}))
    assert (told.action, told.reason) == ("abstain", reason)


def test_whoever_is_spoken_of_next_is_another_one_if_called_the_same() -> None:
    _, alone = advise(TWO, [0.9, 0.1])
    assert alone.text.startswith("Yield to the car from the right")
    for who, expected in (
        ("the car from the right", "Yield to another car from the right"),
        ("another car from the right", "Yield to another car from the right"),
        ("the car from the left", "Yield to the car from the right"),
        ("the lorry from the right", "Yield to the car from the right"),
    ):
        gone = Told("gone", "gone", "pass", True, time_s=0.0, called=who)
        state, told = advise(TWO, [0.9, 0.1], SuggestionState({"ego": gone}), 4)
        assert told.slot_id == "other" and told.text.startswith(expected)
        # And it stays so.
        assert advise(TWO, [0.9, 0.1], state)[1].text.startswith(expected)
    same = Told("ego", "other", "yield", True, called="the car from the right")
    _, told = advise(TWO, [0.9, 0.1], SuggestionState({"ego": same}))
    assert told.text.startswith("Yield to the car from the right")


def test_a_leader_is_ahead_whatever_way_the_lane_bends() -> None:
    # On the quarter circle of the left turn, 12 m ahead of the ego and 45 degrees to its left.
    scene = scene_of(0.0, {"ego": (-8.0, 0.0, 0.0, 8.0), "lead": (0.0, 8.0, NORTH, 0.0)})
    ego, lead = np.array([0]), np.array([1])
    assert names(scene, ego, lead) == ["the car from the left"]
    assert names(scene, ego, lead, np.array([True])) == ["the car ahead"]


@pytest.mark.parametrize(("ego_mps", "begins"), [(1.8, "Stop: "), (2.1, "Brake hard: ")])
def test_hard_braking_from_a_walk_is_a_stop(ego_mps: float, begins: str) -> None:
    # 0.5 m before the area and what is kept of it: a stop takes 1.8^2 / (2 * 0.5) = 3.2 m/s^2.
    vehicles = {"ego": (0.0, -5.0, NORTH, ego_mps), "other": (-12.0, 0.0, 0.0, 8.0)}
    state = SuggestionState({"ego": Told("ego", "other", "yield", True)})
    _, found = advise(vehicles, [0.9, 0.1], state)
    assert found.text == f"{begins}yield to the car from the left"


def test_a_pass_stands_while_it_can_be_given_up_in_comfort() -> None:
    later = {"ego": (0.0, -35.0, NORTH, 10.0), "other": (-25.0, 0.0, 0.0, 6.0)}
    assert advise(later, [0.02, 0.98])[1].action == "pass"


def test_whoever_cannot_stop_any_more_clears_the_area() -> None:
    inside = {"ego": (0.0, -4.0, NORTH, 12.0), "other": (-12.0, 0.0, 0.0, 8.0)}
    before = SuggestionState({"ego": Told("ego", "other", "yield", True)})
    _, told = advise(inside, [0.9, 0.1], before)
    assert told.action == "pass" and told.slot_id == "other"
    # It is past the conflict in a third of a second: who was told nothing is told nothing more.
    assert advise(inside, [0.9, 0.1])[1].action == "abstain"


@pytest.mark.parametrize(
    ("front_m", "ego_mps", "reason"),
    [(1.5, 0.0, "in_the_way"), (1.5, 2.0, "in_the_way"), (0.5, 4.0, "too_late")],
)
def test_whoever_has_its_nose_inside_is_not_told_to_pass_what_it_will_not(
    front_m: float, ego_mps: float, reason: str
) -> None:
    # The front is at the area when the middle is 3.5 m before the point where the lines cross. Half
    # a metre inside, the ego is not in the way yet, but cannot stop before it any more. The other
    # is there in a second.
    y_m = front_m - 3.5
    inside = {"ego": (0.0, y_m, NORTH, ego_mps), "other": (-12.0, 0.0, 0.0, 8.0)}
    _, told = advise(inside, [0.99, 0.01])
    assert (told.action, told.reason) == ("abstain", reason)
    # Nor is that kept of a vehicle that has come to a stand.
    before = SuggestionState({"ego": Told("other", "other", "pass", False)})
    _, told = advise(inside, [0.99, 0.01], before, 12)
    assert (told.action == "abstain") == (ego_mps == 0.0)


def test_only_the_named_egos_are_advised_and_a_near_tie_abstains() -> None:
    scene, prediction = moment(TWO, {"ego": [0.55, 0.45], "other": [0.2, 0.8]})
    _, found = suggest(SuggestionState(), ROAD, scene, prediction, frozenset({"ego"}))
    assert [(one.ego_id, one.action) for one in found] == [("ego", "abstain")]
    _, nobody = suggest(SuggestionState(), ROAD, scene, prediction, frozenset())
    assert nobody == ()


@pytest.mark.parametrize("frames", [1, 5, 6])
def test_a_safe_pass_is_taken_back_by_silence_after_half_a_second_of_doubt(frames: int) -> None:
    told = SuggestionState({"ego": Told("other", "other", "pass", True)})
    _, found = advise(OPEN, [0.9, 0.1], told, frames)
    assert found.action == ("abstain" if frames == 6 else "pass")


def test_a_yield_is_never_followed_by_a_pass_before_the_same_vehicle() -> None:
    state, found = advise(OPEN, [0.97, 0.03])
    assert found.action == "yield"
    for time_s in (1.0, 1.5, 2.0, 60.0, 60.3):
        scene, prediction = moment(OPEN, {"ego": [0.1, 0.9]})
        now = replace(scene, time_s=time_s)
        state, (found,) = suggest(state, ROAD, now, prediction, frozenset({"ego"}))
        # After a minute without a choice it is another encounter.
        assert found.action == {1.0: "yield", 60.3: "pass"}.get(time_s, "abstain"), time_s


def test_advice_stands_while_another_slot_is_a_little_better() -> None:
    told = SuggestionState({"ego": Told("other", "other", "pass", True)})
    assert advise(OPEN, [0.65, 0.35], told, 20)[1].action == "pass"
    assert advise(OPEN, [0.75, 0.25], told, 20)[1].action == "abstain"


GENTLE = {"ego": (0.0, -30.0, NORTH, 10.0), "other": (-21.0, 0.0, 0.0, 8.0)}
"""After a second of reacting the ego has 16.5 m to stop in, which takes 3.03 m/s^2; the other is in
its way from 2.2 s to 3.6 s on."""


@pytest.mark.parametrize(("vehicles", "expected"), [(NEAR, "abstain"), (GENTLE, "yield")])
def test_an_unsafe_pass_is_taken_back_at_once(
    vehicles: dict[str, tuple[float, float, float, float]], expected: str
) -> None:
    # By a yield where a driver who has to react can still brake for it in comfort.
    told = SuggestionState({"ego": Told("other", "other", "pass", True)})
    assert advise(vehicles, [0.6, 0.4], told)[1].action == expected


def test_a_yield_does_not_begin_where_the_ego_might_as_well_pass() -> None:
    assert advise(OPEN, [0.9, 0.1])[1].action == "abstain"
    assert advise(OPEN, [0.97, 0.03])[1].action == "yield"


def test_of_two_told_to_yield_to_one_another_the_likelier_one_is() -> None:
    for chances, expected in (
        ({"ego": [0.97, 0.03], "other": [0.96, 0.04]}, ["yield", "abstain"]),
        ({"ego": [0.96, 0.04], "other": [0.97, 0.03]}, ["abstain", "yield"]),
    ):
        scene, prediction = moment(TWO | {"other": (0.0, -32.0, NORTH, 8.0)}, chances)
        state, found = SuggestionState(), ()
        for frame in range(4):
            now = replace(scene, time_s=0.1 * frame)
            state, found = suggest(state, ROAD, now, prediction, None)
        assert [one.action for one in sorted(found, key=lambda one: one.ego_id)] == expected
        # Whoever has been told to yield goes on, though the other becomes the likelier one to.
        chances = {"ego": chances["other"], "other": chances["ego"]}
        scene, prediction = moment(TWO | {"other": (0.0, -32.0, NORTH, 8.0)}, chances)
        _, found = suggest(state, ROAD, replace(scene, time_s=0.4), prediction, None)
        assert [one.action for one in sorted(found, key=lambda one: one.ego_id)] == expected


@pytest.mark.parametrize(("speed_mps", "expected"), [(0.0, "abstain"), (1.0, "yield")])
def test_nothing_is_said_to_two_who_wait_for_each_other(speed_mps: float, expected: str) -> None:
    # Either stands a metre before the area, and may be 4 m farther in 3 s.
    waiting = {"ego": (0.0, -4.5, NORTH, 0.0), "other": (-4.5, 0.0, 0.0, speed_mps)}
    scene, prediction = moment(waiting, {"ego": [0.02, 0.98]})
    one = np.ones((len(scene.ids), 1))
    prediction = replace(prediction, goal_weight=one, goal_mean_m=4.0 * one, goal_std_m=0.1 * one)
    state = SuggestionState({"ego": Told("ego", "other", "yield", True)})
    for frame in range(9):
        now = replace(scene, time_s=0.1 * frame)
        state, _ = suggest(state, ROAD, now, prediction, frozenset({"ego"}))
    now = replace(scene, time_s=0.9)
    _, (found,) = suggest(state, ROAD, now, prediction, frozenset({"ego"}))
    assert found.action == expected


@pytest.mark.parametrize(("chance", "passes"), [(0.9, False), (0.98, True)])
def test_only_a_sure_pass_stays_advised_where_somebody_might_plausibly_hurry(
    chance: float, passes: bool
) -> None:
    # The ego is out after 33.5 m, 3 s. The other comes after 21.5 m at 3 m/s, 7 s; one in five
    # times it is 24 m farther in 3 s, and comes before that.
    hurry = {"ego": (0.0, -30.0, NORTH, 10.0), "other": (-25.0, 0.0, 0.0, 3.0)}
    scene, prediction = moment(hurry, {"ego": [1.0 - chance, chance]})
    goals = np.tile([[0.8, 0.2]], (2, 1)), np.tile([[9.0, 24.0]], (2, 1)), np.full((2, 2), 0.1)
    weight, mean, std = goals
    prediction = replace(prediction, goal_weight=weight, goal_mean_m=mean, goal_std_m=std)
    told = SuggestionState({"ego": Told("other", "other", "pass", True)})
    for before, expected in ((told, passes), (SuggestionState(), False)):
        _, (found,) = suggest(before, ROAD, scene, prediction, frozenset({"ego"}))
        assert (found.action == "pass") == expected


def test_a_yield_that_comes_too_late_for_a_driver_to_react_is_not_begun() -> None:
    # 10 m/s, 16 m to the area: 3.1 m/s^2 to stop from now, 8 after a second of reacting. The
    # other comes in after 35 m, 4.4 s, when the ego is out.
    late = {"ego": (0.0, -19.5, NORTH, 10.0), "other": (-38.5, 0.0, 0.0, 8.0)}
    assert advise(late, [0.9, 0.1])[1].action == "abstain"
    told = SuggestionState({"ego": Told("ego", "other", "yield", True)})
    assert advise(late, [0.9, 0.1], told)[1].action == "yield"


def test_vehicles_may_plausibly_get_as_far_as_any_goal_of_some_weight() -> None:
    _, prediction = moment(TWO, {})
    steady = np.tile(np.arange(1, 31.0), (2, 1))  # 10 m/s
    goals = np.tile([[0.5, 0.45, 0.05]], (2, 1)), np.tile([[30.0, 12.0, 0.0]], (2, 1))
    weight, mean = goals
    prediction = replace(
        prediction, goal_weight=weight, goal_mean_m=mean, goal_std_m=np.zeros((2, 3))
    )
    fastest, slowest = plausible_travel_m(prediction, steady)
    assert np.allclose(fastest, steady)
    # 18 m less by braking evenly for 3 s is 2 t^2 less: it stands after 2.5 s, and 12.5 m.
    assert np.allclose(slowest[0, [9, 19, 24, 29]], [8.0, 12.0, 12.5, 12.5])


def test_a_leader_who_may_plausibly_stop_is_not_run_into() -> None:
    behind = OPEN | {"leader": (0.0, -15.0, NORTH, 10.0)}
    ways = {}
    for near_m in (30.0, 15.0):
        scene, prediction = moment(behind, {"ego": [0.1, 0.9]})
        weight = np.tile([[0.8, 0.2]], (3, 1))
        mean = np.array([[30.0, 30.0], [15.0, 15.0], [30.0, near_m]])
        prediction = replace(
            prediction, goal_weight=weight, goal_mean_m=mean, goal_std_m=np.zeros((3, 2))
        )
        outlook = look_ahead(ROAD, scene, prediction)
        row = np.flatnonzero(outlook.graphs.ego == scene.ids.index("ego"))
        slot = np.flatnonzero(outlook.graphs.focus_mask[row[0]])[1:]
        passes = slot_profiles(SuggestionState(), outlook, row, slot, slot)
        ways[near_m] = 0.1 * passes.tick_speed_mps()[0, :30].sum()
    # 10 m from bumper to bumper, and 15 m more while it stops.
    assert ways[15.0] < 25.0 < ways[30.0]


@pytest.mark.parametrize(("margin", "expected"), [(0.35, "abstain"), (0.45, "yield")])
def test_advice_begins_with_a_clear_lead_only(margin: float, expected: str) -> None:
    for before in (
        SuggestionState(),
        SuggestionState({"ego": Told("ego", "other", "abstain", True)}),
    ):
        chance = [0.5 + margin / 2, 0.5 - margin / 2]
        assert advise(TWO, chance, before)[1].action == expected


@pytest.mark.parametrize(("other_m", "expected"), [(-12.0, True), (-2.0, False)])
def test_a_nose_is_in_the_way_of_whoever_is_not_there_yet(other_m: float, expected: bool) -> None:
    # The area ends 3.5 m before and behind the point where the lines cross.
    vehicles = {"ego": (0.0, -2.0, NORTH, 8.0), "other": (other_m, 0.0, 0.0, 8.0)}
    scene, prediction = moment(vehicles, {})
    outlook = look_ahead(ROAD, scene, prediction)
    row = np.flatnonzero(outlook.graphs.ego == scene.ids.index("ego"))
    found = in_the_way(outlook, row)
    assert bool(found.any()) == expected
    node = int(outlook.graphs.node_mask[row[0]].nonzero()[0][-1])
    assert outlook.room_m[row[0], node] == pytest.approx(-1.5)


def test_whoever_has_its_nose_inside_is_not_asked_to_stop_there() -> None:
    vehicles = {"ego": (0.0, -2.0, NORTH, 8.0), "other": (-12.0, 0.0, 0.0, 8.0)}
    before = SuggestionState({"ego": Told("other", "other", "pass", True)})
    _, told = advise(vehicles, [0.95, 0.05], before)
    # It is out after 5.5 m, and the other comes in after 8.5 m.
    assert told.action == "pass" and min(told.profile_mps) > 7.9


@pytest.mark.parametrize("length_m", [5.0, 9.0])
def test_room_is_kept_for_a_body_that_cuts_its_corner(length_m: float) -> None:
    southbound = lane("ns", [(-4, 60), (-4, -60)], is_connection=True)
    road = Road([one for one in crossing_lanes() if one.id != "we"] + [southbound])
    at = {"ego": (-4.0, 25.0, -NORTH, 5.0), "truck": (-16.0, 0.0, 0.0, 4.0)}
    scene = scene_of(0.0, at, blinker=1)
    scene.size_m[1, 0] = length_m
    scene, prediction = moment_of(road, scene)
    outlook = look_ahead(road, scene, prediction)
    row = int(np.flatnonzero(outlook.graphs.ego == 0)[0])
    node = int(outlook.graphs.node_mask[row].nonzero()[0][-1])
    # Its bumpers follow the line, west to north in a quarter circle of 8 m: the body is a chord.
    turn = np.linspace(0.0, np.pi / 2, 400)
    way = np.array(
        [(-30.0, 0.0), *zip(-8.0 + 8.0 * np.sin(turn), 8.0 - 8.0 * np.cos(turn), strict=True)]
    )
    way = np.concatenate((way, [(0.0, 30.0)]))
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))))
    front_s = np.linspace(12.0, 60.0, 500)
    front, rear = (
        np.stack([np.interp(s, along, way[:, k]) for k in (0, 1)], axis=1)
        for s in (front_s, front_s - length_m)
    )
    heading = np.arctan2(*(front - rear).T[::-1])
    swept = Boxes(0.5 * (front + rear), heading, np.tile([length_m, 2.0], (500, 1)))

    def touches(y_m: float) -> bool:
        here = Boxes(
            np.tile([-4.0, y_m], (500, 1)), np.full(500, -NORTH), np.tile([5.0, 2.0], (500, 1))
        )
        return bool(overlap(swept, here).any())

    room_m = next(25.0 - y for y in np.arange(25.0, 0.0, -0.05) if touches(float(y)))
    assert room_m - 1.0 < outlook.room_m[row, node] < room_m + 0.1


@pytest.mark.parametrize(
    ("at", "side"),
    [
        ((10.0, 3.0), "ahead"),
        ((10.0, -3.0), "ahead"),
        ((10.0, 5.0), "from the left"),
        ((-5.0, 10.0), "from the left"),
        ((1.0, -10.0), "from the right"),
        ((-10.0, 3.0), "behind"),
        ((-10.0, -3.0), "behind"),
        ((-10.0, 6.0), "from behind on the left"),
        ((-10.0, -6.0), "from behind on the right"),
        ((-9.7, -9.3), "from behind on the right"),  # 136 degrees
        ((-9.0, -10.0), "from the right"),
    ],
)
def test_sides_are_told_by_the_bearing(at: tuple[float, float], side: str) -> None:
    # atan(3 / 10) is 16.7 degrees, atan(5 / 10) 26.6: the border is at 22.5.
    scene = scene_of(0.0, {"ego": (0.0, 0.0, 0.0, 5.0), "other": (*at, 0.0, 5.0)})
    ego, other = (np.array([scene.ids.index(name)]) for name in ("ego", "other"))
    assert names(scene, ego, other) == [f"the car {side}"]


@pytest.mark.parametrize(
    ("at", "yaw_deg", "name"),
    [
        ((20.0, 3.0), 180.0, "the oncoming car"),
        ((20.0, 3.0), -140.0, "the oncoming car"),
        ((20.0, 3.0), 130.0, "the car ahead"),  # it turns
        ((20.0, 3.0), 0.0, "the car ahead"),
        ((20.0, 12.0), 180.0, "the car from the left"),
        ((-20.0, 3.0), 180.0, "the car behind"),  # it has gone by
    ],
)
def test_who_is_ahead_and_comes_the_other_way_is_oncoming(
    at: tuple[float, float], yaw_deg: float, name: str
) -> None:
    scene = scene_of(0.0, {"ego": (0.0, 0.0, 0.0, 5.0), "other": (*at, np.deg2rad(yaw_deg), 5.0)})
    assert names(scene, np.array([0]), np.array([1])) == [name]
    # In the ego's own lane it is a leader, whichever way it has been turned.
    assert names(scene, np.array([0]), np.array([1]), np.array([True])) == ["the car ahead"]
