"""Drives in closed loop: measures against numbers worked out by hand, scores against scipy, and
the oracle against what really comes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing

import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of
from scipy.stats import kendalltau, spearmanr

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, Command, Frame, Route, Truth
from hatn_sim.evaluation.closed_loop_oracle import BranchOracle
from hatn_sim.loop import warm_up
from hatn_sim.road import Road
from hatn_sim.score.closed_loop import UNITS, drive_measures
from hatn_sim.score.closed_loop_rows import DrivenEgo, DrivenRow, OpenLoop
from hatn_sim.score.closed_loop_scores import closed_loop_scores, kendall, spearman
from hatn_sim.score.drive import COLLISION, CROSSED, GONE, TIME, Drive, DriveRecorder
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.way import way_along

LIMIT_S = 30.0
ROUTES: dict[str, Route] = {"ego": ("w", "we", "e")}
NORTH: Route = ("s", "sn", "n")
Motion = Callable[[float], tuple[float, float, float, float] | None]
"""Time -> x, y, yaw, speed; None: not on the road."""


def frame_of(time_s: float, motions: Mapping[str, Motion], **truth: object) -> Frame:
    poses = {name: motion(time_s) for name, motion in motions.items()}
    there = {name: pose for name, pose in poses.items() if pose is not None}
    routes = tuple(ROUTES.get(name, NORTH) for name in there)
    return Frame(scene_of(time_s, there), Truth(routes, **truth), done=False)  # type: ignore[arg-type]


def driven(motions: Mapping[str, Motion], until_s: float = 60.0, limit_s: float = LIMIT_S) -> Drive:
    recorder = DriveRecorder("ego", Road(crossing_lanes()), limit_s)
    for k in range(round(until_s / DT_S)):
        recorder.see(frame_of(k * DT_S, motions))
        if recorder.is_over:
            break
    return recorder.drive()


def eastward(x_m: float, speed_mps: float) -> Motion:
    return lambda t: (x_m + speed_mps * t, 0.0, 0.0, speed_mps)


def northward(at_s: float, speed_mps: float = 10.0) -> Motion:
    """In the middle of the crossing at that time."""
    return lambda t: (0.0, speed_mps * (t - at_s), 0.5 * np.pi, speed_mps)


def waiting(until_s: float) -> Motion:
    """Half a metre before the crossing; then off with 2 m/s2."""

    def motion(t: float) -> tuple[float, float, float, float]:
        gone_s = max(t - until_s, 0.0)
        return -11.0 + gone_s**2, 0.0, 0.0, 2.0 * gone_s

    return motion


def test_a_free_drive_takes_what_its_way_takes() -> None:
    # Front bumpers are 2.5 m ahead: at -8 m after 3.95 s; rear ones are at 8 m after 6.05 s.
    drive = driven({"ego": eastward(-50.0, 10.0)})
    measures = drive_measures(drive, LIMIT_S)
    assert drive.end == CROSSED and set(measures) == set(UNITS)
    assert measures["time_to_enter"] == pytest.approx(4.0)
    assert measures["time_to_cross"] == pytest.approx(6.1)
    expected = {"crossed": 1.0} | dict.fromkeys(
        ("collisions", "t2_t3_events", "others_braking", "missed_gaps", "standing"), 0.0
    )
    assert {name: measures[name] for name in expected} == expected
    assert measures["jerk_rms"] == pytest.approx(0.0, abs=1e-6)
    # It is looked at for 3 s more.
    assert len(drive.driven.time_s) == 62 + 30


def test_who_does_not_cross_is_told_with_the_limit() -> None:
    stands: Motion = lambda t: (-30.0, 0.0, 0.0, 0.0)  # noqa: E731
    drive = driven({"ego": stands}, limit_s=8.0)
    measures = drive_measures(drive, 8.0)
    assert drive.end == TIME
    assert (measures["crossed"], measures["time_to_cross"], measures["standing"]) == (0.0, 8.0, 1.0)
    gone = driven({"ego": lambda t: None if t > 2.0 else (-30.0, 0.0, 0.0, 5.0), "n": stands})
    assert gone.end == GONE and drive_measures(gone, LIMIT_S)["time_to_cross"] == LIMIT_S


def test_a_collision_ends_the_drive() -> None:
    recorder = DriveRecorder("ego", Road(crossing_lanes()), LIMIT_S)
    motions = {"ego": eastward(-20.0, 5.0), "other": northward(3.9)}
    for k in range(41):
        pairs = (("ego", "other"),) if k == 40 else ()
        recorder.see(frame_of(k * DT_S, motions, collisions=pairs))
    measures = drive_measures(recorder.drive(), LIMIT_S)
    assert recorder.is_over and recorder.end == COLLISION
    assert measures["collisions"] == 1.0 and measures["crossed"] == 0.0
    assert measures["time_to_cross"] == LIMIT_S
    assert measures["time_to_enter"] == pytest.approx(2.0, abs=0.11)


@pytest.mark.parametrize(
    ("others_s", "starts_s", "missed"),
    [
        # A start is blocked from 5.16 s before to 1.39 s before somebody is in the middle.
        ((5.0, 12.0), 99.0, 1),
        ((5.0, 9.0), 99.0, 0),  # open for 0.2 s: too short
        ((5.0, 12.0, 19.0), 99.0, 2),
        ((5.0, 12.0), 5.0, 0),  # taken
        ((5.0, 12.0, 19.0), 12.0, 1),  # the second is taken
        ((), 99.0, 0),  # open for ever: nobody can tell where the gap would have ended
    ],
)
def test_gaps_are_missed_by_hand(others_s: tuple[float, ...], starts_s: float, missed: int) -> None:
    motions: dict[str, Motion] = {"ego": waiting(starts_s)}
    motions |= {f"n{at:g}": northward(at) for at in others_s}
    measures = drive_measures(driven(motions), LIMIT_S)
    assert measures["missed_gaps"] == missed
    assert measures["crossed"] == float(starts_s < LIMIT_S)


def test_red_is_no_gap() -> None:
    lanes = {one.id: one for one in crossing_lanes()}
    lanes["w"] = lane("w", [(-108, 0), (-8, 0)], "we", "wn", signals={"we": 0, "wn": 0})
    recorder = DriveRecorder("ego", Road(lanes.values()), LIMIT_S)
    motions = {"ego": waiting(99.0), "a": northward(5.0), "b": northward(12.0)}
    for k in range(300):
        frame = frame_of(k * DT_S, motions)
        closed = np.array([True])
        object.__setattr__(frame.scene, "signal_closed", closed)
        recorder.see(frame)
    assert drive_measures(recorder.drive(), LIMIT_S)["missed_gaps"] == 0.0


def braking(brake_mps2: float, shift_m: float = 0.0) -> Motion:
    """Northwards at 10 m/s, from 1 s on braking to a halt."""

    def motion(t: float) -> tuple[float, float, float, float]:
        braked_s = min(max(t - 1.0, 0.0), 10.0 / brake_mps2)
        speed = 10.0 - brake_mps2 * braked_s
        y = -26.0 + 10.0 * min(t, 1.0) + 10.0 * braked_s - 0.5 * brake_mps2 * braked_s**2
        return shift_m, y, 0.5 * np.pi, speed

    return motion


def test_others_brake_for_the_ego_as_hard_as_they_do() -> None:
    # Both would have been in the middle at about 2.6 s.
    hard = drive_measures(driven({"ego": eastward(-26.0, 10.0), "other": braking(5.0)}), LIMIT_S)
    assert hard["others_braking"] == pytest.approx(5.0)
    assert hard["t2_events"] == 1.0
    mild = drive_measures(driven({"ego": eastward(-26.0, 10.0), "other": braking(4.0)}), LIMIT_S)
    assert mild["others_braking"] == pytest.approx(4.0) and mild["t2_events"] == 0.0
    away = drive_measures(
        driven({"ego": eastward(-26.0, 10.0), "other": braking(5.0, 100.0)}), LIMIT_S
    )
    assert away["others_braking"] == 0.0 and away["t2_events"] == 0.0


def test_close_passes_are_counted_by_their_time() -> None:
    # The ego's rear is out of the other's way 0.35 s after it was in the middle, at 5.0 s; the
    # other's front is there 0.35 s before it is.
    for at_s, close, very_close in ((5.0 + 1.9, 1, 0), (5.0 + 1.2, 1, 1), (5.0 + 2.9, 0, 0)):
        motions = {"ego": eastward(-50.0, 10.0), "other": northward(at_s)}
        measures = drive_measures(driven(motions), LIMIT_S)
        assert (measures["t3_events"], measures["t3_events_1s"]) == (close, very_close)


def test_jerk_is_that_of_the_speeds() -> None:
    def motion(t: float) -> tuple[float, float, float, float]:
        return -50.0 + 5.0 * t + t**3 / 6.0, 0.0, 0.0, 5.0 + 0.5 * t**2

    measures = drive_measures(driven({"ego": motion}), LIMIT_S)
    assert measures["jerk_rms"] == pytest.approx(1.0) == measures["jerk_p95"]


def test_junctions_close_by_are_one_crossing() -> None:
    lanes = [
        lane("a", [(0, 0), (40, 0)], "j1"),
        lane("j1", [(40, 0), (50, 0)], "b", is_connection=True),
        lane("b", [(50, 0), (90, 0)], "j2"),
        lane("j2", [(90, 0), (96, 0)], "j3", is_connection=True),
        lane("j3", [(96, 0), (100, 0)], "c", is_connection=True),
        lane("c", [(100, 0), (151, 0)], "j4"),
        lane("j4", [(151, 0), (160, 0)], "d", is_connection=True),
        lane("d", [(160, 0), (200, 0)]),
    ]
    route = ("a", "j1", "b", "j2", "j3", "c", "j4", "d")
    way = way_along(Road(lanes), route, np.array([10.0, 0.0]))
    assert way.first_crossing is not None and way.last_junction_s_m == pytest.approx(160.0)
    assert way.first_crossing.entry_s_m == pytest.approx(40.0)
    assert way.first_crossing.exit_s_m == pytest.approx(100.0)
    assert (way.first_crossing.from_lane, way.first_crossing.into_lane) == ("a", "j1")
    inside = way_along(Road(lanes), ("j2", "j3", "c"), np.array([92.0, 0.0])).first_crossing
    assert inside is not None and inside.from_lane is None
    assert (inside.entry_s_m, inside.exit_s_m) == pytest.approx((0.0, 10.0))
    assert way_along(Road(lanes), ("d",), np.array([170.0, 0.0])).first_crossing is None


# ---------------------------------------------------------------------------------------------
# Scores


def row_of(seed: int, name: str, times_s: list[float], ade_m: float | None = None) -> DrivenRow:
    egos = tuple(
        DrivenEgo(f"v{k}", CROSSED, dict.fromkeys(UNITS, 0.0) | {"time_to_cross": time_s})
        for k, time_s in enumerate(times_s)
    )
    opened = () if ade_m is None else (OpenLoop("ade_3s", "all", "m", ade_m, 10 * seed),)
    return DrivenRow("place", seed, name, egos, opened, {})


def test_scores_are_paired_and_say_what_is_missing() -> None:
    rows = [
        row_of(1, "sumo_driver", [10.0]),
        row_of(1, "base", [20.0, 30.0], 1.0),
        row_of(1, "new", [15.0], 0.5),
        row_of(2, "base", [40.0], 4.0),
        row_of(2, "new", [30.0], 2.0),
        row_of(3, "new", [99.0], 0.5),
    ]
    places = [("place", 1), ("place", 2), ("place", 3)]
    scores = closed_loop_scores(rows, "planner", ["base", "new"], places)
    told = {(s.measure, s.predictor): s for s in scores if s.subset in ("planner", "sumo_driver")}
    assert told["time_to_cross", "base"].value == pytest.approx(30.0)
    assert told["time_to_cross", "base"].n == 3
    # Of (20, 15) and (40, 30): the drives that both have.
    assert told["time_to_cross_change", "new"].value == pytest.approx(-7.5)
    assert told["time_to_cross_change", "new"].n == 2
    assert told["time_to_cross_relative_change", "new"].value == pytest.approx(-15.0 / 60.0)
    assert told["time_to_cross_change", "sumo_driver"].value == pytest.approx(-10.0)
    assert told["collisions_relative_change", "new"].value is None
    lost = {name: told["lost_seeds", name].value for name in ("base", "new", "sumo_driver")}
    assert lost == {"base": 1.0, "new": 0.0, "sumo_driver": 2.0}
    ade = {s.predictor: s.value for s in scores if s.measure == "ade_3s"}
    assert ade["base"] == pytest.approx((10 * 1.0 + 20 * 4.0) / 30)
    assert all((s.value is None) == (s.n == 0) for s in scores)
    # Two predictors have no rank correlation, and three seeds no interval.
    assert all(s.value is None for s in scores if s.measure in ("spearman", "kendall"))
    assert all(s.low is None for s in scores)


def test_intervals_and_ranks_over_many_seeds() -> None:
    rng = np.random.default_rng(4)
    rows: list[DrivenRow] = []
    for seed in range(1, 31):
        place_s = rng.normal(30.0, 8.0)
        for k, name in enumerate(("a", "b", "c")):
            time_s = float(place_s + 2.0 * k + rng.normal(0.0, 0.5))
            rows.append(row_of(seed, name, [time_s], 0.1 + 0.2 * k))
    places = [("place", seed) for seed in range(1, 31)]
    scores = closed_loop_scores(rows, "planner", ["a", "b", "c", "oracle"], places)
    change = next(s for s in scores if s.measure == "time_to_cross_change" and s.predictor == "b")
    assert change.low is not None and change.high is not None and change.value is not None
    assert change.low < 2.0 < change.high
    # Paired: the seeds' own differences of 8 s are not in it.
    assert change.high - change.low < 4.0 * 0.5 * np.sqrt(2.0 / 30.0) * 1.5
    crossed = next(s for s in scores if s.measure == "collisions" and s.predictor == "a")
    assert crossed.value == 0.0 and crossed.high == pytest.approx(1.0 - 0.025 ** (1.0 / 30.0))
    # The oracle's error is known to be none, but it has not driven: three are ranked.
    rank = next(s for s in scores if s.measure == "kendall" and "time_to_cross" in s.subset)
    assert (rank.value, rank.n) == (pytest.approx(1.0), 3)
    assert rank.low is None, "every draw comes to the same"
    ade = {s.predictor: s.value for s in scores if s.measure == "ade_3s"}
    assert ade == {
        "a": pytest.approx(0.1),
        "b": pytest.approx(0.3),
        "c": pytest.approx(0.5),
        "oracle": 0.0,
    }


def test_rank_correlations_are_those_of_scipy() -> None:
    rng = np.random.default_rng(1)
    for count in (3, 4, 9):
        pairs = rng.integers(0, 6, (20, 2, count)).astype(float)
        pairs[:, :, 0] += 0.5
        for one, rho, tau in zip(pairs, spearman(pairs), kendall(pairs), strict=True):
            if len(set(one[0])) > 1 and len(set(one[1])) > 1:
                assert rho == pytest.approx(spearmanr(*one)[0])
                assert tau == pytest.approx(kendalltau(*one)[0])
    assert np.isnan(spearman(np.array([[1.0, 1.0, 1.0], [1.0, 2.0, 3.0]])))
    assert np.isnan(kendall(np.array([[1.0, np.nan, 2.0], [1.0, 2.0, 3.0]])))


# ---------------------------------------------------------------------------------------------
# The oracle


def test_the_oracle_tells_what_comes() -> None:
    with closing(SumoSimulator(load_scenario("tjunction"))) as simulator:
        frame = warm_up(simulator, simulator.reset(5), 400)
        ego = frame.scene.ids[0]
        oracle = BranchOracle(simulator, ego)
        state = oracle.observe(oracle.init(simulator.road), frame.scene)
        told = oracle.predict(state)
        speed_mps = float(frame.scene.speed_mps[0])
        now = frame.scene
        count, seen = 0, set(now.ids)
        for k in range(HORIZON_FRAMES):
            at_mps = speed_mps
            if ego in frame.scene.ids:
                at_mps = float(frame.scene.speed_mps[frame.scene.ids.index(ego)])
            frame = simulator.step([Command(ego, (speed_mps - at_mps) / DT_S)])
            for row, name in enumerate(frame.scene.ids):
                if name in seen:
                    where = told.xy_m[now.ids.index(name), 0, k]
                    assert where == pytest.approx(frame.scene.xy_m[row], abs=1e-9)
                    count += 1
            seen &= set(frame.scene.ids)
        assert count > 3 * HORIZON_FRAMES
    assert told.ids == now.ids and not told.fallback.any()
