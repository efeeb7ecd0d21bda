"""Labels against answers worked out by hand on straight roads at constant speeds."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from hatn_sim.labels import (
    Trajectories,
    crossing_frame,
    goal_m,
    samples,
    slot_label,
    trajectories_from_rows,
)

FRAMES = 200
CONFLICT = np.array([0.0, 0.0])


def straight(
    start_m: float,
    speed_mps: float,
    direction: tuple[float, float] = (1.0, 0.0),
    wait_frames: int = 0,
    first: int = 0,
    last: int = FRAMES - 1,
) -> tuple[np.ndarray, np.ndarray]:
    """(frames, positions) of a vehicle on a line through the conflict at the origin."""
    frames = np.arange(first, last + 1)
    along = start_m + speed_mps * 0.1 * np.maximum(frames - wait_frames, 0)
    return frames, along[:, None] * np.array(direction)


def trajectories(*tracks: tuple[np.ndarray, np.ndarray]) -> Trajectories:
    vehicle = np.concatenate([np.full(len(f), v) for v, (f, _) in enumerate(tracks)])
    frame = np.concatenate([f for f, _ in tracks])
    xy_m = np.concatenate([xy for _, xy in tracks])
    ids = tuple(f"v{v}" for v in range(len(tracks)))
    return trajectories_from_rows(ids, vehicle, frame, xy_m, FRAMES)


def label(
    tracks: Trajectories,
    to_conflict_m: list[float],
    focus: list[bool] | None = None,
    ego_to_conflict_m: list[float] | None = None,
    frame: int = 0,
) -> int:
    """Label of vehicle 0 among all others, whose conflicts are all at the origin."""
    nodes = len(to_conflict_m)
    ego_m = ego_to_conflict_m or [to_conflict_m[0]] * nodes
    result = slot_label(
        tracks,
        ego=np.array([0]),
        frame=np.array([frame]),
        node=np.arange(nodes)[None],
        focus_mask=np.array([focus or [True] * nodes]),
        ego_to_conflict_m=np.array([ego_m]),
        rear_to_conflict_m=np.array([to_conflict_m]),
        conflict_xy_m=np.broadcast_to(CONFLICT, (1, nodes, 2)),
    )
    assert result.shape == (1,)
    return int(result[0])


NORTH = (0.0, 1.0)


# --- trajectories, goals, samples


def test_travelled_leaves_out_what_happened_out_of_view() -> None:
    frames, xy_m = straight(0.0, 10.0)
    seen = (frames < 10) | (frames >= 20)
    tracks = trajectories((frames[seen], xy_m[seen]))
    xy_at, valid = tracks.xy_at(0, np.arange(FRAMES))
    assert valid.tolist() == seen.tolist()
    np.testing.assert_array_equal(xy_at, np.where(seen[:, None], xy_m, 0.0))
    travelled_m = tracks.travelled_at(0, np.array([0, 9, 15, 20, 25]))
    assert travelled_m == pytest.approx([0.0, 9.0, 9.0, 9.0, 14.0])
    assert tracks.seen_until(0, np.array([0, 9, 15, 20])).tolist() == [9, 9, 14, FRAMES - 1]


def test_goal_is_the_distance_of_three_seconds_and_masked_where_the_track_ends() -> None:
    tracks = trajectories(straight(0.0, 7.0), straight(0.0, 5.0, last=50))
    value, mask = goal_m(tracks, np.array([0, 0, 0, 1, 1]), np.array([3, 169, 170, 20, 21]))
    assert mask.tolist() == [True, True, False, True, False]
    assert value == pytest.approx([21.0, 21.0, 0.0, 15.0, 0.0])


def test_goal_of_a_standing_vehicle_is_zero() -> None:
    value, mask = goal_m(trajectories(straight(3.0, 0.0)), np.array([0]), np.array([0]))
    assert mask.all() and value[0] == 0.0


def test_goal_follows_the_path_round_a_bend() -> None:
    frames = np.arange(FRAMES)
    along = frames * 1.0
    bend = np.stack([np.minimum(along, 20.0), np.maximum(along - 20.0, 0.0)], axis=1)
    value, _ = goal_m(trajectories((frames, bend)), np.array([0]), np.array([0]))
    assert value[0] == pytest.approx(30.0)


def test_samples_have_eleven_frames_behind_and_thirty_ahead() -> None:
    tracks = trajectories(straight(0.0, 1.0, first=3, last=60), straight(0.0, 1.0, last=40))
    vehicle, frame = samples(tracks)
    # Vehicle 0: 3 + 10 <= t <= 60 - 30; vehicle 1: 10 <= t <= 10.
    assert list(zip(vehicle.tolist(), frame.tolist(), strict=True)) == [
        (1, 10),
        (0, 15),
        (0, 20),
        (0, 25),
        (0, 30),
    ]


def test_samples_of_cases_have_ten_frames_behind() -> None:
    # A case of 40 frames, its present on a multiple of five; another that came a frame later.
    tracks = trajectories(
        straight(0.0, 1.0, first=1, last=40), straight(0.0, 1.0, first=2, last=40)
    )
    vehicle, frame = samples(tracks, history_frames=10)
    assert list(zip(vehicle.tolist(), frame.tolist(), strict=True)) == [(0, 10)]
    assert [len(index) for index in samples(tracks)] == [0, 0]


def test_samples_need_an_unbroken_view() -> None:
    frames, xy_m = straight(0.0, 1.0)
    seen = frames != 100
    _, frame = samples(trajectories((frames[seen], xy_m[seen])))
    assert frame.tolist() == [*range(10, 70, 5), *range(115, 170, 5)]


def test_look_ups_agree_with_an_array_of_vehicles_and_frames() -> None:
    rng = np.random.default_rng(4)
    count = 7
    seen = rng.random((count, FRAMES)) < np.linspace(0.0, 1.0, count)[:, None]
    xy_m = np.cumsum(rng.random((count, FRAMES, 2)), axis=1) * seen[..., None]
    vehicle, frame = np.nonzero(seen)
    order = rng.permutation(len(vehicle))
    vehicle, frame = vehicle[order], frame[order]
    ids = tuple(f"v{v}" for v in range(count))
    tracks = trajectories_from_rows(ids, vehicle, frame, xy_m[vehicle, frame], FRAMES)

    travelled_m = np.zeros((count, FRAMES))
    until = np.zeros((count, FRAMES), dtype=np.int64)
    for v in range(count):
        for f in range(1, FRAMES):
            both = seen[v, f - 1] and seen[v, f]
            step_m = np.linalg.norm(xy_m[v, f] - xy_m[v, f - 1]) if both else 0.0
            travelled_m[v, f] = travelled_m[v, f - 1] + step_m
        for f in range(FRAMES):
            unseen = np.flatnonzero(~seen[v, f:])
            until[v, f] = f + (unseen[0] if len(unseen) else FRAMES - f) - 1
    every_vehicle, every_frame = np.arange(count)[:, None], np.arange(FRAMES)
    found_xy_m, mask = tracks.xy_at(every_vehicle, every_frame)
    np.testing.assert_array_equal(mask, seen)
    np.testing.assert_array_equal(found_xy_m, xy_m)
    np.testing.assert_allclose(
        tracks.travelled_at(every_vehicle, every_frame), travelled_m, atol=1e-12
    )
    np.testing.assert_array_equal(tracks.seen_until(every_vehicle, every_frame), until)
    outside = np.array([-FRAMES, -1, FRAMES, 2 * FRAMES])
    assert not tracks.xy_at(every_vehicle, outside)[1].any()
    assert not tracks.seen(every_vehicle, outside, outside).any()
    assert not tracks.xy_at(-1, every_frame)[1].any()


def test_memory_grows_with_what_was_seen() -> None:
    """Half an hour of vehicles that are there for a minute each: as an array it is 130 MB."""
    count, frames, each = 200, 18_000, 600
    first = np.random.default_rng(2).integers(0, frames - each, count)
    vehicle = np.repeat(np.arange(count), each)
    frame = (first[:, None] + np.arange(each)).ravel()
    xy_m = np.stack([frame, vehicle], axis=1).astype(float)
    ids = tuple(str(v) for v in range(count))
    tracemalloc.start()
    try:
        tracks = trajectories_from_rows(ids, vehicle, frame, xy_m, frames)
        sampled, at = samples(tracks)
        goal, known = goal_m(tracks, sampled, at)
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(sampled) == count * 112  # every fifth of 560 frames
    assert known.all() and goal == pytest.approx(30.0)
    assert peak_bytes < 20e6


def test_an_empty_run_has_no_samples() -> None:
    nobody = np.zeros(0, dtype=np.int64)
    tracks = trajectories_from_rows((), nobody, nobody, np.zeros((0, 2)), 0)
    assert [len(index) for index in samples(tracks)] == [0, 0]


# --- crossings


def crossing(
    tracks: Trajectories, distance_m: float, frame: int = 0, limit: int = 50, vehicle: int = 0
) -> int:
    found = crossing_frame(
        tracks,
        np.array([vehicle]),
        np.array([frame]),
        np.array([distance_m]),
        CONFLICT[None],
        limit,
    )
    return int(found[0])


def test_a_crossing_is_the_first_frame_past_the_distance() -> None:
    tracks = trajectories(straight(-20.5, 10.0))
    assert crossing(tracks, 20.5) == 21
    assert crossing(tracks, 15.5, frame=5) == 21


def test_no_crossing_beyond_the_limit() -> None:
    tracks = trajectories(straight(-20.5, 10.0))
    assert crossing(tracks, 20.5, limit=21) == 21
    assert crossing(tracks, 20.5, limit=20) == -1


def test_who_takes_another_way_never_crosses() -> None:
    frames = np.arange(FRAMES)
    along = frames * 1.0
    turns_off = np.stack([np.minimum(along, 10.0) - 20.5, np.maximum(along - 10.0, 0.0)], axis=1)
    assert crossing(trajectories((frames, turns_off)), 20.5) == -1


def test_who_leaves_view_before_the_conflict_never_crosses() -> None:
    assert crossing(trajectories(straight(-20.5, 10.0, last=20)), 20.5) == -1
    assert crossing(trajectories(straight(-20.5, 10.0, last=21)), 20.5) == 21


def test_who_comes_back_into_view_past_the_conflict_has_not_been_seen_crossing() -> None:
    frames, xy_m = straight(-20.5, 10.0)
    seen = (frames < 15) | (frames > 18)
    assert crossing(trajectories((frames[seen], xy_m[seen])), 20.5) == -1


def test_who_is_just_past_the_conflict_crosses_now() -> None:
    tracks = trajectories(straight(1.5, 10.0))
    assert crossing(tracks, -1.5) == 0


def test_nobody_crosses_where_there_is_no_vehicle_or_no_frame() -> None:
    tracks = trajectories(straight(-20.5, 10.0, first=5))
    assert crossing(tracks, 20.5, vehicle=-1) == -1
    assert crossing(tracks, 20.5, frame=4) == -1
    assert crossing(tracks, 20.5, frame=FRAMES) == -1


def test_crossings_agree_with_a_search_frame_by_frame() -> None:
    rng = np.random.default_rng(7)
    step_m = rng.random((6, FRAMES)) * (rng.random((6, FRAMES)) < 0.6)
    along_m = np.cumsum(step_m, axis=1) - 30.0
    tracks = trajectories(
        *((np.arange(FRAMES), along[:, None] * np.array([1.0, 0.0])) for along in along_m)
    )
    vehicle, frame = rng.integers(0, 6, 300), rng.integers(0, FRAMES, 300)
    distance_m = -along_m[vehicle, frame] + rng.normal(0.0, 2.5, 300)
    found = crossing_frame(tracks, vehicle, frame, distance_m, np.zeros((300, 2)), 50)
    for v, t, d, answer in zip(vehicle, frame, distance_m, found, strict=True):
        expected = -1
        driven = 0.0
        for f in range(t, min(t + 51, FRAMES)):
            driven += abs(along_m[v, f] - along_m[v, f - 1]) if f > t else 0.0
            if driven >= d:
                expected = f if abs(along_m[v, f]) <= 4.0 else -1
                break
        assert answer == expected
    assert min((found >= 0).sum(), (found < 0).sum()) > 50


# --- slots


def test_another_first_is_yield() -> None:
    tracks = trajectories(straight(-30.5, 10.0), straight(-20.5, 10.0, NORTH))
    assert label(tracks, [30.5, 20.5]) == 0


def test_the_ego_first_passes_before_the_next_of_the_group() -> None:
    tracks = trajectories(
        straight(-20.5, 10.0), straight(-45.5, 10.0, NORTH), straight(-35.5, 10.0, NORTH)
    )
    assert label(tracks, [20.5, 45.5, 35.5]) == 2


def test_the_same_frame_is_yield() -> None:
    tracks = trajectories(straight(-20.5, 10.0), straight(-20.5, 10.0, NORTH))
    assert label(tracks, [20.5, 20.5]) == 0


def test_nobody_within_five_seconds_is_masked() -> None:
    tracks = trajectories(straight(-51.5, 10.0), straight(-60.5, 10.0, NORTH))
    assert label(tracks, [51.5, 60.5]) == -1
    assert label(tracks, [49.5, 58.5], frame=2) == 1


def test_another_after_five_seconds_does_not_make_the_ego_yield() -> None:
    tracks = trajectories(straight(-60.5, 10.0), straight(-51.5, 10.0, NORTH))
    assert label(tracks, [60.5, 51.5]) == -1


def test_nobody_left_to_follow_is_masked() -> None:
    tracks = trajectories(straight(-20.5, 10.0), straight(-20.5, 0.0, NORTH))
    assert label(tracks, [20.5, 20.5]) == -1


def test_followers_count_for_ten_seconds() -> None:
    # The ego crosses at frame 21, the other at 121 or at 122.
    just = trajectories(straight(-20.5, 10.0), straight(-20.5, 10.0, NORTH, wait_frames=100))
    late = trajectories(straight(-20.5, 10.0), straight(-20.5, 10.0, NORTH, wait_frames=101))
    assert label(just, [20.5, 20.5]) == 1
    assert label(late, [20.5, 20.5]) == -1


def test_who_took_another_way_is_not_the_one_passed_before() -> None:
    frames = np.arange(FRAMES)
    along = frames * 1.0
    turned = np.stack([np.maximum(along - 10.0, 0.0), np.minimum(along, 10.0) - 25.5], axis=1)
    tracks = trajectories(straight(-20.5, 10.0), (frames, turned), straight(-40.5, 10.0, NORTH))
    assert label(tracks, [20.5, 25.5, 40.5]) == 2
    assert label(tracks, [20.5, 25.5]) == -1


def test_who_vanishes_before_the_conflict_neither_goes_first_nor_follows() -> None:
    gone_first = straight(-15.5, 10.0, NORTH, last=10)
    assert label(trajectories(straight(-20.5, 10.0), gone_first), [20.5, 15.5]) == -1
    follower = straight(-30.5, 10.0, NORTH)
    tracks = trajectories(straight(-20.5, 10.0), gone_first, follower)
    assert label(tracks, [20.5, 15.5, 30.5]) == 2


def test_vehicles_outside_the_focus_do_not_count() -> None:
    tracks = trajectories(
        straight(-20.5, 10.0), straight(-10.5, 10.0, NORTH), straight(-30.5, 10.0, NORTH)
    )
    assert label(tracks, [20.5, 10.5, 30.5]) == 0
    assert label(tracks, [20.5, 10.5, 30.5], focus=[True, False, True]) == 2
    assert label(tracks, [20.5, 10.5, 30.5], focus=[True, False, False]) == -1


def test_who_goes_first_is_decided_at_the_conflict_of_the_two() -> None:
    # The conflict with 1 is the focus, that with 2 is 3.5 m farther along the ego's line. The ego,
    # at 1 m/s, is at the focus at frame 25 and at the other one at frame 60; 2 crosses at 31: after
    # the ego crossed the focus, and still before the ego at their own conflict.
    tracks = trajectories(
        straight(-2.45, 1.0), straight(-40.5, 10.0, NORTH), straight(-30.5, 10.0, NORTH)
    )
    assert label(tracks, [2.45, 40.5, 30.5], ego_to_conflict_m=[0.0, 2.45, 5.95]) == 0
    assert label(tracks, [2.45, 40.5, 30.5], ego_to_conflict_m=[0.0, 2.45, 2.95]) == 2


def test_who_still_occupies_the_conflict_goes_first() -> None:
    other_past = trajectories(straight(-10.5, 10.0), straight(1.5, 1.0, NORTH))
    assert label(other_past, [10.5, -1.5]) == 0
    ego_past = trajectories(straight(1.5, 10.0), straight(-10.5, 10.0, NORTH))
    assert label(ego_past, [-1.5, 10.5]) == 1


def test_graphs_in_one_batch_and_none_at_all() -> None:
    tracks = trajectories(straight(-30.5, 10.0), straight(-20.5, 10.0, NORTH))

    def both(rows: int) -> np.ndarray:
        return slot_label(
            tracks,
            ego=np.array([0, 1])[:rows],
            frame=np.zeros(rows, dtype=np.int64),
            node=np.array([[0, 1, -1], [1, 0, -1]])[:rows],
            focus_mask=np.array([[True, True, False]] * 2)[:rows],
            ego_to_conflict_m=np.array([[30.5] * 3, [20.5] * 3])[:rows],
            rear_to_conflict_m=np.array([[30.5, 20.5, 0.0], [20.5, 30.5, 0.0]])[:rows],
            conflict_xy_m=np.zeros((rows, 3, 2)),
        )

    assert both(2).tolist() == [0, 1]
    assert both(0).tolist() == []
