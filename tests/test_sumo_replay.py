"""Recorded traffic inside SUMO, held against SUMO's own record of the same traffic."""

from __future__ import annotations

import io
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import scene_of
from rich.console import Console

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Command, Frame, Kind, Lane, Scene, Truth
from hatn_sim.errors import InputError
from hatn_sim.recordings.sumo_net.export import find_netconvert
from hatn_sim.report.replay_table import replay_scores, replay_table
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_replay.figures import Quantiles
from hatn_sim.simulators.sumo_replay.match import LaneMatcher
from hatn_sim.simulators.sumo_replay.simulator import SumoReplay, open_replay
from hatn_sim.simulators.sumo_replay.take_over import parse_take_over
from hatn_sim.simulators.touching import boxes_touch, touching_pairs, touching_rows_of

WARM_UP_FRAMES = 300


@dataclass(frozen=True, eq=False)
class Played:
    """Frames in memory as a recording."""

    lanes: list[Lane]
    played: list[Frame]
    name: str = "played"
    notices: tuple[str, ...] = ()

    def frames(self) -> Iterator[Frame]:
        return iter(self.played)


@cache
def recorded(scene: str, frames: int = 400) -> tuple[Played, Path]:
    """Some traffic of a scene that ships, and its net."""
    scenario = load_scenario(scene)
    with SumoSimulator(scenario) as simulator:
        simulator.reset(1)
        for _ in range(WARM_UP_FRAMES):
            simulator.step()
        played = [simulator.step() for _ in range(frames)]
        net_path = scenario.config_path.with_name(f"{scene}.net.xml")
        return Played(simulator.lanes, played, scene), net_path


def play(replay: SumoReplay, frames: int = 10_000) -> list[Frame]:
    with replay:
        shown = [replay.reset(1)]
        while not shown[-1].done and len(shown) < min(frames, len(replay.recording.played)):  # type: ignore[attr-defined]
            shown.append(replay.step())
    return shown


def moved(scene: Scene, by_m: tuple[float, float]) -> Scene:
    return replace(scene, xy_m=scene.xy_m + np.array(by_m))


def stays_of(played: list[Frame]) -> dict[str, list[int]]:
    stays: dict[str, list[int]] = {}
    for index, frame in enumerate(played):
        for name in frame.scene.ids:
            stays.setdefault(name, []).append(index)
    return stays


@pytest.mark.parametrize("scene", ["intersection5", "roundabout4_two_lane"])
def test_recorded_vehicles_stay_the_truth_and_sumo_has_them_right(scene: str) -> None:
    recording, net_path = recorded(scene)
    replay = SumoReplay(recording, net_path)
    shown = play(replay)
    for frame, original in zip(shown, recording.played, strict=True):
        assert frame.scene.ids == original.scene.ids
        np.testing.assert_array_equal(frame.scene.xy_m, original.scene.xy_m)
        np.testing.assert_array_equal(frame.scene.yaw_rad, original.scene.yaw_rad)
        np.testing.assert_array_equal(frame.scene.speed_mps, original.scene.speed_mps)
        np.testing.assert_array_equal(frame.scene.signal_closed, original.scene.signal_closed)
        assert frame.truth.routes == original.truth.routes
    fidelity = replay.fidelity
    assert fidelity.n == sum(len(frame.scene.ids) for frame in recording.played)
    assert fidelity.position_m_max is not None and fidelity.position_m_max < 1e-9
    assert fidelity.lane_n == fidelity.n and fidelity.lane_share is not None
    assert fidelity.lane_share > 0.97
    assert (fidelity.outside, fidelity.lost, fidelity.not_placed) == (0, 0, 0)
    assert replay.divergence.vehicles == 0


@pytest.mark.parametrize("scene", ["intersection5", "roundabout4_two_lane", "roundabout8"])
def test_tracks_are_matched_onto_the_lanes_that_were_driven(scene: str) -> None:
    recording, _ = recorded(scene)
    matcher = LaneMatcher(recording.lanes)
    right = count = 0
    for name, frames in stays_of(recording.played).items():
        scenes = [recording.played[index].scene for index in frames]
        rows = [scene.ids.index(name) for scene in scenes]
        xy = np.array([scene.xy_m[row] for scene, row in zip(scenes, rows, strict=True)])
        yaw = np.array([scene.yaw_rad[row] for scene, row in zip(scenes, rows, strict=True)])
        length = scenes[0].size_m[rows[0], 0]
        front = xy + 0.5 * length * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        match = matcher.match(np.array(frames), front, yaw, Kind.CAR)
        assert match is not None and match.breaks == ()
        if np.linalg.norm(front[-1] - front[0]) < 30.0:
            continue
        # SUMO's own edges: those of the lanes that it says are driven.
        known = {
            lane.rpartition("_")[0]
            for index, row in zip(frames, rows, strict=True)
            for lane in recording.played[index].truth.routes[row] or ()
        }
        edges = matcher.edges_from(match, frames[0])
        assert edges is not None
        count += len(edges)
        right += sum(edge in known for edge in edges)
    # A recording may end where ways have only begun to part.
    assert count > 20 and right >= 0.98 * count


def test_a_vehicle_taken_over_drives_on_with_the_traffic() -> None:
    recording, net_path = recorded("intersection5")
    stays = stays_of(recording.played)
    name, frames = next((n, f) for n, f in stays.items() if f[0] > 20 and len(f) > 200)
    at = frames[50]
    replay = SumoReplay(recording, net_path, {name: recording.played[at].scene.time_s})
    shown = play(replay)
    before = shown[at].scene
    for frame, original in zip(shown, recording.played, strict=True):
        others = [other for other in original.scene.ids if other != name]
        assert [other for other in frame.scene.ids if other != name] == others
        if name not in frame.scene.ids or frame.scene.time_s <= before.time_s:
            continue
        row, row_before = frame.scene.ids.index(name), before.ids.index(name)
        step_m = np.linalg.norm(frame.scene.xy_m[row] - before.xy_m[row_before])
        # It moves as fast as it says, and does not jump at the hand-over.
        assert abs(step_m - 0.1 * frame.scene.speed_mps[row]) < 0.05
        assert tuple(frame.scene.size_m[row]) == tuple(before.size_m[row_before])
        assert tuple(frame.scene.colour[row]) == tuple(before.colour[row_before])
        before = frame.scene
    divergence = replay.divergence
    assert divergence.vehicles == 1 and divergence.overlaps == () and divergence.kept == ()
    first, *_ = divergence.at
    assert first.after_s == 1.0 and first.n == 1 and first.median_m < 2.0
    # It drove where it was recorded to go.
    row = shown[at + 1].scene.ids.index(name)
    driven = shown[at + 1].truth.routes[row]
    original = recording.played[at].truth.routes[recording.played[at].scene.ids.index(name)]
    assert driven is not None and original is not None
    assert set(original[-3:]) & set(driven)


def test_a_command_is_obeyed_and_recorded_followers_run_into_it_unless_released() -> None:
    recording, net_path = recorded("intersection5")
    leader, at = _leader_with_follower(recording)
    outcomes: dict[bool, int] = {}
    for react in (False, True):
        time_s = recording.played[at].scene.time_s
        replay = SumoReplay(recording, net_path, {leader: time_s}, time_s if react else None)
        with replay:
            frame = replay.reset(1)
            for _ in range(at):
                frame = replay.step()
            row = frame.scene.ids.index(leader)
            speed_mps = frame.scene.speed_mps[row]
            for _ in range(60):
                frame = replay.step([Command(leader, -6.0)])
                speed_mps = max(speed_mps - 0.6, 0.0)
                row = frame.scene.ids.index(leader)
                assert frame.scene.speed_mps[row] == pytest.approx(speed_mps, abs=1e-6)
        overlaps = replay.divergence.overlaps
        outcomes[react] = len(overlaps)
        if not react:
            assert overlaps[0].driven_id == leader and overlaps[0].other_recorded
    assert outcomes[False] > 0 and outcomes[True] == 0


def _leader_with_follower(recording: Played) -> tuple[str, int]:
    """A moving vehicle with another at most 25 m behind in the same lane, and the frame."""
    for index in range(20, len(recording.played) - 80):
        scene = recording.played[index].scene
        ahead = np.stack([np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)], axis=1)
        for row in range(len(scene.ids)):
            away = scene.xy_m[row] - scene.xy_m
            along = (away * ahead[row]).sum(axis=1)
            across = away[:, 1] * ahead[row, 0] - away[:, 0] * ahead[row, 1]
            turned = np.abs(np.sin(scene.yaw_rad - scene.yaw_rad[row]))
            behind = (along > 5) & (along < 25) & (np.abs(across) < 1) & (turned < 0.1)
            behind &= scene.speed_mps > 5.0
            if behind.any() and scene.speed_mps[row] > 5.0:
                return scene.ids[row], index
    raise AssertionError("no such pair in the recording")


def test_all_released_drive_without_touching() -> None:
    recording, net_path = recorded("roundabout8")
    replay = SumoReplay(recording, net_path, react_from_s=recording.played[100].scene.time_s)
    shown = play(replay)
    divergence = replay.divergence
    assert divergence.vehicles > 5 and divergence.overlaps == () and divergence.kept == ()
    assert all(frame.truth.collisions == () for frame in shown)
    for frame, original in zip(shown[:101], recording.played[:101], strict=True):
        np.testing.assert_array_equal(frame.scene.xy_m, original.scene.xy_m)
    assert len(shown[-1].scene.ids) == len(shown[-1].truth.routes)


def test_the_same_seed_repeats_a_replay() -> None:
    recording, net_path = recorded("tjunction")
    first, second = (
        play(SumoReplay(recording, net_path, react_from_s=35.0), 150) for _ in range(2)
    )
    for one, other in zip(first, second, strict=True):
        assert one.scene.ids == other.scene.ids
        np.testing.assert_array_equal(one.scene.xy_m, other.scene.xy_m)


def test_a_parked_vehicle_and_pedestrians_are_counted_and_in_nobodys_way() -> None:
    recording, net_path = recorded("tjunction")

    def with_others(frame: Frame) -> Frame:
        scene = frame.scene
        added = Scene(
            time_s=scene.time_s,
            ids=(*scene.ids, "parked", "walker"),
            xy_m=np.concatenate([scene.xy_m, [[-30.0, 40.0], [-20.0, 0.0]]]),
            yaw_rad=np.append(scene.yaw_rad, [0.0, 0.0]),
            speed_mps=np.append(scene.speed_mps, [0.0, 0.0]),
            size_m=np.concatenate([scene.size_m, [[4.0, 1.8], [0.5, 0.5]]]),
            kind=np.append(scene.kind, [Kind.CAR, Kind.PEDESTRIAN]),
            colour=np.concatenate([scene.colour, [[0, 0, 0], [0, 0, 0]]]),
            blinker=np.append(scene.blinker, [0, 0]),
            signal_closed=scene.signal_closed,
        )
        return replace(
            frame, scene=added, truth=replace(frame.truth, routes=(*frame.truth.routes, None, None))
        )

    frames = [with_others(frame) for frame in recording.played[:50]]
    replay = SumoReplay(replace(recording, played=frames), net_path)
    shown = play(replay)
    assert shown[-1].scene.ids == frames[-1].scene.ids
    fidelity = replay.fidelity
    assert (fidelity.outside, fidelity.not_placed, fidelity.lost) == (50, 50, 0)
    assert "1 of" in replay.notices[0] and "near no lane" in replay.notices[0]
    assert fidelity.position_m_max is not None and fidelity.position_m_max < 1e-6
    with pytest.raises(InputError, match="'parked' cannot be taken over: the net has no way"):
        play(SumoReplay(replace(recording, played=frames), net_path, {"parked": None}))


def test_who_is_near_no_lane_may_appear_whoever_the_first_edges_are_for(tmp_path: Path) -> None:
    plain = {
        "nod": "<nodes>"
        + "".join(
            f'<node id="{name}" x="{x}" y="{y}"/>'
            for name, x, y in (("a", 0, 0), ("b", 100, 0), ("c", 200, 0), ("d", 100, 100))
        )
        + "</nodes>",
        "edg": '<edges><edge id="0_foot" from="d" to="b" allow="pedestrian"/>'
        '<edge id="1_rail" from="c" to="d" allow="tram"/>'
        '<edge id="x" from="a" to="b"/><edge id="y" from="b" to="c"/></edges>',
    }
    for name, text in plain.items():
        (tmp_path / f"{name}.xml").write_text(text)
    net_path = tmp_path / "path.net.xml"
    words = [find_netconvert(), "-n", tmp_path / "nod.xml", "-e", tmp_path / "edg.xml"]
    subprocess.run([*words, "-o", net_path], check=True, capture_output=True)
    places = {name: (20.0 * k, -1.6) for k, name in enumerate(("one", "two", "three"), 1)}
    places |= {"car": (60.0, 50.0), "bus": (70.0, 60.0)}
    frames = [
        Frame(
            replace(
                scene_of(0.1 * k, {n: (x + k, y, 0.0, 10.0) for n, (x, y) in places.items()}),
                kind=np.array([Kind.CAR, Kind.CAR, Kind.CAR, Kind.CAR, Kind.BUS]),
            ),
            Truth((None,) * 5),
            done=k == 20,
        )
        for k in range(21)
    ]
    replay = SumoReplay(Played([], frames), net_path)
    assert [frame.scene.ids for frame in play(replay)] == [tuple(places)] * 21
    fidelity = replay.fidelity
    assert (fidelity.n, fidelity.outside, fidelity.lost) == (5 * 21, 2 * 21, 0)
    assert fidelity.position_m_max is not None and fidelity.position_m_max < 1e-6


def test_all_of_a_recordings_beginning_are_released_where_they_are() -> None:
    recording, net_path = recorded("roundabout8")
    played = recording.played[50:]  # with some close behind others
    replay = SumoReplay(replace(recording, played=played), net_path, react_from_s=0.0)
    first = play(replay, 2)[0].scene
    row_of = {name: row for row, name in enumerate(first.ids)}
    assert row_of.keys() == set(played[0].scene.ids) and len(row_of) > 5
    rows = [row_of[name] for name in played[0].scene.ids]
    np.testing.assert_allclose(first.xy_m[rows], played[0].scene.xy_m, atol=1e-6)
    assert replay.divergence.held_back == 0


def test_signals_are_shown_as_recorded_where_nobody_heeds_others() -> None:
    recording, net_path = recorded("tjunction", 30)
    gate = recording.lanes[0]
    lanes = [replace(gate, signals={gate.successors[0]: 0})] if gate.successors else []
    turned = [
        replace(f, scene=replace(f.scene, signal_closed=np.array([k % 7 < 3])))
        for k, f in enumerate(recording.played)
    ]
    of_this_net = SumoReplay(replace(recording, played=turned, lanes=recording.lanes), net_path)
    shown = play(of_this_net)
    assert [f.scene.signal_closed.tolist() for f in shown] == [
        f.scene.signal_closed.tolist() for f in turned
    ]
    # The net has no signals: those of another net are not shown, nor where somebody drives.
    for replay in (
        SumoReplay(
            replace(recording, played=turned, lanes=[*recording.lanes[1:], *lanes]), net_path
        ),
        SumoReplay(replace(recording, played=turned), net_path, react_from_s=33.0),
    ):
        assert all(len(frame.scene.signal_closed) == 0 for frame in play(replay))


def test_recordings_one_after_the_other_with_nobody_between() -> None:
    recording, net_path = recorded("tjunction")
    part = recording.played[:40]
    nobody = np.zeros(len(part[-1].scene.ids), dtype=np.bool_)
    scene = part[-1].scene
    empty = replace(
        part[-1],
        scene=Scene(
            scene.time_s,
            (),
            *(getattr(scene, name)[nobody] for name in ("xy_m", "yaw_rad", "speed_mps", "size_m")),
            *(getattr(scene, name)[nobody] for name in ("kind", "colour", "blinker")),
            signal_closed=scene.signal_closed,
        ),
        truth=replace(part[-1].truth, routes=()),
    )
    again = [
        replace(f, scene=replace(f.scene, ids=tuple(f"1:{name}" for name in f.scene.ids)))
        for f in part
    ]
    frames = [empty, *part, *[empty] * 11, *again]
    replay = SumoReplay(replace(recording, played=frames), net_path)
    shown = play(replay)
    assert [frame.scene.ids for frame in shown] == [frame.scene.ids for frame in frames]
    fidelity = replay.fidelity
    assert fidelity.n == 2 * sum(len(frame.scene.ids) for frame in part) and fidelity.lost == 0
    assert fidelity.position_m_max is not None and fidelity.position_m_max < 1e-9


def test_what_is_asked_wrongly_is_said_in_one_line(tmp_path: Path) -> None:
    recording, net_path = recorded("tjunction")
    some = recording.played[0].scene.ids[0]
    last_s = recording.played[-1].scene.time_s

    def said(replay: SumoReplay, command: str | None = None) -> str:
        with replay, pytest.raises(InputError) as error:
            replay.reset(1)
            replay.step([Command(command, 0.0)] if command else ())
        assert "\n" not in str(error.value)
        return str(error.value)

    elsewhere = replace(
        recording,
        played=[replace(f, scene=moved(f.scene, (700.0, 0.0))) for f in recording.played],
    )
    text = said(SumoReplay(elsewhere, net_path))
    assert "do not fit" in text and "netOffset" in text
    away_m = float(text.split("vehicles are ")[1].split(" m")[0])
    assert 400.0 < away_m < 800.0
    # Of another place, though its lanes are near: it is said how many are beside them.
    beside = replace(
        recording, played=[replace(f, scene=moved(f.scene, (0.0, 4.5))) for f in recording.played]
    )
    replay = SumoReplay(beside, net_path)
    play(replay, 1)
    assert any("beside every lane of tjunction.net.xml" in notice for notice in replay.notices)
    assert "no vehicle 'nobody'" in said(SumoReplay(recording, net_path, {"nobody": None}))
    assert "cannot be taken over at" in said(SumoReplay(recording, net_path, {some: last_s + 9}))
    assert "keeps to its recording" in said(SumoReplay(recording, net_path), command=some)
    assert "no frame" in said(SumoReplay(replace(recording, played=[]), net_path))
    broken = tmp_path / "broken.net.xml"
    broken.write_text("<net><edge/>")
    assert "SUMO refuses the net" in said(SumoReplay(recording, broken))
    with pytest.raises(InputError, match="no such file"):
        open_replay(recording, tmp_path / "missing.net.xml")
    with pytest.raises(InputError, match="expected ID or ID@SECONDS"):
        parse_take_over("12@soon")
    assert parse_take_over("12@3.5, a@b@7,13") == {"12": 3.5, "a@b": 7.0, "13": None}


def test_boxes_touch_by_hand() -> None:
    xy = np.array([[0.0, 0.0], [4.9, 0.0], [5.1, 0.0], [0.0, 3.2], [3.1, 1.9]])
    yaw = np.array([0.0, 0.0, 0.0, np.pi / 2, np.pi / 4])
    size = np.tile([5.0, 2.0], (5, 1))
    first, second = np.zeros(4, dtype=np.int64), np.arange(1, 5)
    # End to end by 0.1 m, apart by 0.1 m, crosswise into the side, cornerwise.
    touch = boxes_touch(xy, yaw, size, first, second)
    assert touch.tolist() == [True, False, True, True]


def test_boxes_touch_as_polygons_intersect() -> None:
    from shapely.affinity import rotate, translate
    from shapely.geometry import box

    rng = np.random.default_rng(0)
    xy, yaw = rng.uniform(-5, 5, (80, 2)), rng.uniform(-np.pi, np.pi, 80)
    size = rng.uniform((2, 1), (8, 3), (80, 2))
    outlines = [
        translate(rotate(box(-le / 2, -w / 2, le / 2, w / 2), a, (0, 0), use_radians=True), x, y)
        for (x, y), a, (le, w) in zip(xy, yaw, size, strict=True)
    ]
    first, second = np.triu_indices(80, 1)
    expected = [outlines[i].intersects(outlines[j]) for i, j in zip(first, second, strict=True)]
    assert boxes_touch(xy, yaw, size, first, second).tolist() == expected


def test_pairs_of_some_are_those_of_all_that_have_one_of_them() -> None:
    rng = np.random.default_rng(1)
    scene = scene_of(0.0, {f"v{k}": tuple(rng.uniform(-12, 12, 4)) for k in range(40)})
    of = np.arange(40) % 3 == 0
    rows = touching_rows_of(scene, of)
    assert all(of[one] for one, _ in rows) and len(rows) > 10
    marked = {name for name, is_marked in zip(scene.ids, of, strict=True) if is_marked}
    expected = [pair for pair in touching_pairs(scene) if marked & set(pair)]
    assert sorted(tuple(sorted((scene.ids[i], scene.ids[j]))) for i, j in rows) == expected


def test_quantiles_against_numpy() -> None:
    values = np.random.default_rng(0).exponential(1.0, 5000)
    counted = Quantiles()
    for part in np.array_split(values, 7):
        counted.add(part)
    for share in (0.5, 0.99):
        exact = np.quantile(values, share, method="inverted_cdf")
        assert counted.quantile(share) == pytest.approx(exact, abs=1e-3)
    assert counted.max == values.max() and Quantiles().quantile(0.5) is None


def test_figures_are_printed_and_scored() -> None:
    recording, net_path = recorded("tjunction")
    replay = SumoReplay(recording, net_path, react_from_s=40.0)
    play(replay)
    out = io.StringIO()
    Console(file=out, width=100).print(replay_table("t", replay.fidelity, replay.divergence))
    text = out.getvalue()
    assert "position, m" in text and "collisions of driven vehicles" in text
    scores = {
        score.measure: score for score in replay_scores("t", replay.fidelity, replay.divergence)
    }
    assert scores["replay_lane_share"].n == replay.fidelity.lane_n
    assert scores["divergence_m_median_1s"].value == replay.divergence.at[0].median_m
