"""Lanes drawn from tracks: along known ways, whatever the order, and never from the tested ones."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import crossing_lanes

from hatn_sim.cli import main
from hatn_sim.config import Scenario, load_tracks
from hatn_sim.datatypes import ConflictType, FloatArray, Gate, Kind, Lane
from hatn_sim.errors import InputError
from hatn_sim.geometry import arc_length_m, resample, tangent_rad
from hatn_sim.log import read_run
from hatn_sim.recordings.each import each_recording
from hatn_sim.recordings.lanelet2.writer import write_lanelet2
from hatn_sim.recordings.track_lines.clusters import mean_paths
from hatn_sim.recordings.track_lines.lanes import PREFIX, lanes_from_tracks
from hatn_sim.recordings.track_lines.paths import (
    DrivenTrack,
    driven_path,
    path_through,
    smoothed,
)
from hatn_sim.recordings.track_lines.source import other_recordings, with_track_lines
from hatn_sim.recordings.track_lines.web import Near, Web
from hatn_sim.road import Road
from hatn_sim.traffic import open_traffic

CUT_M = 14.0
"""Radius at which drivers turn left; the map has 8 m there: 2.5 m between them."""


def left_turn(radius_m: float = CUT_M) -> FloatArray:
    """From west to north on an arc."""
    t = np.linspace(0.0, np.pi / 2, 61)
    arc = [(-radius_m + radius_m * np.sin(a), radius_m - radius_m * np.cos(a)) for a in t]
    return np.array([(-70.23, 0.0), *arc, (0.0, 69.31)])


WAYS = {
    "west_east": np.array([(-70.37, 0.0), (69.81, 0.0)]),
    "south_north": np.array([(0.0, -69.42), (0.0, 70.69)]),
    "west_north": left_turn(),
}


def track(
    name: str, way: FloatArray, offset_m: float = 0.0, recording: str = "000", kind: Kind = Kind.CAR
) -> DrivenTrack:
    """Somebody at 8.3 m/s who keeps a little to the left of a way, waiting 2 s in its middle."""
    xy_m = resample(way, 0.83)
    yaw_rad = tangent_rad(xy_m)
    xy_m = xy_m + offset_m * np.column_stack((-np.sin(yaw_rad), np.cos(yaw_rad)))
    half = len(xy_m) // 2
    stay = [*range(half), *[half] * 20, *range(half, len(xy_m))]
    return DrivenTrack(recording, name, kind, xy_m[stay], yaw_rad[stay])


def traffic(vehicles: int = 12, seed: int = 3) -> list[DrivenTrack]:
    """So many vehicles on each way, each with its own habit of keeping left or right."""
    offsets_m = np.random.default_rng(seed).normal(0.0, 0.3, (len(WAYS), vehicles))
    offsets_m -= offsets_m.mean(axis=1, keepdims=True)
    return [
        track(f"{name}{k}", way, float(offset_m))
        for (name, way), row in zip(WAYS.items(), offsets_m, strict=True)
        for k, offset_m in enumerate(row)
    ]


def distance_m(xy_m: FloatArray, way: FloatArray) -> FloatArray:
    """From each point to the nearest of a densely drawn way."""
    dense = resample(way, 0.02)
    return np.array([np.linalg.norm(dense - point, axis=1).min() for point in xy_m])


def line_between(
    road: Road, start: tuple[float, float], end: tuple[float, float]
) -> tuple[int, list[Lane]]:
    """The line from the lane that begins at one place to the lane that ends at another."""
    (first,) = (n for n, one in road.lanes.items() if np.hypot(*(one.xy_m[0] - start)) < 3.0)
    for index in road.branches((first,), Kind.CAR):
        lanes = [road.lanes[name] for name in road.lines[index].route]
        if np.hypot(*(lanes[-1].xy_m[-1] - end)) < 3.0:
            return index, lanes
    raise AssertionError(f"no way from {start} to {end}")


W, E, S, N = (-108.0, 0.0), (158.0, 0.0), (0.0, -108.0), (0.0, 158.0)
"""Where the map's outer lanes begin and end."""


def test_ways_that_were_driven_are_found_where_they_were_driven() -> None:
    road = Road(lanes_from_tracks(traffic(), crossing_lanes()))
    for ends, way in zip(((W, E), (S, N), (W, N)), WAYS.values(), strict=True):
        index, _ = line_between(road, *ends)
        xy_m = road.lines[index].xy_m
        inside = np.abs(xy_m).max(axis=1) < 60.0
        assert distance_m(xy_m[inside], way).max() < 0.2
    # The map's own turn is far from there, and gone.
    _, map_lanes = line_between(Road(crossing_lanes()), W, N)
    assert distance_m(map_lanes[1].xy_m, WAYS["west_north"]).max() > 2.0


def test_lines_have_no_kinks() -> None:
    road = Road(lanes_from_tracks(traffic(), crossing_lanes()))
    for ends in ((W, E), (S, N), (W, N)):
        index, _ = line_between(road, *ends)
        yaw_rad = tangent_rad(road.lines[index].xy_m)
        # The sharpest bend that was driven has a curvature of 1 / 14 m, a step is 0.5 m.
        assert np.abs(np.diff(yaw_rad)).max() < 2.0 * 0.5 / CUT_M


def test_the_map_tells_gates_junctions_limits_and_turns() -> None:
    road = Road(lanes_from_tracks(traffic(), crossing_lanes()))
    for ends, turn in (((W, E), 0), ((W, N), 1), ((S, N), 0)):
        _, lanes = line_between(road, *ends)
        inside = [lane for lane in lanes if lane.is_connection]
        assert [lane.turn for lane in inside] == [turn]
        assert all(lane.speed_limit_mps == 13.9 and lane.width_m == 3.2 for lane in lanes)
        gates = [lane for lane in lanes if lane.gate is not Gate.NONE]
        assert [lane.gate for lane in gates] == ([Gate.STOP_LINE] if ends[0] == W else [])
        for lane in gates:
            assert lane.xy_m[-1][0] == pytest.approx(-8.0, abs=0.05)
            assert lanes[lanes.index(lane) + 1].is_connection


def test_ways_from_the_same_lane_are_one_until_they_part() -> None:
    road = Road(lanes_from_tracks(traffic(), crossing_lanes()))
    straight, left = line_between(road, W, E)[0], line_between(road, W, N)[0]
    one, other = road.lines[straight].xy_m, road.lines[left].xy_m
    shared = int(np.argmax(~np.isclose(one[: len(other)], other[: len(one)]).all(axis=1)))
    assert road.lines[straight].route[0] == road.lines[left].route[0]
    # The arc begins at -14 m: 0.3 m beside the straight line is 3 m behind that.
    assert -16.0 < one[shared][0] < -11.0
    assert road.conflicts(straight, left) == ()


def test_conflicts_are_where_the_driven_ways_meet() -> None:
    road = Road(lanes_from_tracks(traffic(), crossing_lanes()))
    east, north, left = (line_between(road, *ends)[0] for ends in ((W, E), (S, N), (W, N)))
    (cross,) = road.conflicts(east, north)
    assert cross.type is ConflictType.CROSS
    at = road.lines[east].xy_m[round(cross.point_s_m[0] / 0.5)]
    assert np.hypot(*at) < 0.5
    (merge,) = road.conflicts(left, north)
    assert merge.type is ConflictType.MERGE
    # The arc is 1.8 m beside the way north where 14 (1 - cos a) = 1.8, at y = 14 (1 - sin a).
    y_m = 14.0 * (1.0 - np.sin(np.arccos(1.0 - 1.8 / 14.0)))
    at = road.lines[north].xy_m[round(merge.entry_s_m[1] / 0.5)]
    assert at[1] == pytest.approx(y_m, abs=1.5)


def test_who_merges_behind_the_map_s_junction_still_merges() -> None:
    late = [track(f"late{k}", left_turn(20.0), 0.05 * k) for k in range(-3, 4)]
    tracks = [one for one in traffic() if not one.name.startswith("west_north")]
    road = Road(lanes_from_tracks([*tracks, *late], crossing_lanes()))
    north, left = line_between(road, S, N)[0], line_between(road, W, N)[0]
    (merge,) = road.conflicts(left, north)
    assert merge.type is ConflictType.MERGE
    y_m = 20.0 * (1.0 - np.sin(np.arccos(1.0 - 1.8 / 20.0)))
    assert y_m > 8.0  # where the map's junction ends
    at = road.lines[north].xy_m[round(merge.entry_s_m[1] / 0.5)]
    assert at[1] == pytest.approx(y_m, abs=1.5)


def test_lanes_where_nobody_drove_stay() -> None:
    tracks = [one for one in traffic() if one.name.startswith("west_east")]
    drawn = lanes_from_tracks(tracks, crossing_lanes())
    road, original = Road(drawn), Road(crossing_lanes())
    for ends in ((W, N), (S, N)):
        xy_m = road.lines[line_between(road, *ends)[0]].xy_m
        there = original.lines[line_between(original, *ends)[0]].xy_m
        assert distance_m(xy_m, there).max() < 0.5  # bent to where it parts from who drove
    ends_at = {tuple(np.rint(lane.xy_m[-1])) for lane in drawn if not lane.successors}
    assert ends_at == {E, N}


def test_lanes_for_others_stay_as_they_are() -> None:
    path = Lane(
        "path", np.array([(-20.0, 5.0), (20.0, 5.0)]), 1.5, 1.4, (), frozenset({Kind.PEDESTRIAN})
    )
    assert lanes_from_tracks(traffic(), [*crossing_lanes(), path])[-1].xy_m is path.xy_m


def test_too_few_draw_nothing() -> None:
    lanes = crossing_lanes()
    assert lanes_from_tracks(traffic(1), lanes) == lanes
    assert lanes_from_tracks([], lanes) == lanes


def described(lanes: Sequence[Lane]) -> list[tuple[object, ...]]:
    return [
        (one.id, one.successors, one.gate, one.turn, one.is_connection, one.kinds) for one in lanes
    ]


def test_the_order_of_tracks_is_without_effect() -> None:
    tracks = traffic()
    drawn = lanes_from_tracks(tracks, crossing_lanes())
    shuffled = [tracks[k] for k in np.random.default_rng(1).permutation(len(tracks))]
    again = lanes_from_tracks(shuffled, crossing_lanes())
    assert described(again) == described(drawn)
    for one, other in zip(drawn, again, strict=True):
        np.testing.assert_array_equal(one.xy_m, other.xy_m)


@pytest.mark.parametrize(("angle_rad", "shift_m"), [(0.7, (300.0, -20.0)), (-2.3, (-5.0, 900.0))])
def test_the_way_the_world_is_turned_is_without_effect(
    angle_rad: float, shift_m: tuple[float, float]
) -> None:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    tracks = traffic()
    turned = [
        replace(one, xy_m=one.xy_m @ turn + np.array(shift_m), yaw_rad=one.yaw_rad + angle_rad)
        for one in tracks
    ]
    drawn = lanes_from_tracks(tracks, crossing_lanes())
    there = lanes_from_tracks(turned, crossing_lanes(angle_rad, shift_m))
    assert described(there) == described(drawn)
    for one, other in zip(drawn, there, strict=True):
        np.testing.assert_allclose(one.xy_m @ turn + np.array(shift_m), other.xy_m, atol=1e-6)


def test_who_does_not_drive_along_draws_nothing() -> None:
    way = WAYS["west_east"]
    assert driven_path(track("walker", way, kind=Kind.PEDESTRIAN)) is None
    assert driven_path(track("cyclist", way, kind=Kind.BICYCLE)) is None
    assert driven_path(track("short", way[:1] + np.array([[0.0, 0.0], [15.0, 0.0]]))) is None
    back = track("reversing", way)
    assert driven_path(replace(back, yaw_rad=back.yaw_rad + np.pi)) is None
    parked = replace(back, xy_m=np.zeros((300, 2)), yaw_rad=np.zeros(300))
    assert driven_path(parked) is None
    path = driven_path(back)
    assert path is not None and path.length_m == pytest.approx(140.0, abs=1.0)


def test_parts_of_ways_and_oddities_make_no_way_of_their_own() -> None:
    tracks = traffic()
    late = [replace(one, xy_m=one.xy_m[80:], yaw_rad=one.yaw_rad[80:]) for one in tracks[:4]]
    odd = track("odd", np.array([(-70.0, 0.0), (-20.0, 0.0), (-20.0, 40.0)]))
    paths = [path for one in (*tracks, *late, odd) if (path := driven_path(one)) is not None]
    assert sorted(path.vehicles for path in mean_paths(paths)) == [12, 12, 12]


def test_smoothing_takes_ripples_and_leaves_bends() -> None:
    x = np.arange(60.0)
    bend = np.column_stack((x, 0.02 * x**2))
    np.testing.assert_allclose(smoothed(bend, 12.0), bend, atol=1e-6)
    ripples = np.column_stack((x, 0.2 * np.cos(2.0 * np.pi * x / 4.0)))
    assert np.abs(smoothed(ripples, 12.0)[15:-15, 1]).max() < 0.002
    half = np.column_stack((x, np.cos(2.0 * np.pi * x / 12.0)))
    np.testing.assert_allclose(smoothed(half, 12.0)[24:36, 1], half[24:36, 1] / 2.0, atol=0.02)


def test_a_web_is_a_fork_where_paths_part_and_a_merge_where_they_join() -> None:
    near = Near(0.4, np.deg2rad(3.0))
    around = np.array([(0, 0), (30, 0), (40, 5), (60, 5), (70, 0), (100, 0)], dtype=np.float64)
    web = Web()
    web.lay(path_through(np.array([(0.0, 0.0), (100.0, 0.0)])), near)
    web.lay(path_through(smoothed(resample(around, 1.0), 20.0)), near)
    strands = web.strands()
    assert len(strands) == 4  # before, either way, behind
    lengths = sorted(float(arc_length_m(web.xy_m[strand])[-1]) for strand in strands)
    assert lengths[-1] == pytest.approx(lengths[-2], abs=2.5)
    count = len(web.ahead)
    web.lay(path_through(smoothed(resample(around, 1.0), 20.0)), near)
    assert len(web.ahead) == count  # nothing new


# -- recordings -------------------------------------------------------------------------------


def write_recording(folder: Path, name: str, tracks: Sequence[DrivenTrack]) -> None:
    header = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"
    with (folder / f"vehicle_tracks_{name}.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(header.split(","))
        for number, one in enumerate(tracks):
            velocity_mps = np.gradient(one.xy_m, 0.1, axis=0)
            columns = np.column_stack((one.xy_m, velocity_mps, one.yaw_rad))
            for frame, numbers in enumerate(columns.tolist(), start=1 + 10 * number):
                texts = (f"{value:.3f}" for value in numbers)
                rows.writerow((number + 1, frame, 100 * frame, "car", *texts, 4.5, 1.8))


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Seven recordings of a crossing; the first one's drivers keep 1.2 m to the right."""
    write_lanelet2(tmp_path / "map.osm", crossing_lanes())
    for k in range(7):
        tracks = traffic(5, seed=k)
        if k == 0:
            tracks = [track(one.name, way, -1.2) for one in tracks[:5] for way in WAYS.values()]
        write_recording(tmp_path, f"{k:03d}", tracks)
    return tmp_path


def scene(site: Path, *recordings: str) -> Scenario:
    return load_tracks([str(site / "vehicle_tracks_*.csv")], site / "map.osm", recordings)


def hash_of(scenario: Scenario) -> str:
    assert scenario.recorded is not None and scenario.recorded.drawn is not None
    return scenario.recorded.drawn.sha256


def test_a_recording_has_no_part_in_its_own_lines(site: Path) -> None:
    every = [f"{k:03d}" for k in range(7)]
    for name in ("000", "003"):
        others = [other for other in every if other != name]
        asked = with_track_lines(scene(site, name), every, "tracks")
        assert asked.recorded is not None and asked.recorded.drawn is not None
        assert asked.recorded.drawn.recordings == tuple(others)
        left_out = with_track_lines(scene(site, name), others, "tracks")
        assert hash_of(asked) == hash_of(left_out)
    with_it = hash_of(with_track_lines(scene(site, "003"), every))
    own = site / "vehicle_tracks_000.csv"
    own.rename(site / "away.txt")
    assert hash_of(with_track_lines(scene(site, "003"), every)) != with_it
    head = (site / "away.txt").read_text().partition("\n")[0]
    own.write_text(f"{head}\nno,numbers\n")  # what is in the tested file is not even read
    assert hash_of(with_track_lines(scene(site, "000"), every[1:])) == hash_of(
        with_track_lines(scene(site, "000"), every)
    )


def test_recordings_one_by_one_have_lines_of_the_other_groups(site: Path) -> None:
    by_name = each_recording(scene(site), "auto")
    assert list(by_name) == [f"{k:03d}" for k in range(7)]
    scenes = list(by_name.values())
    for one in scenes:
        assert one.recorded is not None and one.recorded.drawn is not None
        (own,) = one.recorded.recordings
        assert own not in one.recorded.drawn.recordings
        # Its files alone say what its lines are drawn from.
        alone = replace(one.recorded, drawn=None)
        again = with_track_lines(replace(one, recorded=alone), other_recordings(one), "auto")
        assert hash_of(again) == one.recorded.drawn.sha256
        assert one.recorded.drawn.vehicles == 15 * len(one.recorded.drawn.recordings)
    # 000 and 005, 001 and 006 are of one group each.
    assert hash_of(scenes[0]) == hash_of(scenes[5])
    assert len({hash_of(one) for one in scenes}) == 5
    for name, one in each_recording(scene(site), "lanes").items():
        assert one.recorded is not None and one.recorded.drawn is None
        assert [path.name for path in one.recorded.tracks] == [f"vehicle_tracks_{name}.csv"]


def test_auto_keeps_the_map_where_too_few_drove_and_says_so(site: Path) -> None:
    kept = with_track_lines(scene(site, "000"), ["001", "002"])
    assert kept.recorded is not None and kept.recorded.drawn is None
    notices = " ".join(open_traffic(kept).notices)
    assert "along the lanes of the map" in notices and "30 vehicles in 2 other" in notices
    told = with_track_lines(scene(site, "000"), ["001", "002"], "tracks")
    simulator = open_traffic(told)
    assert "drawn from 30 vehicles of 2 other recordings" in " ".join(simulator.notices)
    assert all(name.startswith(PREFIX) for name in simulator.road.lanes)


def test_what_cannot_be_drawn_from_is_told(site: Path) -> None:
    with pytest.raises(InputError, match=r"found 0 vehicles in 0 other recordings .*--recordings"):
        with_track_lines(scene(site), ["000"], "tracks")
    plain = Scenario("x", site)
    assert with_track_lines(plain, ["000"]) is plain
    with pytest.raises(InputError, match="for recorded tracks"):
        with_track_lines(plain, ["000"], "tracks")


def test_a_run_says_what_its_lines_follow(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = site / "run"
    words = ["run", "--tracks", str(site / "vehicle_tracks_*.csv"), "--map", str(site / "map.osm")]
    words += ["--recordings", "001", "--duration", "2", "--predictor", "constant_velocity"]
    words += ["--no-picture", "--lines-from", "tracks", "--out", str(out)]
    assert main(words) == 0
    assert "reference lines drawn from 90 vehicles" in capsys.readouterr().err
    header = read_run(out).header
    about = header["settings"]["lines_from"]
    assert about["source"] == "tracks" and about["vehicles"] == 90
    assert about["recordings"] == ["000", "002", "003", "004", "005", "006"]
    assert "--lines-from tracks" in header["command"]
