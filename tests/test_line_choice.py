"""The learned choice of lines: features without a hand, labels by hindsight, weights in files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import scene_of
from test_lines import APPROACH, LEFT, RIGHT, drive, fork_lanes, three_cars

from hatn_sim.datatypes import FloatArray, Frame, Lane, Scene, Truth
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.habits import fresh_habits
from hatn_sim.learn.line_choice import choice_figures, fit_line_choice, right_candidates
from hatn_sim.learn.line_samples import ChoiceSamples, choice_samples, joined
from hatn_sim.learn.strays import CUT_M, strayed
from hatn_sim.line_choice import (
    HAND_MADE_CHOICE,
    LineChoice,
    load_line_choice,
    save_line_choice,
    shipped_line_choice,
)
from hatn_sim.line_features import FEATURES, HAND_MADE, Evidence, collect_evidence, line_features
from hatn_sim.lines import empty_lines, follow_lines
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road
from hatn_sim.tracks import empty_tracks, extend


def frame_of(scene: Scene) -> Frame:
    return Frame(scene, Truth(routes=(None,) * len(scene.ids)), done=False)


def look(road: Road, scenes: Sequence[Scene]) -> list[tuple[Evidence, FloatArray]]:
    """Evidence and features after every scene."""
    state, tracks = empty_lines(), empty_tracks()
    seen: list[tuple[Evidence, FloatArray]] = []
    for scene in scenes:
        tracks = extend(tracks, scene)
        state, _ = follow_lines(state, road, tracks, scene)
        evidence = collect_evidence(state, road, scene, state.habits or fresh_habits(road))
        seen.append((evidence, line_features(evidence, state, road, tracks, scene)))
    return seen


def mirrored(lane: Lane) -> Lane:
    return replace(lane, xy_m=lane.xy_m * np.array([1.0, -1.0]), turn=-lane.turn)


def test_a_mirrored_world_has_the_same_features() -> None:
    scenes = three_cars(0.0, (0.0, 0.0), [0, 1, 2])
    scenes = [replace(one, blinker=np.array([1, 0, -1])) for one in scenes]
    turned = [
        replace(
            one,
            xy_m=one.xy_m * np.array([1.0, -1.0]),
            yaw_rad=-one.yaw_rad,
            blinker=-one.blinker,
        )
        for one in scenes
    ]
    here = look(Road(fork_lanes()), scenes)
    there = look(Road([mirrored(lane) for lane in fork_lanes()]), turned)
    assert len(here) > 50
    for (one, features), (two, others) in zip(here, there, strict=True):
        # Lines come in another order where left is right.
        for vehicle in range(3):
            mine, yours = (
                f[e.alike][e.vehicle == vehicle] for e, f in ((one, features), (two, others))
            )
            assert mine.shape == yours.shape
            np.testing.assert_allclose(mine.sum(axis=0), yours.sum(axis=0), atol=1e-6)
            np.testing.assert_allclose(mine.max(axis=0), yours.max(axis=0), atol=1e-6)


def test_shares_of_lines_sum_to_one_for_every_connection() -> None:
    evidence, _ = look(Road(fork_lanes()), three_cars(0.0, (0.0, 0.0), [0, 1, 2])[:40])[-1]
    pairs = np.stack((evidence.vehicle, evidence.connection), axis=1)
    kinds, row = np.unique(pairs, axis=0, return_inverse=True)
    assert len(kinds) > 5
    np.testing.assert_allclose(np.bincount(row, np.exp(evidence.log_share)), 1.0)


def test_nats_by_hand() -> None:
    features = np.zeros((2, len(FEATURES)))
    features[0, 0], features[1, 5] = np.e - 1.0, 2.0  # the first is read as log(1 + motion) = 1
    linear, hidden = np.zeros(len(FEATURES)), np.zeros((len(FEATURES), 1))
    linear[5], hidden[0], hidden[5] = 0.5, 3.0, -1.0
    choice = LineChoice(linear, hidden, np.array([1.0]), np.array([10.0]))
    # 10 * 4 / (1 + 4), and 0.5 * 2 + 10 * (1 - 2) / (1 + 1)
    np.testing.assert_allclose(choice.nats(features), [8.0, -4.0])
    np.testing.assert_allclose(HAND_MADE_CHOICE.nats(features), [np.e - 1.0, 0.0])
    assert len(HAND_MADE) == 4


def test_files_and_arrays_give_back_what_they_were_given(tmp_path: Path) -> None:
    path = tmp_path / "choice.json"
    shipped = shipped_line_choice()
    save_line_choice(path, shipped, {"made_by": "a test"})
    features = np.random.default_rng(3).uniform(0.0, 2.0, (20, len(FEATURES)))
    for other in (load_line_choice(path), LineChoice.from_arrays(shipped.to_arrays())):
        np.testing.assert_allclose(other.nats(features), shipped.nats(features), atol=1e-4)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["card"] == {"made_by": "a test"}
    for wrong, said in (
        ({**content, "format": 0}, "format 1"),
        ({**content, "features": ["a"]}, "other features"),
        ({**content, "weights": {}}, "no linear, hidden"),
        ({**content, "weights": {**content["weights"], "bias": [1.0]}}, "bias must be"),
        ({**content, "weights": {**content["weights"], "out": ["x"]}}, "no numbers"),
        ([], "format 1"),
    ):
        path.write_text(json.dumps(wrong), encoding="utf-8")
        with pytest.raises(InputError, match=said):
            load_line_choice(path)
    path.write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read"):
        load_line_choice(path)


def test_predictors_with_the_same_choice_share_what_they_see() -> None:
    road = Road(fork_lanes())
    assert begin(road) is begin(road, shipped_line_choice())
    assert begin(road) is not begin(road, HAND_MADE_CHOICE)
    scene = three_cars(0.0, (0.0, 0.0), [0, 1, 2])[0]
    one, two = begin(road), begin(road, HAND_MADE_CHOICE)
    after = perceive(one, scene, None), perceive(two, scene, None)
    assert perceive(one, scene, None) is after[0], "another choice in between does not disturb"
    assert perceive(two, scene, None) is after[1]


def test_hindsight_finds_what_was_driven() -> None:
    poses = drive([*APPROACH, *LEFT[1:], (12.0, 40.0)])
    frames = [frame_of(scene_of(0.1 * k, {"v": pose})) for k, pose in enumerate(poses)]
    road = Road(fork_lanes())
    samples = choice_samples(road, frames, every_frames=1)
    assert len(samples) > 100
    right, tells = right_candidates(samples)
    rights = np.bincount(samples.case, right)
    assert (rights[0], tells[0]) == (3, True), "three ways from this lane, none from the one beside"
    # 5 m/s: the way of the turn shows from some 13 m before the fork until the others are gone.
    seen = np.flatnonzero(tells & (rights == 1))
    assert 20 < len(seen) < 80
    for case in seen.tolist():
        rows = samples.case == case
        assert samples.fit_m[rows & right] < 0.4


def two_ways(count: int, seed: int) -> ChoiceSamples:
    """Cases of two candidates; the one with less `braking` is driven, the rest is noise."""
    random = np.random.default_rng(seed)
    features = np.zeros((2 * count, len(FEATURES)))
    features[:, 4:] = 0.3 * random.normal(size=(2 * count, len(FEATURES) - 4))
    braking = features[:, FEATURES.index("braking")].reshape(count, 2)
    braking += np.where(random.uniform(size=(count, 1)) < 0.5, [0.0, 1.0], [1.0, 0.0])
    features[:, FEATURES.index("braking")] = braking.ravel()
    fit_m = np.where(braking == braking.min(axis=1, keepdims=True), 0.1, 3.0).ravel()
    return ChoiceSamples(
        features=features,
        fit_m=fit_m,
        log_share=np.zeros(2 * count),
        chosen=np.zeros(2 * count, dtype=np.bool_),
        case=np.repeat(np.arange(count), 2),
        probability=np.ones(count),
    )


def test_figures_by_hand() -> None:
    """Two cases: the right one with 3/4, and the wrong one with 3/4."""
    samples = two_ways(2, 1)
    features = np.zeros((4, len(FEATURES)))
    features[:, 1] = [0.0, np.log(3.0), np.log(3.0), 0.0]
    samples = replace(samples, features=features, fit_m=np.array([0.1, 3.0, 0.1, 3.0]))
    figures = choice_figures(samples, HAND_MADE_CHOICE)
    assert figures.n == 2
    assert figures.wrong == 0.5
    assert figures.log_loss == pytest.approx(-0.5 * (np.log(0.75) + np.log(0.25)), abs=1e-4)
    assert figures.ece == pytest.approx(0.25)


def test_a_fit_learns_what_drivers_do_and_nothing_else() -> None:
    learned = fit_line_choice(two_ways(400, 2))
    held_back = choice_figures(two_ways(400, 3), learned)
    assert choice_figures(two_ways(400, 3), HAND_MADE_CHOICE).wrong > 0.3
    assert held_back.wrong < 0.05
    assert held_back.log_loss < 0.2
    again = fit_line_choice(two_ways(400, 2))
    for name, values in learned.to_arrays().items():
        np.testing.assert_array_equal(again.to_arrays()[name], values)


def test_one_place_moves_the_choice_that_it_starts_from_a_little() -> None:
    shipped = shipped_line_choice()
    moved = fit_line_choice(two_ways(200, 4), shipped)
    afresh = fit_line_choice(two_ways(200, 4))
    before, after = (choice_figures(two_ways(400, 5), one) for one in (shipped, moved))
    assert after.log_loss < before.log_loss
    away, far = (np.linalg.norm(one.linear - shipped.linear) for one in (moved, afresh))
    assert away < far


def test_where_nothing_parts_there_is_nothing_to_learn() -> None:
    samples = two_ways(3, 6)
    with pytest.raises(HatnSimError, match="give more traffic"):
        fit_line_choice(replace(samples, fit_m=np.full(6, 0.1)))


def test_joined_cases_stay_apart() -> None:
    samples = joined([two_ways(2, 7), two_ways(3, 8)])
    assert samples.case.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert len(samples) == 5


def test_straying_vehicles_drive_smooth_ways_beside_the_old_ones() -> None:
    poses = drive([*APPROACH, *RIGHT[1:], (8.0, -60.0)])
    frames = [frame_of(scene_of(0.1 * k, {"v": one}, blinker=-1)) for k, one in enumerate(poses)]
    out = strayed(frames, 3, signalling=0.0)
    assert len(out) == len(frames)
    xy = np.array([frame.scene.xy_m[0] for frame in out])
    old = np.array([frame.scene.xy_m[0] for frame in frames])
    shift_m = np.linalg.norm(xy - old, axis=1)
    assert 0.1 < shift_m.max() < CUT_M + 2.0
    assert np.abs(np.diff(shift_m)).max() < 0.2
    yaw = np.array([frame.scene.yaw_rad[0] for frame in out])
    step = xy[2:] - xy[:-2]
    ahead = np.arctan2(step[:, 1], step[:, 0])
    was = np.array([frame.scene.yaw_rad[0] for frame in frames])[1:-1]
    old_step = old[2:] - old[:-2]
    slip = (
        np.arctan2(old_step[:, 1], old_step[:, 0]) - was
    )  # a car's box does not point where it goes
    off = np.angle(np.exp(1j * (ahead - yaw[1:-1] - slip)))
    assert np.abs(off).max() < 0.12
    assert all(frame.scene.blinker[0] == 0 for frame in out)
    assert all(
        frame.scene.time_s == before.scene.time_s for frame, before in zip(out, frames, strict=True)
    )
    again = strayed(frames, 3, signalling=1.0)
    np.testing.assert_array_equal(again[-1].scene.xy_m, out[-1].scene.xy_m)
    assert again[0].scene.blinker[0] == -1
