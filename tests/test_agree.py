"""Suggestions beside alerts of the same egos."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import scene_of

from hatn_sim.assist.agree import agreeing
from hatn_sim.assist.alert import AlertState, Warned, alert
from hatn_sim.assist.moment import PairDangers
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import Suggestion

SETTINGS = AssistSettings()
SCENE = scene_of(0.0, {"a": (0.0, 0.0, 0.0, 5.0), "b": (20.0, 8.0, 0.0, 5.0)})
SAID = Suggestion(
    ego_id="a",
    time_s=0.0,
    action="pass",
    slot_id="b",
    probability=0.9,
    margin=0.8,
    target_time_s=2.0,
    advised_speed_mps=6.0,
    feasible=True,
    text="Pass before the silver car ahead",
    profile_mps=(5.1, 5.2),
)


@pytest.mark.parametrize(
    ("said", "action", "silent"),
    [
        ("pass", "brake", True),
        ("yield", "clear", True),
        ("yield", "brake", False),
        ("pass", "clear", False),
        ("abstain", "brake", False),
    ],
)
def test_an_alert_wins(said: str, action: str, silent: bool) -> None:
    one = replace(SAID, action=said)
    (left,) = agreeing((one,), {("a", action)}, SCENE)
    if silent:
        assert (left.action, left.profile_mps, left.reason) == ("abstain", (), "alerted")
        assert left.text.startswith("Watch the")
    else:
        assert left == one
    assert agreeing((one,), {("b", action)}, SCENE) == (one,)


def test_what_alerts_tell_holds_for_as_long_as_they_do() -> None:
    state, told = AlertState(), list[float]()
    for frame in range(0, 30, 2):
        danger = 0.9 if frame in (2, 12) else 0.0  # the second goes on where the first left off
        found = PairDangers(np.array([0]), np.array([1]), np.array([danger]))
        scene = replace(SCENE, time_s=0.1 * frame)
        state, _ = alert(
            state, scene, found, SETTINGS, None, lambda *_: Warned(0, 1, "brake", 9.0, 2.0, "Brake")
        )
        if state.told(scene.time_s, SETTINGS):
            assert state.told(scene.time_s, SETTINGS) == {("a", "brake")}
            told.append(round(scene.time_s, 1))
    # For a second at least from 0.2 s on; and at 1.2 s again, until 0.5 s without danger.
    assert told == [0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6]
