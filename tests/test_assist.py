"""Suggestions, alerts and the times they rest on, against answers by hand."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of

from hatn_sim.assist.alert import AlertState, alert
from hatn_sim.assist.risk import arrival_s, encounters, required_deceleration_mps2
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
