"""Suggestions, alerts and the times they rest on, against answers by hand."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of

from hatn_sim.assist.alert import AlertState, alert
from hatn_sim.assist.risk import arrival_s, encounters, required_deceleration_mps2
from hatn_sim.assist.suggest import SuggestionState, Told, suggest
from hatn_sim.datatypes import Prediction, Scene
from hatn_sim.graph import build_graphs
from hatn_sim.perception import begin, perceive
from hatn_sim.predictors.constant_velocity import extrapolate
from hatn_sim.road import Road

NORTH = np.pi / 2


def moment(
    vehicles: dict[str, tuple[float, float, float, float]], chances: dict[str, list[float]]
) -> tuple[Scene, Prediction]:
    """A scene at the hand-drawn crossing, predicted at constant velocity, with given slots."""
    road = Road(crossing_lanes())
    state = begin(road)
    for frame in range(3):
        state = perceive(state, scene_of(0.1 * frame, vehicles), None)
    scene, graphs = state.seen.scene, build_graphs(road, state.seen)
    probability = np.zeros(graphs.node_mask.shape)
    for e, ego in enumerate(graphs.ego.tolist()):
        given = chances.get(scene.ids[ego], [1.0])
        probability[e, : len(given)] = given
    count = len(scene.ids)
    return scene, Prediction(
        ids=scene.ids,
        xy_m=extrapolate(scene)[:, None],
        mode_probability=np.ones((count, 1)),
        fallback=np.zeros(count, dtype=np.bool_),
        adapted=np.zeros(count, dtype=np.bool_),
        graphs=graphs,
        slot_probability=probability,
    )


TWO = {"ego": (-40.0, 0.0, 0.0, 10.0), "other": (0.0, -20.0, NORTH, 8.0)}


def test_arrival_is_linear_between_frames_and_beyond_them() -> None:
    travelled = np.array([np.arange(1, 31) * 1.0, np.zeros(30)])
    vehicle = np.array([0, 0, 0, 1, 1])
    found = arrival_s(travelled, vehicle, np.array([2.5, 30.0, 45.0, -1.0, 5.0]))
    np.testing.assert_allclose(found, [0.25, 3.0, 4.5, 0.0, 60.0])


def test_encounter_times_by_hand() -> None:
    scene, prediction = moment(TWO, {})
    meeting = encounters(scene, prediction)
    e = prediction.graphs.ego.tolist().index(0)  # type: ignore[union-attr]
    # Half a length and half the other's width: 2.5 m + 1 m to either side of the point.
    np.testing.assert_allclose(meeting.ego_enter_s[e, 1], 3.65, atol=0.02)
    np.testing.assert_allclose(meeting.ego_leave_s[e, 1], 4.35, atol=0.02)
    np.testing.assert_allclose(meeting.other_enter_s[e, 1], 16.5 / 8, atol=0.02)
    np.testing.assert_allclose(meeting.other_leave_s[e, 1], 23.5 / 8, atol=0.02)
    np.testing.assert_allclose(meeting.predicted_encroachment_s()[e, 1], 3.65 - 23.5 / 8, atol=0.03)


@pytest.mark.parametrize(
    ("distance", "speed", "time", "expected"),
    [
        (40.0, 10.0, 5.0, 2.0 * 10.0 / 25.0),  # still rolling at 6 m/s when the other is gone
        (40.0, 10.0, 4.0, 0.0),  # arrives just then
        (40.0, 10.0, 30.0, 100.0 / 80.0),  # has to stop before
        (5.0, 0.0, 9.0, 0.0),  # stands
    ],
)
def test_required_deceleration_by_hand(
    distance: float, speed: float, time: float, expected: float
) -> None:
    found = required_deceleration_mps2(np.array(distance), np.array(speed), np.array(time))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_yield_names_whom_to_let_go_and_when() -> None:
    scene, prediction = moment(TWO, {"ego": [0.9, 0.1], "other": [0.1, 0.9]})
    state, found = suggest(
        SuggestionState(), scene, prediction, encounters(scene, prediction), None
    )
    by_ego = {one.ego_id: one for one in found}
    told = by_ego["ego"]
    assert (told.action, told.slot_id, told.feasible) == ("yield", "other", True)
    assert told.probability == pytest.approx(0.9)
    assert told.margin == pytest.approx(0.8)
    assert told.target_time_s == pytest.approx(23.5 / 8, abs=0.02)
    assert told.text == "Yield to the silver car from the right; go after it in 2.9 s"
    assert by_ego["other"].action == "pass"
    assert by_ego["other"].slot_id == "ego"
    # 23.5 m at 8 m/s take 2.9 s, the ego comes after 3.65 s: no need to speed up.
    assert by_ego["other"].feasible
    assert by_ego["other"].target_time_s == pytest.approx(16.5 / 8, abs=0.02)
    assert by_ego["other"].advised_speed_mps == pytest.approx(8.0, abs=0.05)
    assert {ego: told.slot_id for ego, told in state.told.items()} == {"ego": "ego", "other": "ego"}


def test_a_gap_too_short_to_clear_is_not_feasible() -> None:
    near = {"ego": (-40.0, 0.0, 0.0, 10.0), "other": (0.0, -14.0, NORTH, 8.0)}
    scene, prediction = moment(near, {"ego": [0.1, 0.9]})
    meeting = encounters(scene, prediction)
    _, found = suggest(SuggestionState(), scene, prediction, meeting, frozenset({"ego"}))
    # 43.5 m to be out, 10.5 / 8 s until the other comes: 35 m/s2 would be needed.
    assert (found[0].action, found[0].feasible) == ("pass", False)
    assert found[0].text.endswith("if you can: the gap is tight")


def test_only_the_named_egos_are_advised_and_a_near_tie_abstains() -> None:
    scene, prediction = moment(TWO, {"ego": [0.55, 0.45], "other": [0.2, 0.8]})
    meeting = encounters(scene, prediction)
    _, found = suggest(SuggestionState(), scene, prediction, meeting, frozenset({"ego"}))
    assert [(one.ego_id, one.action) for one in found] == [("ego", "abstain")]
    _, nobody = suggest(SuggestionState(), scene, prediction, meeting, frozenset())
    assert nobody == ()


@pytest.mark.parametrize(
    ("chance", "expected"),
    [
        ([0.55, 0.45], ("pass", "other")),  # another leads by 0.1: the advice stands
        ([0.7, 0.3], ("yield", "other")),  # it leads by 0.4: the advice changes
        ([0.6, 0.4], ("abstain", "other")),  # by 0.2: enough to give up the old, not for the new
    ],
)
def test_advice_stands_until_another_slot_is_clearly_better(
    chance: list[float], expected: tuple[str, str]
) -> None:
    told = SuggestionState({"ego": Told("other", "pass", True)})
    scene, prediction = moment(TWO, {"ego": chance})
    meeting = encounters(scene, prediction)
    _, (found,) = suggest(told, scene, prediction, meeting, frozenset({"ego"}))
    assert (found.action, found.slot_id) == expected


@pytest.mark.parametrize(("margin", "expected"), [(0.2, "abstain"), (0.3, "yield")])
def test_advice_begins_with_a_clear_lead_only(margin: float, expected: str) -> None:
    for before in (SuggestionState(), SuggestionState({"ego": Told("ego", "abstain", True)})):
        scene, prediction = moment(TWO, {"ego": [0.5 + margin / 2, 0.5 - margin / 2]})
        meeting = encounters(scene, prediction)
        _, (found,) = suggest(before, scene, prediction, meeting, frozenset({"ego"}))
        assert found.action == expected


def test_an_alert_is_an_interval_of_a_pair() -> None:
    collision = {"a": (-15.0, 0.0, 0.0, 12.0), "b": (0.0, -15.0, NORTH, 12.0)}
    far_apart = {"a": (-100.0, 0.0, 0.0, 2.0), "b": (0.0, 20.0, NORTH, 12.0)}
    scene, prediction = moment(collision, {})
    state, first = alert(AlertState(), scene, prediction, encounters(scene, prediction), None)
    assert [(one.edge, {one.ego_id, one.other_id}) for one in first] == [("onset", {"a", "b"})]
    # 11.5 m to the area at 12 m/s; the other is gone after 18.5 m: 2 (18.5 - 11.5) / (18.5 / 12)^2.
    assert first[0].severity * 9.0 == pytest.approx(14.0 / (18.5 / 12) ** 2, rel=0.02)
    state, again = alert(state, scene, prediction, encounters(scene, prediction), None)
    assert again == ()
    for time_s in (0.3, 2.0):
        scene, prediction = moment(far_apart, {})
        scene = Scene(**{**scene.__dict__, "time_s": time_s})
        state, edges = alert(state, scene, prediction, encounters(scene, prediction), None)
    assert [one.edge for one in edges] == ["peak", "end"]
    assert {one.alert_id for one in edges} == {first[0].alert_id}
    assert not state.open
