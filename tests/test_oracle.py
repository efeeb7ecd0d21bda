"""The comparison with SUMO's conflicts: by hand on a drawn crossing, then on a scene that ships.

The crossing of `conftest.py` under SUMO's names, the left turn split where it waits:

    w_0 - :c_0_0 - e_0      s_0 - :c_1_0 - n_0      w_0 - :c_2_0 - :c_3_0 - n_0

Every approach is 100 m long, the connections straight on are 16 m, those to the left 4 pi m.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import crossing_lanes

from hatn_sim import cli
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Lane
from hatn_sim.geometry import arc_length_m
from hatn_sim.road import Road
from hatn_sim.score.oracle import Moment, Oracle, Outcome
from hatn_sim.score.oracle_distances import DistanceErrors, merge_begin_m
from hatn_sim.score.oracle_lanes import junction_spans, read_junctions
from hatn_sim.score.oracle_scores import Tally, explain, way_xy_m
from hatn_sim.simulators.sumo_foes import FoeReader
from hatn_sim.simulators.sumo_lanes import LaneTable, Link, junction_of
from hatn_sim.simulators.sumo_messages import JunctionFoes, LaneFoes

NAMES = {
    "w": "w_0", "we": ":c_0_0", "e": "e_0", "s": "s_0", "sn": ":c_1_0", "n": "n_0", "wn": ":c_2_0",
}  # fmt: skip
EAST = ("w_0", ":c_0_0", "e_0")
NORTH = ("s_0", ":c_1_0", "n_0")
LEFT = ("w_0", ":c_2_0", ":c_3_0", "n_0")
ROUTES = {"east": EAST, "north": NORTH, "left": LEFT}


def lanes() -> list[Lane]:
    named = [
        replace(one, id=NAMES[one.id], successors=tuple(NAMES[name] for name in one.successors))
        for one in crossing_lanes()
    ]
    turn = next(one for one in named if one.id == ":c_2_0")
    first = replace(turn, xy_m=turn.xy_m[:31], successors=(":c_3_0",))
    second = replace(turn, id=":c_3_0", xy_m=turn.xy_m[30:])
    return [*(one for one in named if one is not turn), first, second]


def foes_of(
    *pairs: tuple[str, str], approaching: tuple[tuple[str, str, str], ...] = ()
) -> LaneFoes:
    row = {one.id: k for k, one in enumerate(lanes())}
    return LaneFoes(
        inside=np.array([[row[a], row[b]] for a, b in pairs], np.int64).reshape(-1, 2),
        approaching=np.array(
            [[row[name] for name in names] for names in approaching], np.int64
        ).reshape(-1, 3),
        mute=np.zeros(0, np.int64),
    )


class Crossing:
    """Two vehicles on the crossing, and what a SUMO would say of them."""

    def __init__(self, one: str, other: str, table: LaneFoes | None = None) -> None:
        self.road = Road(lanes())
        self.junctions = read_junctions(lanes(), table or foes_of())
        self.ways = (one, other)
        self.line = np.array([self.road.line(ROUTES[name]) for name in self.ways])

    def row(self, name: str) -> int:
        return self.junctions.row[name]

    def compare(
        self,
        front_s_m: tuple[float, float],
        listed: tuple[tuple[int, int, str, str, float, float, float, float], ...] = (),
        line: tuple[int, int] | None = None,
    ) -> Any:
        """`listed`: asked, foe, their lanes, to enter and to leave the area (asked, foe)."""
        lane = np.array([[self.row(a), self.row(b)] for _, _, a, b, *_ in listed]).reshape(-1, 2)
        numbers = np.array([entry[4:] for entry in listed], dtype=np.float64).reshape(-1, 4)
        foes = JunctionFoes(
            vehicle=np.array([entry[:2] for entry in listed], np.int64).reshape(-1, 2),
            lane=lane.astype(np.int64),
            enter_m=numbers[:, :2],
            leave_m=numbers[:, 2:],
            approach_vehicle=np.arange(2),
            approach_lane=np.array([self.row(ROUTES[name][1]) for name in self.ways]),
            approach_m=100.0 - np.array(front_s_m),
        )
        at = np.array(front_s_m)
        places = self.road.locate(self.line, at, np.zeros(2))
        own = self.line if line is None else np.array(line)
        return Oracle(self.road, self.junctions).compare(Moment(places, own, at, foes))


def outcomes(compared: Any) -> list[Outcome]:
    return [Outcome(value) for value in compared.outcome.tolist()]


def test_lanes_inside_junctions() -> None:
    found = read_junctions(lanes(), foes_of((":c_0_0", ":c_1_0"), (":c_3_0", ":c_1_0")))
    row = found.row
    assert junction_of(":c_3_0") == "c" and junction_of(":two_words_12_1") == "two_words"
    assert found.way[row[":c_3_0"]] == row[":c_2_0"] == found.way[row[":c_2_0"]]
    assert found.source[row[":c_3_0"]] == row["w_0"]
    assert found.target[row[":c_3_0"]] == row["n_0"] and found.target[row[":c_2_0"]] == -1
    assert found.junction[row["w_0"]] == -1 and found.junction[row[":c_3_0"]] == 0
    ways = np.array([[":c_1_0", ":c_2_0"], [":c_0_0", ":c_2_0"]])
    rows = np.vectorize(row.__getitem__)(ways)
    assert found.are_foes(rows).tolist() == [True, False]
    road = Road(lanes())
    spans = junction_spans(found, road.lines[road.line(LEFT)])
    np.testing.assert_allclose(spans[0], (100.0, 100.0 + 4.0 * np.pi), atol=0.02)


def test_what_follows_the_first_foe_that_is_not_met_is_not_listed() -> None:
    """Of the way straight on, :c_2_0 is from the same lane; :c_3_0 does not cross it."""
    table = foes_of(
        (":c_0_0", ":c_2_0"), (":c_0_0", ":c_3_0"), (":c_0_0", ":c_1_0"), (":c_1_0", ":c_0_0")
    )
    found = read_junctions(lanes(), table)
    east, north, left = (found.row[ROUTES[name][1]] for name in ("east", "north", "left"))
    ways = np.array([[east, left], [east, north], [north, east]])
    assert found.are_foes(ways).all()
    # :c_3_0 comes from the same lane too, so nothing is cut off here ...
    assert found.can_list(ways).tolist() == [True, True, True]
    # ... but behind a lane that neither comes from the same, nor leads to the same, nor crosses.
    table = foes_of((":c_1_0", ":c_2_0"), (":c_1_0", ":c_0_0"))
    found = read_junctions(lanes(), table)
    ways = np.array([[north, left], [north, east], [east, north]])
    assert found.are_foes(ways).all()
    assert found.can_list(ways).tolist() == [False, False, False]


def test_a_crossing_in_both_lists_with_its_distances() -> None:
    at = Crossing("east", "north")
    # Both lines meet 8 m behind the begin of the junction; SUMO's area is a lane wide.
    east = (0, 1, ":c_0_0", ":c_1_0", 26.4, 0.0, 29.6, 1.0)
    north = (1, 0, ":c_1_0", ":c_0_0", 36.9, 0.0, 40.1, 1.0)
    compared = at.compare((80.0, 70.0), (east, north))
    assert outcomes(compared) == [Outcome.BOTH]
    assert compared.distances.vehicle.tolist() == [0, 1]
    # 108 - 80 = 28 against (26.4 + 29.6) / 2; 108 - 70 = 38 against 38.5.
    np.testing.assert_allclose(compared.distances.place_m, [0.0, -0.5], atol=0.06)
    # 106.2 - 80 - 26.4 and 106.2 - 70 - 36.9.
    np.testing.assert_allclose(compared.distances.entry_m, [-0.2, -0.7], atol=0.11)


def test_a_merge_is_measured_to_where_sumo_lets_it_begin() -> None:
    at = Crossing("left", "north")
    # The way north is 2.5 m from the arc of 8 m radius round (-8, 8) from (0, y) on.
    y = 8.0 - np.sqrt(10.5**2 - 8.0**2)
    north = (1, 0, ":c_1_0", ":c_3_0", 108.0 + y - 70.0, 0.0, 112.0 + y - 70.0, 1.0)
    # The arc comes that near before its second lane begins, and SUMO looks at that lane only.
    assert 8.0 * np.arcsin(5.5 / 8.0) < 2.0 * np.pi
    begin = 100.0 + 2.0 * np.pi
    left = (0, 1, ":c_3_0", ":c_1_0", begin - 60.0, 0.0, begin - 56.8, 1.0)
    compared = at.compare((60.0, 70.0), (north, left))
    assert outcomes(compared) == [Outcome.BOTH]
    np.testing.assert_allclose(compared.distances.place_m, [0.0, 0.0], atol=0.1)
    ours = (108.0 + 8.0 - np.sqrt(9.8**2 - 8.0**2), 100.0 + 8.0 * np.arcsin(6.2 / 8.0))
    expected = [ours[0] - 108.0 - y, ours[1] - begin]
    np.testing.assert_allclose(compared.distances.entry_m, expected, atol=0.15)


def test_a_place_to_wait_is_no_distance_to_the_area() -> None:
    at = Crossing("left", "east")
    same = at.compare((60.0, 70.0), ((0, 1, ":c_3_0", ":c_0_0", 46.0, 38.0, 49.0, 41.0),))
    assert outcomes(same) == [Outcome.SAME_LANE_BEFORE]
    # Were the foe's lane to lead elsewhere, the second half of the turn would be a crossing.
    at = Crossing("left", "north")
    at.junctions.target[at.row(":c_1_0")] = at.row("e_0")
    compared = at.compare((60.0, 70.0), ((0, 1, ":c_3_0", ":c_1_0", 46.0, 38.0, 49.0, 41.0),))
    assert outcomes(compared) == [Outcome.BOTH]
    assert compared.distances.waiting_places == 1 and not len(compared.distances.place_m)


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (foes_of(), Outcome.ONLY_OURS),
        (foes_of((":c_0_0", ":c_1_0")), Outcome.UNANNOUNCED),
        # :c_1_0 has a foe first that it does not meet: its list never comes to :c_0_0.
        (foes_of((":c_1_0", ":c_2_0"), (":c_1_0", ":c_0_0")), Outcome.CUT_SHORT),
        (
            foes_of(approaching=(("w_0", "e_0", "s_0"), ("s_0", "n_0", "w_0"))),
            Outcome.RIGHT_OF_WAY_ONLY,
        ),
        (foes_of(approaching=(("w_0", "e_0", "s_0"),)), Outcome.ONLY_OURS),
        (replace(foes_of(), mute=np.arange(len(lanes()))), Outcome.NO_LOGIC),
    ],
)
def test_what_sumo_does_not_list(table: LaneFoes, expected: Outcome) -> None:
    assert outcomes(Crossing("east", "north", table).compare((80.0, 70.0))) == [expected]


def test_what_sumo_owes_us_is_no_class_left_out() -> None:
    """The one going north is announced: it is listed for somebody, though not for the other."""
    at = Crossing("east", "north", foes_of((":c_0_0", ":c_1_0")))
    himself = (1, 1, ":c_0_0", ":c_1_0", 1.0, 1.0, 2.0, 2.0)
    another = (0, 0, ":c_1_0", ":c_0_0", 1.0, 1.0, 2.0, 2.0)
    assert outcomes(at.compare((80.0, 70.0), (himself, another))) == [Outcome.ONLY_OURS]
    # The one who should list it lists nobody at all.
    assert outcomes(at.compare((80.0, 70.0), (himself,))) == [Outcome.NO_LIST]


def test_what_only_sumo_lists() -> None:
    listed = (0, 1, ":c_0_0", ":c_1_0", 26.4, 36.4, 29.6, 39.6)
    at = Crossing("east", "north")
    elsewhere = int(at.road.line(("e_0",)))
    found = at.compare((80.0, 70.0), (listed,), line=(elsewhere, int(at.line[1])))
    assert outcomes(found) == [Outcome.ONLY_SUMO_OTHER_LANE]
    found = at.compare((80.0, 70.0), (listed,), line=(-1, int(at.line[1])))
    assert outcomes(found) == [Outcome.NO_ROUTE]


def test_what_is_over_or_out_of_date_is_left_out() -> None:
    at = Crossing("east", "north")
    passed = (0, 1, ":c_0_0", ":c_1_0", -5.0, 36.4, -1.8, 39.6)
    assert outcomes(at.compare((111.4, 70.0), (passed,))) == [Outcome.PASSED]
    at = Crossing("left", "east")
    at.junctions.source[at.row(":c_0_0")] = at.row("s_0")  # as if from somewhere else
    stale = (0, 1, ":c_2_0", ":c_1_0", 20.0, 20.0, 23.0, 23.0)
    assert outcomes(at.compare((80.0, 70.0), (stale,))) == [Outcome.OUTDATED]


def test_beyond_the_reach_there_is_no_meeting() -> None:
    assert outcomes(Crossing("east", "north").compare((80.0, 39.0))) == []


def test_the_begin_of_a_merge_by_hand() -> None:
    straight = np.stack((np.arange(0.0, 100.5, 0.5), np.zeros(201)), axis=1)
    slope = straight.copy()
    slope[:, 1] = np.maximum(0.1 * (60.0 - slope[:, 0]), 0.0)
    # At slope 1 : 10 the point 2 m above the line is 20 m before it (steps along it: 1.005).
    found = merge_begin_m(slope, straight, 44.0, 44.0, 2.0)
    np.testing.assert_allclose(found, 40.0, atol=0.01)
    assert merge_begin_m(straight, straight, 50.0, 50.0, 2.0) == 25.0  # together all along


def test_scores_by_hand() -> None:
    tally = Tally(read_junctions(lanes(), foes_of()))
    assert {score.n for score in tally.scores("x")} == {0}
    assert {score.value for score in tally.scores("x")} == {None}
    row = tally.lanes.row
    kinds = [Outcome.BOTH] * 6 + [Outcome.ONLY_SUMO] * 2 + [Outcome.ONLY_OURS, Outcome.CUT_SHORT]
    count = len(kinds)
    compared = SimpleNamespace(
        vehicle=np.tile([0, 1], (count, 1)),
        way=np.tile([row[":c_0_0"], row[":c_1_0"]], (count, 1)),
        outcome=np.array(kinds),
        distances=DistanceErrors(
            np.array([0, 1, 1]), np.array([-3.0, 1.0, 0.5]), np.array([2.0, -1.0, 4.0]), 5
        ),
    )
    tally.add(compared, ["a", "b"])  # type: ignore[arg-type]
    scores = {score.measure: score for score in tally.scores("x")}
    assert (scores["conflict_recall"].value, scores["conflict_recall"].n) == (6 / 8, 8)
    assert (scores["conflict_precision"].value, scores["conflict_precision"].n) == (6 / 7, 7)
    assert scores["conflict_precision_with_table"].value == 7 / 8
    assert (scores["distance_median_m"].value, scores["distance_median_m"].n) == (1.0, 3)
    assert scores["entry_distance_median_m"].value == 2.0
    assert (scores["meetings_cut_short"].value, scores["meetings_cut_short"].n) == (1.0, 10)
    assert scores["distances_to_waiting_places"].value == 5.0
    (first, second) = tally.disagreements()
    assert first[:2] == (Outcome.ONLY_SUMO, 2) and second[:2] == (Outcome.ONLY_OURS, 1)
    assert first[2] == ":c_0_0 and :c_1_0 come within 0.0 m of each other, at 90 degrees"


def test_a_way_in_two_parts_is_explained_as_it_is_driven() -> None:
    """Whatever the order of the lanes: names sort :c_10_0 before :c_2_0."""
    nothing = foes_of()
    for order in (lanes(), lanes()[::-1]):
        found = read_junctions(order, nothing)
        xy_m = way_xy_m(found, found.row[":c_2_0"])
        np.testing.assert_allclose(arc_length_m(xy_m)[-1], 4.0 * np.pi, atol=0.2)
        assert "come within 0.0 m" in explain(found, found.row[":c_2_0"], found.row[":c_0_0"])


def test_sumo_is_not_asked_beyond_a_junction_without_logic() -> None:
    """Straight or left at c, where SUMO holds nothing against anything."""
    asked: list[float] = []
    links = {"w_0": [("e_0", ":c_0_0"), ("n_0", ":c_2_0")], ":c_0_0": [("e_0", "")]}
    sumo = SimpleNamespace(
        lane=SimpleNamespace(
            getInternalFoes=lambda _: (),
            getLength=lambda lane: {"w_0": 100.0, ":c_0_0": 16.0, "e_0": 150.0}[lane],
            getLinks=lambda lane: [(to, 1, 1, 0, via, "M", "s", 0) for to, via in links[lane]],
        ),
        vehicle=SimpleNamespace(
            getLaneID=lambda name: "w_0",
            getLanePosition=lambda name: {"far": 60.0, "near": 99.8}[name],
            getNextLinks=lambda _: [("e_0", 1, 1, 0, ":c_0_0", "M", "s", 16.0)],
            getJunctionFoes=lambda name, reach_m: asked.append(reach_m) or (),
        ),
    )
    ids = ("w_0", ":c_0_0", ":c_2_0", "e_0", "n_0")
    empty = LaneTable(
        ids=ids,
        point_counts=(2,) * 5,
        xy_m=np.zeros((10, 2)),
        length_m=(1.0,) * 5,
        width_m=(3.2,) * 5,
        speed_limit_mps=(10.0,) * 5,
        kinds=(frozenset(),) * 5,
        links=(tuple(Link(via, "M", "s", None) for _, via in links["w_0"]), (), (), (), ()),
    )
    found = FoeReader(sumo, empty).junction_foes(("far", "near"), 200.0)
    np.testing.assert_allclose(asked, [39.5])  # of the far one only: 40 m, less a margin
    assert found.approach_lane.tolist() == [1, 1]
    np.testing.assert_allclose(found.approach_m, [40.0, 0.2])


def code_of(*words: str) -> int:
    try:
        return cli.main(words)
    except SystemExit as leaving:
        return int(leaving.code or 0)


def test_a_scene_agrees_with_sumo(capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of("doctor", "--oracle", "tjunction", "--duration", "120", "--json") == 0
    scores = {score["measure"]: score for score in json.loads(capsys.readouterr().out)}
    assert scores["conflict_recall"]["value"] >= 0.99
    assert scores["conflict_precision"]["value"] >= 0.99
    assert scores["conflict_recall"]["n"] > 50
    assert scores["distance_median_m"]["value"] <= 0.2
    assert scores["meetings_same_lane_before"]["value"] > 0.0
    assert {score["predictor"] for score in scores.values()} == {"route"}


def test_a_scene_agrees_with_sumo_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of("doctor", "--oracle", "roundabout8", "--duration", "20") == 0
    printed = capsys.readouterr().out
    assert "conflict_recall" in printed and "same_lane_before" in printed


def test_what_is_wrong_with_the_scene_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert code_of("doctor", "--oracle", "tjunktion") == 2
    assert "unknown scene 'tjunktion'; did you mean 'tjunction'?" in capsys.readouterr().err
    assert code_of("doctor", "--oracle", str(tmp_path / "no.sumocfg")) == 2
    assert capsys.readouterr().err.count("\n") == 1
    other = replace(load_scenario("tjunction"), simulator="highway")
    monkeypatch.setattr("hatn_sim.config.load_scenario", lambda _: other)
    assert code_of("doctor", "--oracle", "merge") == 2
    assert "expected a scene simulated by SUMO" in capsys.readouterr().err
