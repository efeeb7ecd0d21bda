"""What is said, advised and driven is one thing: every suggestion of real runs of two scenes."""

from __future__ import annotations

import re
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hatn_sim.assist.choice import Why
from hatn_sim.assist.profile import COMFORT_ACCELERATION_MPS2, COMFORT_BRAKING_MPS2
from hatn_sim.assist.words import CALM, HARD_LATER, HARD_NOW, braking, words
from hatn_sim.commands.chosen_predictors import load_predictors
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Suggestion
from hatn_sim.loop import Adviser, begin, tick, warm_up
from hatn_sim.traffic import open_traffic

Said = tuple[float, Suggestion]
"""The ego's speed, and what it is told."""


@pytest.fixture(scope="module", params=["intersection5", "roundabout8"])
def told(request: pytest.FixtureRequest) -> list[Said]:
    scenario = load_scenario(request.param, None, "assertive")
    adviser = Adviser(load_predictors(("hatn",), None, "none", True, frozenset())[0])
    said: list[Said] = []
    with closing(open_traffic(scenario)) as simulator:
        frame = warm_up(simulator, simulator.reset(321), 200)
        state = begin(adviser, simulator.road)
        for _ in range(80):
            state, advice = tick(adviser, state, frame)
            speed = dict(zip(frame.scene.ids, frame.scene.speed_mps.tolist(), strict=True))
            said += [(speed[one.ego_id], one) for one in advice.suggestions]
            frame = simulator.step()
    assert {one.action for _, one in said} >= {"yield", "pass", "abstain"}
    return said


def active(told: list[Said]) -> list[Said]:
    return [said for said in told if said[1].action != "abstain"]


def test_profiles_are_as_smooth_as_is_said(told: list[Said]) -> None:
    for speed, one in active(told):
        gained = np.diff([speed, *one.profile_mps]) / 0.1
        assert gained.max() < COMFORT_ACCELERATION_MPS2 + 0.05
        hard = -gained.min() > 1.15 * COMFORT_BRAKING_MPS2 + 0.05
        slow = max(speed, *one.profile_mps) <= 2.0
        assert not hard or ("top" if slow else "rake hard") in one.text
        if one.text.startswith("Brake hard"):
            assert -gained[:15].min() > 1.15 * COMFORT_BRAKING_MPS2 - 0.05


def test_the_time_in_the_text_is_that_of_the_profile(told: list[Said]) -> None:
    timed = 0
    for _, one in active(told):
        found = re.search(r"in (\d+\.\d) s", one.text)
        if found is None:
            continue
        timed += 1
        assert one.target_time_s is not None
        assert float(found[1]) == pytest.approx(one.target_time_s, abs=0.051)
        # Later, somebody may come whom nobody has predicted.
        assert one.target_time_s <= 3.0
    assert timed >= 4


def test_the_speed_advised_is_on_the_profile(told: list[Said]) -> None:
    for _, one in active(told):
        until_s = 5.0 if one.target_time_s is None else min(one.target_time_s, 5.0)
        ticks = max(round(until_s / 0.1), 1)
        # A tick more or less, where the time is half-way between two.
        means = [np.mean(one.profile_mps[: max(n, 1)]) for n in (ticks - 1, ticks, ticks + 1)]
        assert min(abs(one.advised_speed_mps - mean) for mean in means) < 1e-3


def test_everything_has_a_reason(told: list[Said]) -> None:
    for_telling = {one.name.lower() for one in (Why.LIKELY, Why.LIKELY_UNSAFE, Why.HELD)}
    for _, one in told:
        assert (one.reason in for_telling) == (one.action != "abstain")
        if one.reason == "likely":
            assert one.margin >= 0.0


def test_hard_braking_is_told_by_when_it_comes() -> None:
    profiles = np.full((4, 50), 10.0)
    profiles[1, 5:] -= 0.32  # 3.2 m/s2 for a tick
    profiles[2, 30:] -= 0.5
    profiles[3, 2:] -= 0.36
    speed = np.full(4, 10.0)
    assert braking(speed, profiles) == [CALM, CALM, HARD_LATER, HARD_NOW]


ALARM = {"Brake hard": 2, "Stop": 2, "be ready to brake hard": 1, "be ready to stop": 1}


def alarm(speed_mps: float, lost_mps2: list[float], **said: object) -> int:
    """How alarming the words are for one who brakes so hard, tick by tick, until it stands."""
    profile = np.maximum(speed_mps - 0.1 * np.cumsum(lost_mps2), 0.0)[None]
    (brakes,) = braking(np.array([speed_mps]), profile)
    text = words("the car ahead", brakes=brakes, **said)  # type: ignore[arg-type]
    return max((level for begins, level in ALARM.items() if begins in text), default=0)


@given(
    speed=st.floats(0.5, 20.0),
    lost=st.lists(st.floats(0.0, 8.0), min_size=50, max_size=50),
    action=st.sampled_from(["yield", "pass"]),
    feasible=st.tuples(st.booleans(), st.booleans()),
    target=st.sampled_from([None, 0.0, 3.0]),
)
def test_more_braking_never_gets_calmer_words(
    speed: float,
    lost: list[float],
    action: str,
    feasible: tuple[bool, bool],
    target: float | None,
) -> None:
    # More: the same braking, but for its hardest tick, which is harder, or sooner; whatever is
    # said to be feasible.
    hardest = int(np.argmax(lost))
    # Nobody brakes who stands already.
    room = speed - 0.1 * sum(lost[:hardest])
    steps = [float(x) for x in np.linspace(0.0, 10.0, 21) if 0.1 * x <= room]
    levels = [
        alarm(
            speed,
            [*lost[:hardest], more, *[0.0] * (49 - hardest)],
            action=action,
            feasible=feasible[more > 3.0],
            target_s=target,
        )
        for more in steps
    ]
    assert levels == sorted(levels)


@pytest.mark.parametrize("feasible", [True, False])
@pytest.mark.parametrize("action", ["yield", "pass"])
@pytest.mark.parametrize(
    ("speed", "hard", "ready"), [(2.0, "Stop", "stop"), (2.1, "Brake hard", "brake hard")]
)
def test_one_limit_decides_how_braking_is_told(
    feasible: bool, action: str, speed: float, hard: str, ready: str
) -> None:
    for at in (0, 14, 15, 49):
        for lost_mps2 in (3.44, 3.46):
            profile = np.full((1, 50), speed)
            profile[0, at:] -= 0.1 * lost_mps2
            (brakes,) = braking(np.array([speed]), profile)
            text = words("the car ahead", action, brakes=brakes, feasible=feasible)
            is_hard, soon = lost_mps2 > 3.45, at < 15  # 1.15 times 3 m/s2; 1.5 s
            assert text.startswith(hard) == (is_hard and soon), text
            assert (f"be ready to {ready}" in text) == (is_hard and not soon), text
