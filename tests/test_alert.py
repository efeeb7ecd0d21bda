"""Alert rules at hand-drawn moments, intervals of alerts, and their settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of

from hatn_sim.assist.alert import AlertState, alert
from hatn_sim.assist.baselines import RULES
from hatn_sim.assist.danger import hatn_rule
from hatn_sim.assist.moment import DEVIATION, TYPES, Moment, PairDangers, Recent
from hatn_sim.assist.settings import AssistSettings, read_assist_settings
from hatn_sim.datatypes import Alert, Lane, Prediction
from hatn_sim.errors import InputError
from hatn_sim.graph import build_graphs
from hatn_sim.perception import begin, perceive
from hatn_sim.predictors.constant_velocity import extrapolate
from hatn_sim.road import Road
from hatn_sim.score.dangers import DangerRecorder, alerts_at

NORTH = np.pi / 2
SETTINGS = AssistSettings()
WHY = "danger 0.90 (of 1) to collide or to brake hard within 5 s"


def moment(
    east: tuple[float, float, float],
    north: tuple[float, float, float],
    north_yields: float = 0.0,
    *,
    lanes: list[Lane] | None = None,
    closed: tuple[bool, ...] = (),
) -> Moment:
    """Two cars before the crossing: way to its middle, speed, acceleration; predicted to go on.

    A second ago, the car from the south was to yield with a probability. `closed` are the signals
    of `lanes`.
    """
    state = begin(Road(lanes or crossing_lanes()))
    for frame in range(11):
        ago_s = 0.1 * (10 - frame)
        rows = []
        for to_go_m, speed_mps, gain_mps2 in (east, north):
            back_m = speed_mps * ago_s - 0.5 * gain_mps2 * ago_s**2
            rows.append((-to_go_m - back_m, speed_mps - gain_mps2 * ago_s))
        vehicles = {
            "a": (rows[0][0], 0.0, 0.0, rows[0][1]),
            "b": (0.0, rows[1][0], NORTH, rows[1][1]),
        }
        scene = replace(scene_of(0.1 * frame, vehicles), signal_closed=np.array(closed, np.bool_))
        state = perceive(state, scene, None)
    seen, graphs = state.seen, build_graphs(state.road, state.seen)
    chances = np.zeros(graphs.node_mask.shape)
    chances[:, :2] = [[0.5, 0.5], [north_yields, 1.0 - north_yields]]
    prediction = Prediction(
        ids=seen.scene.ids,
        xy_m=extrapolate(seen.scene)[:, None],
        mode_probability=np.ones((2, 1)),
        fallback=np.zeros(2, dtype=np.bool_),
        adapted=np.zeros(2, dtype=np.bool_),
        lines=seen.lines,
        graphs=graphs,
        slot_probability=chances,
    )
    return Moment(state.road, seen, prediction, prediction)


def row(away_m: float, rear_mps: float) -> Moment:
    """Two in a lane, their middles so far apart, the one ahead at 0.5 m/s; predicted to go on."""
    state = begin(Road(crossing_lanes()))
    for frame in range(11):
        way_m = 0.1 * (frame - 10) * rear_mps
        vehicles = {
            "front": (-20.0, 0.0, 0.0, 0.5),
            "rear": (-20.0 - away_m + way_m, 0.0, 0.0, rear_mps),
        }
        state = perceive(state, scene_of(0.1 * frame, vehicles), None)
    scene, graphs = state.seen.scene, build_graphs(state.road, state.seen)
    prediction = Prediction(
        ids=scene.ids,
        xy_m=extrapolate(scene)[:, None],
        mode_probability=np.ones((2, 1)),
        fallback=np.zeros(2, dtype=np.bool_),
        adapted=np.zeros(2, dtype=np.bool_),
        lines=state.seen.lines,
        graphs=graphs,
        slot_probability=np.zeros(graphs.node_mask.shape),
    )
    return Moment(state.road, state.seen, prediction)


def test_danger_grows_as_they_come_nearer_and_ends_where_one_gives_way() -> None:
    def danger(east: tuple[float, float, float], north: tuple[float, float, float]) -> float:
        return float(hatn_rule(moment(east, north)).danger.sum())

    at_once = danger((20.0, 9.0, 0.0), (20.0, 9.0, 0.0))
    assert at_once > SETTINGS.alert_onset
    assert danger((45.0, 9.0, 0.0), (45.0, 9.0, 0.0)) < at_once  # later
    assert danger((20.0, 9.0, 0.0), (20.0, 9.0, -6.0)) < at_once  # one brakes
    assert danger((20.0, 9.0, 0.0), (60.0, 9.0, 0.0)) < 0.1 * at_once  # one comes long after


def test_who_was_to_yield_and_goes_first_deviates() -> None:
    sure = hatn_rule(moment((22.0, 9.0, 0.0), (20.0, 9.0, 0.0), north_yields=0.99))
    assert sure.type is not None
    assert [TYPES[kind] for kind in sure.type] == ["DEVIATION"]
    assert (sure.first.tolist(), sure.second.tolist()) == ([1], [0])  # who deviates, first
    unsure = hatn_rule(moment((22.0, 9.0, 0.0), (20.0, 9.0, 0.0), north_yields=0.6))
    assert unsure.type is not None
    assert [TYPES[kind] for kind in unsure.type] == ["CONFLICT"]


@pytest.mark.parametrize("name", RULES)
def test_every_rule_knows_danger_from_none(name: str) -> None:
    bad = RULES[name](moment((20.0, 9.0, 0.0), (20.0, 9.0, 0.0))).danger
    good = RULES[name](moment((30.0, 4.0, 0.0), (25.0, 9.0, 0.0))).danger
    assert len(bad) == (name != "never")
    assert good.sum() == (1.0 if name == "always" else pytest.approx(0.0, abs=0.1 * bad.sum()))


def test_baselines_by_hand() -> None:
    # a: 16.5 m to the area at 9 m/s; b: 16.5 m at 10 m/s, out of it after 23.5 m.
    found = {
        name: float(RULES[name](moment((20.0, 9.0, 0.0), (20.0, 10.0, 0.0))).danger[0])
        for name in ("time_to_collision", "encroachment")
    }
    np.testing.assert_allclose(found["time_to_collision"], 9.0 / 16.5, rtol=0.02)
    np.testing.assert_allclose(found["encroachment"], 5.0 - (16.5 / 9 - 23.5 / 10), rtol=0.02)


def test_who_gives_way_more_easily_is_warned() -> None:
    """Of two at a conflict the one who is farther off or slower, of two who follow the follower."""
    for one, other, warned in (
        ((25.0, 9.0, 0.0), (20.0, 9.0, 0.0), "a"),
        ((20.0, 9.0, 0.0), (25.0, 9.0, 0.0), "b"),
    ):
        seen = moment(one, other)
        found = hatn_rule(seen)
        assert seen.scene.ids[found.first[0]] == warned
    following = row(20.0, 12.0)
    scene = following.scene
    found = hatn_rule(following)
    assert [scene.ids[v] for v in found.first.tolist()] == ["rear"]


# ---------------------------------------------------------------------------------------------
# Intervals

SCENE = scene_of(0.0, {"b": (0.0, 0.0, 0.0, 1.0), "a": (9.0, 0.0, 0.0, 1.0)})


def edges_of(
    dangers: Sequence[float], egos: frozenset[str] | None = None, kind: int = 0
) -> list[Alert]:
    """Edges told of a pair, whose danger is told every 0.1 s and 0 in the end."""
    state, told = AlertState(), []
    for frame, danger in enumerate([*dangers, *[0.0] * 40]):
        scene = scene_of(0.1 * frame, {"b": (0.0, 0.0, 0.0, 1.0), "a": (9.0, 0.0, 0.0, 1.0)})
        found = PairDangers(np.array([0]), np.array([1]), np.array([danger]), np.array([kind]))
        state, edges = alert(state, scene, found, SETTINGS, egos)
        told += edges
    assert not state.open
    return told


def test_an_alert_begins_peaks_and_ends() -> None:
    on, end = SETTINGS.alert_onset, SETTINGS.alert_end
    told = edges_of([0.5 * end, on, 0.9, end, end - 0.01, 0.0])
    assert [one.edge for one in told] == ["onset", "peak", "end"]
    assert [round(one.time_s, 1) for one in told] == [0.1, 0.2, 1.1]  # for a second at least
    assert [one.severity for one in told] == pytest.approx([on, 0.9, 0.9])
    assert {(one.alert_id, one.ego_id, one.other_id) for one in told} == {("a00001", "b", "a")}
    assert told[1].reason == WHY
    longer = edges_of([on, *[end] * 15])
    assert round(longer[-1].time_s, 1) == 1.5


def test_danger_that_comes_back_soon_is_the_same_alert() -> None:
    back = [0.9, *[0.0] * 29, 0.9]
    late = [0.9, *[0.0] * 30, 0.9]
    assert [one.edge for one in edges_of(back)] == ["onset", "peak", "end"]
    assert [one.edge for one in edges_of(late)] == ["onset", "peak", "end"] * 2


def test_who_touches_or_did_is_past_warning() -> None:
    """The one behind runs into the other after 1 s, stands in it for another, and comes free."""
    state, onsets = AlertState(), list[float]()
    for frame in range(100):
        away_m = 9.0 if frame < 10 else 3.0 if frame < 20 else 9.0
        ids = {"b": (0.0, 0.0, 0.0, 1.0), "a": (away_m, 0.0, 0.0, 1.0)}
        danger = 0.9 if frame in (8, 12, 15) or frame >= 60 else 0.0
        found = PairDangers(np.array([0]), np.array([1]), np.array([danger]))
        state, edges = alert(state, scene_of(0.1 * frame, ids), found, SETTINGS, None)
        onsets += [round(one.time_s, 1) for one in edges if one.edge == "onset"]
    assert onsets == [0.8, 7.0]  # 5 s after they touched last, at 1.9 s


def test_an_alert_goes_on_over_the_contact_it_warned_of() -> None:
    state, ends = AlertState(), list[float]()
    for frame in range(60):
        ids = {"b": (0.0, 0.0, 0.0, 1.0), "a": (3.0 if frame >= 10 else 9.0, 0.0, 0.0, 1.0)}
        danger = 0.9 if 8 <= frame < 30 else 0.0
        found = PairDangers(np.array([0]), np.array([1]), np.array([danger]))
        state, edges = alert(state, scene_of(0.1 * frame, ids), found, SETTINGS, None)
        ends += [round(one.time_s, 1) for one in edges if one.edge == "end"]
    assert ends == [2.9]


def test_dangers_are_looked_at_as_often_as_in_calibration() -> None:
    state, looked = AlertState(), list[float]()
    nothing = PairDangers(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    for frame in range(9):
        if state.looks(0.1 * frame):
            looked.append(round(0.1 * frame, 1))
            state, _ = alert(state, scene_of(0.1 * frame, {}), nothing, SETTINGS, None)
    assert looked == [0.0, 0.2, 0.4, 0.6, 0.8]


def test_egos_choose_whose_alerts_are_told_and_who_is_ego() -> None:
    assert edges_of([0.9], frozenset()) == []
    assert edges_of([0.9], frozenset({"else"})) == []
    assert {one.ego_id for one in edges_of([0.9], frozenset({"a"}))} == {"a"}


def test_a_deviation_names_who_deviates() -> None:
    told = edges_of([0.9], frozenset({"a"}), DEVIATION)
    assert {one.type for one in told} == {"DEVIATION"}
    assert told[0].reason == f"b was to give way; {WHY}"


def test_live_alerts_are_those_found_afterwards_in_the_trace() -> None:
    rng = np.random.default_rng(5)
    dangers = np.where(rng.random(3000) < 0.12, rng.random(3000), 0.0).tolist()
    told = edges_of(dangers)
    recorder = DangerRecorder()
    for frame, danger in enumerate(dangers):
        if danger > 0.0:
            found = PairDangers(np.array([0]), np.array([1]), np.array([danger]))
            recorder.add(0.1 * frame, SCENE.ids, found)
    intervals = alerts_at(recorder.trace(), SETTINGS.alert_onset)
    assert len(intervals) > 20
    onset, end = ([one.time_s for one in told if one.edge == edge] for edge in ("onset", "end"))
    np.testing.assert_allclose(onset, [one.onset_s for one in intervals])
    np.testing.assert_allclose(end, [one.end_s for one in intervals])


def test_predictions_are_kept_for_a_second() -> None:
    recent, named = Recent(), {}
    for frame in range(30):
        prediction = moment((20.0, 9.0, 0.0), (20.0, 9.0, 0.0)).prediction if not frame else None
        named[frame] = prediction or object()
        earlier = recent.earlier(0.1 * frame)
        assert earlier is (named[frame - 10] if frame >= 10 else None)
        recent = recent.with_newest(0.1 * frame, named[frame])  # type: ignore[arg-type]
    assert len(recent.kept) == 11


# ---------------------------------------------------------------------------------------------
# Settings


def test_settings_are_read_and_what_is_not_named_stays(tmp_path: Path) -> None:
    file = tmp_path / "assist.toml"
    file.write_text('alert_onset = 0.5\ncool_down_s = 3\ndanger_network = "mine.json"\n')
    mine = tmp_path / "mine.json"
    mine.write_text("{}")
    assert read_assist_settings(file) == AssistSettings(
        alert_onset=0.5, cool_down_s=3.0, danger_network=str(mine)
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("alert_onset_mps2 = 9", "unknown key 'alert_onset_mps2'; did you mean 'alert_onset'"),
        ("alert_onset = 25", "alert_onset: expected 0.001 to 1, without a unit, found 25"),
        ("cool_down_s = nan", "cool_down_s: expected 0 to 60 s, found nan"),
        ("least_s = 1000", "least_s: expected 0 to 10 s, found 1000"),
        ("confident = '4'", "confident: expected a number, found '4'"),
        ("confident = true", "confident: expected a number, found True"),
        ("alert_onset = 0.001", "alert_end = 0.2232 (default) is above alert_onset = 0.001;"),
        ("danger_network = '.'", "danger_network: expected a file, found a folder at"),
        ("danger_network = 3", "danger_network: expected the name of a file, found 3"),
        ("danger_network = 'no.json'", "danger_network: expected a file, found none at"),
        ("end_after_s = 5", "end_after_s = 5 is above cool_down_s = 2 (default)"),
        ("confident = ", "not valid TOML"),
    ],
)
def test_wrong_settings_are_told_of(tmp_path: Path, text: str, told: str) -> None:
    file = tmp_path / "assist.toml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        read_assist_settings(file)
    assert told in str(error.value)
    assert str(error.value).startswith(str(file))
