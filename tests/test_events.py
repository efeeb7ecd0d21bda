"""Collisions and evasive braking in hand-made traffic, against what was put there."""

from __future__ import annotations

import numpy as np
import pytest

from hatn_sim.datatypes import DT_S, Frame, Truth
from hatn_sim.score.close_passes import close_passes, shown_passes
from hatn_sim.score.driven import Driven, driven_by, driven_from_arrays
from hatn_sim.score.events import brakings, collisions, severe_events, vehicle_hours

NORTH = np.pi / 2
FRAMES = 80


def straight(speed_mps: np.ndarray, x_m: float, y_m: float, yaw_rad: float) -> np.ndarray:
    """[T, 4] x, y, yaw, speed of a vehicle that keeps its heading."""
    travelled = np.append(0.0, np.cumsum(DT_S * speed_mps[1:]))
    ones = np.ones(len(speed_mps))
    x, y = x_m + travelled * np.cos(yaw_rad), y_m + travelled * np.sin(yaw_rad)
    return np.column_stack([x, y, yaw_rad * ones, speed_mps])


def standing(x_m: float, y_m: float) -> np.ndarray:
    """[T, 4] of a vehicle that stands."""
    return straight(np.zeros(FRAMES), x_m, y_m, 0.0)


def speeds(*stretches: tuple[int, float], start_mps: float = 12.0) -> np.ndarray:
    """Speeds from stretches of (frames, acceleration in m/s2)."""
    steps = np.concatenate([np.full(frames, gain) for frames, gain in stretches]) * DT_S
    return np.maximum(start_mps + np.append(0.0, np.cumsum(steps)), 0.0)


def drive(*ways: tuple[str, np.ndarray], **more: object) -> Driven:
    """Vehicles of 5 m x 2 m: id -> [T, 4] x, y, yaw, speed; NaN out of view."""
    states = np.stack([way for _, way in ways], axis=1)
    count = states.shape[1]
    return driven_from_arrays(
        ids=[name for name, _ in ways],
        time_s=100.0 + DT_S * np.arange(len(states)),
        valid=np.isfinite(states[..., 0]),
        xy_m=states[..., :2],
        yaw_rad=states[..., 2],
        speed_mps=states[..., 3],
        size_m=np.tile([5.0, 2.0], (count, 1)),
        **more,  # type: ignore[arg-type]
    )


# ---------------------------------------------------------------------------------------------
# T1


def test_a_pair_that_touches_again_is_one_collision_at_its_first_contact() -> None:
    contacts = [(101.0, "b", "a"), (101.1, "a", "b"), (102.5, "b", "a"), (101.4, "a", "c")]
    driven = drive(
        ("a", standing(0, 0)), ("b", standing(0, 9)), ("c", standing(0, -9)), collisions=contacts
    )
    found = collisions(driven)
    assert [(e.tier, e.first_id, e.second_id) for e in found] == [
        ("T1", "a", "b"),
        ("T1", "a", "c"),
    ]
    assert [e.start_s for e in found] == pytest.approx([101.0, 101.4])


def test_a_pair_that_touched_before_anybody_looked_is_left_out() -> None:
    driven = drive(
        ("a", standing(0, 0)),
        ("b", standing(0, 9)),
        collisions=[(100.0, "a", "b"), (100.1, "a", "b")],
    )
    assert collisions(driven) == []


# ---------------------------------------------------------------------------------------------
# T2: when


@pytest.mark.parametrize(
    ("profile", "expected"),
    [
        # Gently, then beyond comfort from frame 20 on, then hard: it starts at frame 20.
        (speeds((10, 0.0), (10, -2.0), (5, -3.5), (8, -5.0), (30, 0.0)), (20, False)),
        # Exactly the limit over exactly three frames.
        (speeds((10, 0.0), (3, -4.5), (50, 0.0)), (10, False)),
        # Two frames of it do not last: brief.
        (speeds((10, 0.0), (2, -4.5), (51, 0.0)), (10, True)),
        # A vehicle that creeps and stands a tick later.
        (speeds((10, 0.0), (1, -9.0), (52, 0.0), start_mps=0.9), (10, True)),
        # Beyond comfort, but never hard.
        (speeds((10, 0.0), (20, -4.4), (33, 0.0)), None),
    ],
)
def test_when_a_braking_starts(profile: np.ndarray, expected: tuple[int, bool] | None) -> None:
    found = brakings(drive(("a", straight(profile, 0.0, -60.0, 0.0))))
    assert [(one.start_frame, one.brief) for one in found] == (
        [] if expected is None else [expected]
    )


def test_pauses_under_a_second_are_one_braking_and_longer_ones_two() -> None:
    for pause, count in ((8, 1), (12, 2)):
        profile = speeds((5, 0.0), (4, -6.0), (pause, 0.0), (4, -6.0), (20, 0.0), start_mps=20.0)
        assert len(brakings(drive(("a", straight(profile, 0.0, -60.0, 0.0))))) == count


@pytest.mark.parametrize(
    ("frames", "start_mps", "brief"),
    [
        (1, 12.0, True),  # 0.9 m/s lost: 3 m/s2 on the mean of three frames
        (2, 12.0, False),  # 1.8 m/s lost: 6 m/s2
        (2, 1.34, True),  # stands after 1.34 m/s
        (2, 1.36, False),  # stands after 1.36 m/s
    ],
)
def test_emergency_braking_is_judged_by_the_speed_lost(
    frames: int, start_mps: float, brief: bool
) -> None:
    profile = speeds((10, 0.0), (frames, -9.0), (20, 0.0), start_mps=start_mps)
    way = straight(profile, 0.0, -60.0, 0.0)
    for marks in ([(101.1, "a")], []):
        (told,) = brakings(drive(("a", way), emergency_braking=marks))
        assert (told.start_frame, told.emergency, told.brief) == (10, bool(marks), brief)


def test_who_comes_into_view_or_teleports_has_not_braked() -> None:
    profile = speeds((10, 0.0), (10, -6.0), (20, 0.0))
    hidden = straight(profile, 0.0, -60.0, 0.0)
    hidden[8:21] = np.nan
    assert brakings(drive(("a", hidden))) == []


# ---------------------------------------------------------------------------------------------
# T2: for whom

BRAKES = speeds((20, 0.0), (15, -8.0), (FRAMES, 0.0))[:FRAMES]
ROLLS = np.full(FRAMES, 12.0)


def only_event(*ways: tuple[str, np.ndarray]) -> tuple[str, str | None, float]:
    (event,) = severe_events(drive(*ways))
    assert event.tier == "T2"
    return event.first_id, event.second_id, event.start_s


def test_a_braking_is_for_the_vehicle_that_would_have_been_met() -> None:
    ego = ("ego", straight(BRAKES, -50.0, 0.0, 0.0))  # would be at the origin after 50 / 12 s
    meets = ("north", straight(ROLLS, 0.0, -52.0, NORTH))
    late = (
        "late",
        straight(ROLLS, 15.0, -90.0, NORTH),
    )  # 1.9 s after the ego would have been there
    assert only_event(ego, meets, late) == ("ego", "north", pytest.approx(102.0))
    assert only_event(ego, late) == ("ego", "late", pytest.approx(102.0))


def test_a_braking_for_nobody_within_three_seconds_is_unattributed() -> None:
    ego = ("ego", straight(BRAKES, -50.0, 0.0, 0.0))
    far = ("far", straight(ROLLS, 0.0, -110.0, NORTH))  # 5 s after the ego would have been there
    beside = ("beside", straight(ROLLS, -50.0, 3.5, 0.0))
    assert only_event(ego, far, beside) == ("ego", None, pytest.approx(102.0))


def test_nobody_brakes_for_a_follower_but_for_a_leader() -> None:
    ego = straight(BRAKES, -50.0, 0.0, 0.0)
    behind = straight(ROLLS, -80.0, 0.0, 0.0)
    found = severe_events(drive(("ego", ego), ("follower", behind)))
    assert [(e.first_id, e.second_id) for e in found] == [("ego", None)]
    # The one behind has to brake for the ego when that has braked for nobody.
    late = np.concatenate([ROLLS[:8], np.minimum(BRAKES, 12.0)])[:FRAMES]
    chain = severe_events(drive(("ego", ego), ("follower", straight(late, -65.0, 0.0, 0.0))))
    assert [(e.first_id, e.second_id) for e in chain] == [("ego", None), ("ego", "follower")]


def test_who_starts_from_a_standstill_is_a_foe() -> None:
    ego = ("ego", straight(BRAKES, -50.0, 0.0, 0.0))
    starts = speeds((15, 0.0), (FRAMES, 2.5), start_mps=0.0)[:FRAMES]
    foe = ("foe", straight(starts, 0.0, -4.6, NORTH))  # at a standstill outside of the ego's way
    assert only_event(ego, foe) == ("ego", "foe", pytest.approx(102.0))


def test_both_brake_for_each_other_once_and_not_for_the_crash_itself() -> None:
    ego = ("ego", straight(BRAKES, -50.0, 0.0, 0.0))
    foe = ("foe", straight(BRAKES, 0.0, -50.0, NORTH))
    assert len(severe_events(drive(ego, foe))) == 1
    crash = [(101.9, "ego", "foe")]
    assert [e.tier for e in severe_events(drive(ego, foe, collisions=crash))] == ["T1"]


# ---------------------------------------------------------------------------------------------
# What is common


def test_a_turned_and_shifted_world_has_the_same_events() -> None:
    ways = [
        ("ego", straight(BRAKES, -50.0, 0.0, 0.0)),
        ("north", straight(ROLLS, 0.0, -52.0, NORTH)),
        ("late", straight(ROLLS, 15.0, -90.0, NORTH)),
    ]
    turn, shift = 2.1, np.array([1e4, -2e4])
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    turned = []
    for name, way in reversed(ways):
        other = way.copy()
        other[:, :2] = way[:, :2] @ rotation + shift
        other[:, 2] += turn
        turned.append((name, other))
    assert severe_events(drive(*ways)) == severe_events(drive(*turned))


def test_frames_and_arrays_give_the_same() -> None:
    way = straight(BRAKES, -50.0, 0.0, 0.0)
    dense = drive(("a", way), ("b", straight(ROLLS, 0.0, -52.0, NORTH)))
    frames = [Frame(scene, Truth(routes=(None, None)), False) for scene in scenes_of(dense)]
    again = driven_by(frames)
    assert severe_events(again) == severe_events(dense)
    assert vehicle_hours(again, 100.0, 101.0) == pytest.approx(2 * 10 * DT_S / 3600.0)


def scenes_of(driven: Driven) -> list:
    from conftest import scene_of

    scenes = []
    for frame, time_s in enumerate(driven.time_s.tolist()):
        rows = np.flatnonzero(driven.frame == frame)
        scenes.append(
            scene_of(
                time_s,
                {
                    driven.ids[driven.vehicle[row]]: (
                        *driven.xy_m[row],
                        driven.yaw_rad[row],
                        driven.speed_mps[row],
                    )
                    for row in rows
                },
            )
        )
    return scenes


# ---------------------------------------------------------------------------------------------
# T3


def test_a_crossing_passed_closely_by_hand() -> None:
    # At 10 m/s either blocks the other's way while its centre is within 2.5 m + 1 m of the origin.
    first = ("b", straight(np.full(FRAMES, 10.0), -20.0, 0.0, 0.0))  # at the origin at 2.0 s
    second = ("a", straight(np.full(FRAMES, 10.0), 0.0, -40.0, NORTH))  # at 4.0 s
    (event,) = close_passes(drive(first, second))
    assert (event.tier, event.first_id, event.second_id) == ("T3", "a", "b")
    # The one is gone at 2.35 s, the other comes at 3.65 s.
    assert event.encroachment_s == pytest.approx(1.3, abs=0.11)
    assert event.start_s == pytest.approx(103.65, abs=0.11)
    far = ("a", straight(np.full(FRAMES, 10.0), 0.0, -60.0, NORTH))
    assert close_passes(drive(first, far)) == []
    # People are shown those under 1.5 s alone: here 1.3 s, and 1.8 s where it comes 5 m later.
    assert shown_passes(drive(first, second)) == [event]
    later = ("a", straight(np.full(FRAMES, 10.0), 0.0, -45.0, NORTH))
    assert len(close_passes(drive(first, later))) == 1
    assert shown_passes(drive(first, later)) == []


def test_followers_and_those_that_pass_beside_pass_nobody_closely() -> None:
    ahead = ("a", straight(np.full(FRAMES, 10.0), -20.0, 0.0, 0.0))
    behind = ("b", straight(np.full(FRAMES, 10.0), -30.0, 0.0, 0.0))
    beside = ("c", straight(np.full(FRAMES, 10.0), -25.0, 3.0, 0.0))
    assert close_passes(drive(ahead, behind, beside)) == []


def test_one_behind_the_other_around_a_tight_turn_is_no_close_pass() -> None:
    radius_m, angle = 7.0, np.linspace(0.0, 1.5 * np.pi, FRAMES)

    def turning(late_m: float) -> np.ndarray:
        at = angle - late_m / radius_m
        x, y = radius_m * np.sin(at), -radius_m * np.cos(at)
        speed = np.full(FRAMES, radius_m * (angle[1] - angle[0]) / DT_S)
        return np.column_stack([x, y, at, speed])

    assert close_passes(drive(("a", turning(0.0)), ("b", turning(6.0)))) == []


def test_a_merge_counts_until_the_two_follow_each_other() -> None:
    # The second comes onto the first one's way at 30 degrees, 2 s later, and then speeds up to it.
    first = straight(np.full(FRAMES, 10.0), -20.0, 0.0, 0.0)  # at the origin at 2 s
    turn = np.deg2rad(30.0)
    second = straight(np.full(FRAMES, 10.0), -40.0 * np.cos(turn), -40.0 * np.sin(turn), turn)
    after = 41  # at the origin at 4 s; from then on only 1.0 s behind
    second[after:] = straight(np.full(FRAMES - after, 10.0), 11.0, 0.0, 0.0)
    (event,) = close_passes(drive(("a", first), ("b", second)))
    # The front corner is on the other's way about 5 m before the centre is: 0.5 s, and the
    # other's rear is gone 0.25 s after its centre.
    assert event.encroachment_s is not None and 0.9 < event.encroachment_s < 1.8
    assert event.start_s < 104.0 + 0.11
