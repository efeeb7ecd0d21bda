"""Lanelet2 maps: hand-drawn ones, held against Lanelet2's own library, and written ones."""

from __future__ import annotations

import platform
import random
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from conftest import crossing_lanes
from conftest import lane as drawn

from hatn_sim.datatypes import FloatArray, Gate, Kind, Lane
from hatn_sim.errors import InputError
from hatn_sim.recordings.lanelet2.reader import read_lanelet2
from hatn_sim.recordings.lanelet2.rules import MOTOR, ROAD_KINDS, speed_mps
from hatn_sim.recordings.lanelet2.writer import write_lanelet2
from hatn_sim.resources import find_scenarios

needs_lanelet2 = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64", reason="has wheels for these only"
)
SAMPLE = find_scenarios()["recorded_sample"].parent / "map.osm"
Point = tuple[float, float]


class Drawing:
    """A map drawn by hand, in metres."""

    def __init__(self) -> None:
        self.nodes: dict[Point, int] = {}
        self.parts: list[str] = []
        self.count = 100

    def _element(self, tag: str, inside: Iterable[str], tags: Mapping[str, str]) -> int:
        self.count += 1
        lines = [*inside, *(f'<tag k="{k}" v="{v}" />' for k, v in tags.items())]
        self.parts.append(
            f'<{tag} id="{self.count}" visible="true" version="1">{"".join(lines)}</{tag}>'
        )
        return self.count

    def way(self, points: Iterable[Point], **tags: str) -> int:
        ids = [
            self.nodes.setdefault((round(x, 9), round(y, 9)), len(self.nodes) + 1000)
            for x, y in points
        ]
        return self._element("way", (f'<nd ref="{n}" />' for n in ids), {"type": "virtual", **tags})

    def relation(self, tags: Mapping[str, str], **members: int | Sequence[int]) -> int:
        """Members by role; those of bounds, lines and signs are ways."""
        inside: list[str] = []
        for role, refs in members.items():
            kind = "way" if role in ("left", "right", "ref_line", "refers", "centerline") else (
                "relation"
            )  # fmt: skip
            for ref in [refs] if isinstance(refs, int) else refs:
                inside.append(f'<member type="{kind}" ref="{ref}" role="{role}" />')
        return self._element("relation", inside, tags)

    def lanelet(self, left: int, right: int, *rules: int, **tags: str) -> int:
        all_tags = {"type": "lanelet", "subtype": "road", "one_way": "yes", **tags}
        return self.relation(all_tags, left=left, right=right, regulatory_element=rules)

    def rule(self, subtype: str, **members: int | Sequence[int]) -> int:
        return self.relation({"type": "regulatory_element", "subtype": subtype}, **members)

    def text(self) -> str:
        nodes = [f'<node id="{n}" x="{x}" y="{y}" />' for (x, y), n in self.nodes.items()]
        return "\n".join(['<osm version="0.6">', *nodes, *self.parts, "</osm>"])

    def read(self, path: Path) -> list[Lane]:
        path.write_text(self.text())
        return read_lanelet2(path)


def arc(radius_m: float, count: int) -> list[Point]:
    """From (-8, 8 - r) to the north, about (-8, 8): a bound of the left turn of `conftest`."""
    at = np.linspace(0.0, np.pi / 2, count)
    return [(-8.0 + radius_m * np.sin(t), 8.0 - radius_m * np.cos(t)) for t in at]


BOUNDS: dict[str, tuple[list[Point], list[Point]]] = {
    "w": ([(-108, 2), (-30, 2), (-8, 2)], [(-108, -2), (-8, -2)]),
    "we": ([(-8, 2), (8, 2)], [(-8, -2), (1, -2), (8, -2)]),
    "e": ([(8, 2), (158, 2)], [(8, -2), (158, -2)]),
    "s": ([(-2, -108), (-2, -8)], [(2, -108), (2, -70), (2, -8)]),
    "sn": ([(-2, -8), (-2, 8)], [(2, -8), (2, 8)]),
    "n": ([(-2, 8), (-2, 158)], [(2, 8), (2, 158)]),
    "wn": (arc(6.0, 40), arc(10.0, 30)),
}
"""The crossing of `conftest`, its lanes 4 m wide."""


def draw_crossing(
    seed: int | None = None, add: Callable[[Drawing, dict[str, int]], None] | None = None
) -> tuple[Drawing, dict[str, int]]:
    """The crossing and the ids of its lanelets; with a seed, ways run in either direction."""
    drawing, ids = Drawing(), dict[str, int]()
    draw = random.Random(seed)
    for name, sides in BOUNDS.items():
        ways = [
            drawing.way(side if seed is None or draw.random() < 0.5 else side[::-1])
            for side in sides
        ]
        ids[name] = drawing.lanelet(*ways)
    if add is not None:
        add(drawing, ids)
    return drawing, ids


def apart_m(one: FloatArray, other: FloatArray) -> float:
    """The largest distance of a vertex of one polyline from the other."""
    there, back = shapely.LineString(one), shapely.LineString(other)
    return float(there.hausdorff_distance(back))


@pytest.mark.parametrize("seed", [None, 1, 2, 3])
def test_a_crossing_is_read_as_it_was_drawn(tmp_path: Path, seed: int | None) -> None:
    drawing, ids = draw_crossing(seed)
    names = {str(number): name for name, number in ids.items()}
    found = {names[lane.id]: lane for lane in drawing.read(tmp_path / "m.osm_xy")}
    expected = {lane.id: lane for lane in crossing_lanes()}
    assert list(found) == list(BOUNDS)
    for name, lane in found.items():
        assert tuple(names[other] for other in lane.successors) == expected[name].successors
        assert lane.is_connection == expected[name].is_connection
        assert lane.turn == expected[name].turn
        assert apart_m(lane.xy_m, expected[name].xy_m) < 0.02
        assert np.linalg.norm(lane.xy_m[0] - expected[name].xy_m[0]) < 0.02  # and runs the same way
        assert lane.width_m == pytest.approx(4.0, abs=0.01)
        assert lane.gate is Gate.NONE
        assert lane.kinds == ROAD_KINDS
        assert lane.speed_limit_mps == pytest.approx(50 / 3.6)


def gates(tmp_path: Path, add: Callable[[Drawing, dict[str, int]], None]) -> dict[str, Gate]:
    """The lanes with gates, by the names of the drawing."""
    drawing, ids = draw_crossing(add=add)
    names = {str(number): name for name, number in ids.items()}
    lanes = drawing.read(tmp_path / "m.osm_xy")
    return {
        names[re.sub(r"\D", "", lane.id)] + "+" * lane.id.count("+"): lane.gate
        for lane in lanes
        if lane.gate is not Gate.NONE
    }


def line(drawing: Drawing, x_m: float, **tags: str) -> int:
    """A line across the western arm, a little short on one side, long on the other."""
    return drawing.way([(x_m, -2.4), (x_m, 1.8)], **{"type": "stop_line", **tags})


def sign(drawing: Drawing, name: str) -> int:
    return drawing.way([(-8, -4), (-8, -5)], type="traffic_sign", subtype=name)


RULES: dict[str, tuple[Callable[[Drawing, dict[str, int]], object], dict[str, Gate]]] = {
    "all-way stop with lines": (
        lambda d, i: d.rule("all_way_stop", **{"yield": [i["w"]]}, ref_line=[line(d, -8.4)]),
        {"w": Gate.STOP_LINE},
    ),
    "all-way stop without": (
        lambda d, i: d.rule("all_way_stop", **{"yield": [i["w"], i["s"]]}),
        {"w": Gate.STOP_LINE, "s": Gate.STOP_LINE},
    ),
    "give way with a line at the very end": (
        lambda d, i: d.rule(
            "right_of_way", **{"yield": [i["w"]]}, right_of_way=[i["s"]], ref_line=[line(d, -8.0)]
        ),
        {"w": Gate.GIVE_WAY_LINE},
    ),
    "give way, lanelets inside named, line behind their start": (
        lambda d, i: d.rule(
            "right_of_way", **{"yield": [i["we"], i["wn"]]}, ref_line=[line(d, -7.2)]
        ),
        {"w": Gate.GIVE_WAY_LINE},
    ),
    "give way, lanelets inside named, no line": (
        lambda d, i: d.rule("right_of_way", **{"yield": [i["we"], i["wn"]]}),
        {"w": Gate.GIVE_WAY_LINE},
    ),
    "the turn alone gives way: no line across the arm": (
        lambda d, i: d.rule("right_of_way", **{"yield": [i["wn"]]}, right_of_way=[i["sn"]]),
        {},
    ),
    "stop sign": (
        lambda d, i: d.rule(
            "right_of_way", **{"yield": [i["w"]]}, ref_line=line(d, -8.4), refers=sign(d, "usR1-1")
        ),
        {"w": Gate.STOP_LINE},
    ),
    "give-way sign": (
        lambda d, i: d.rule("right_of_way", **{"yield": [i["w"]]}, refers=sign(d, "de205")),
        {"w": Gate.GIVE_WAY_LINE},
    ),
    "a line that misses": (
        lambda d, i: d.rule(
            "right_of_way", **{"yield": [i["w"]]}, ref_line=d.way([(-8, 50), (-8, 54)])
        ),
        {"w": Gate.GIVE_WAY_LINE},
    ),
    "a stop line that no rule names": (lambda d, i: line(d, -8.4), {"w": Gate.STOP_LINE}),
    "a stop line far inside": (lambda d, i: line(d, -30.0), {"w": Gate.STOP_LINE}),
    "a line along the lane is none across it": (
        lambda d, i: d.way([(-40, -1), (-20, 1)], type="stop_line"), {}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RULES)
def test_rules_and_stop_lines_make_gates(tmp_path: Path, name: str) -> None:
    add, expected = RULES[name]
    assert gates(tmp_path, lambda d, i: [add(d, i), None][1]) == expected


def test_rules_of_which_lanelets_speak(tmp_path: Path) -> None:
    drawing = Drawing()
    rules = [
        drawing.rule("traffic_light", refers=sign(drawing, "red_yellow_green")),
        drawing.rule("traffic_sign", refers=sign(drawing, "de206"), ref_line=line(drawing, -8.4)),
        drawing.rule("speed_limit", refers=sign(drawing, "de274-30")),
        drawing.relation(
            {"type": "regulatory_element", "subtype": "speed_limit", "sign_type": "25 mph"}
        ),
        drawing.rule("no_such_rule", refers=sign(drawing, "de283")),
    ]
    ways = [drawing.way(side) for side in BOUNDS["w"]]
    found: list[tuple[Gate, float]] = []
    for rule in rules:
        one = replace_ids(drawing, ways, rule)
        lane = next(iter(one.read(tmp_path / "m.osm_xy")))
        found.append((lane.gate, round(lane.speed_limit_mps, 3)))
    # The stop line itself is in every one of these maps, named by the rule of the second.
    assert found == [
        (Gate.SIGNAL, 13.889),
        (Gate.STOP_LINE, 13.889),
        (Gate.NONE, 8.333),
        (Gate.NONE, 11.176),
        (Gate.NONE, 13.889),
    ]


def replace_ids(drawing: Drawing, ways: Sequence[int], rule: int) -> Drawing:
    """The drawing with one lanelet more, which names a rule."""
    copy = Drawing()
    copy.nodes, copy.parts, copy.count = drawing.nodes, list(drawing.parts), drawing.count
    copy.lanelet(ways[0], ways[1], rule)
    return copy


def test_a_lane_is_cut_at_a_stop_line_inside_it(tmp_path: Path) -> None:
    drawing, ids = draw_crossing(add=lambda d, i: [line(d, -30.0), None][1])
    lanes = {lane.id: lane for lane in drawing.read(tmp_path / "m.osm_xy")}
    name = str(ids["w"])
    assert lanes[name].gate is Gate.STOP_LINE and lanes[name].successors == (f"{name}+",)
    assert np.allclose(lanes[name].xy_m[-1], [-30, 0]) and not lanes[name].is_connection
    behind = lanes[f"{name}+"]
    assert np.allclose(behind.xy_m[0], [-30, 0]) and np.allclose(behind.xy_m[-1], [-8, 0])
    assert behind.successors == (str(ids["we"]), str(ids["wn"])) and behind.gate is Gate.NONE


def test_both_ways_duplicates_areas_and_what_was_deleted(tmp_path: Path) -> None:
    drawing, ids = Drawing(), dict[str, int]()
    for name in ("w", "we", "s"):
        sides = [drawing.way(side) for side in BOUNDS[name]]
        ids[name] = drawing.lanelet(*sides, one_way="no" if name != "s" else "yes")
    drawing.lanelet(*sides)  # the same bounds again
    crosswalk = drawing.lanelet(
        drawing.way([(-5, -6), (-5, 6)]), drawing.way([(-7, -6), (-7, 6)]), subtype="crosswalk"
    )
    drawing.parts[-1] = drawing.parts[-1].replace('<tag k="one_way" v="yes" />', "")
    drawing.relation({"type": "multipolygon", "subtype": "vegetation"}, outer=[4711])
    drawing.parts.append('<relation id="9" action="delete"><tag k="type" v="lanelet" /></relation>')
    lanes = {lane.id: lane for lane in drawing.read(tmp_path / "m.osm_xy")}
    w, we, s, x = (str(k) for k in (ids["w"], ids["we"], ids["s"], crosswalk))
    assert set(lanes) == {w, f"{w}r", we, f"{we}r", s, x, f"{x}r"}
    assert lanes[w].successors == (we,) and lanes[f"{we}r"].successors == (f"{w}r",)
    assert lanes[we].successors == () and lanes[f"{w}r"].successors == ()
    assert np.array_equal(lanes[f"{we}r"].xy_m, lanes[we].xy_m[::-1])
    assert lanes[x].kinds == {Kind.PEDESTRIAN} and lanes[x].speed_limit_mps < 2
    # That it crosses the road makes no junction of the road.
    assert not any(lane.is_connection for lane in lanes.values())


FAULTS: dict[str, tuple[Callable[[str], str], str]] = {
    "no lanelets": (
        lambda t: t.replace('v="lanelet"', 'v="line"'),
        r"expected lanelets .*, found none among 7 relations and 14 ways; give a Lanelet2 map",
    ),
    "missing way": (
        lambda t: re.sub(r'<way id="101".*\n', "", t),
        "lanelet 103 names way 101, which is not in the map; the file is cut off or was cut out",
    ),
    "missing node": (
        lambda t: re.sub(r'<node id="1003".*\n', "", t),
        "way 102 names node 1003, which is not in the map; ",
    ),
    "missing rule": (
        lambda t: t.replace(
            '<member type="way" ref="101"',
            '<member type="relation" ref="77" role="regulatory_element" />'
            '<member type="way" ref="101"',
        ),
        "lanelet 103 names regulatory element 77, which is not in the map; ",
    ),
    "missing line": (
        lambda t: t.replace(
            "</osm>",
            '<relation id="9"><member type="way" ref="8" role="ref_line" />'
            '<tag k="type" v="regulatory_element" /></relation></osm>',
        ),
        "regulatory element 9 names way 8 as its line, which is not in the map; ",
    ),
    "no left": (
        lambda t: t.replace('ref="101" role="left"', 'ref="101" role="lefft"'),
        "lanelet 103: expected one left bound, found 0; correct the map",
    ),
    "two rights": (
        lambda t: t.replace('ref="101" role="left"', 'ref="101" role="right"'),
        "lanelet 103: expected one left bound, found 0; ",
    ),
    "a point": (
        lambda t: t.replace('<nd ref="1001" /><nd ref="1002" />', ""),
        "lanelet 103: its left bound, way 101, has no length; correct the map",
    ),
    "no number": (
        lambda t: t.replace('x="-108', 'x="west', 1),
        "node 1000: expected numbers in x and y, found 'west' and '2'; correct the map",
    ),
    "nowhere": (
        lambda t: t.replace(' x="', ' lon="').replace(' y="', ' lat="'),
        "node 10..: expected a place near latitude and longitude 0, .* shift the map",
    ),
    "SUMO's net": (lambda t: t.replace("osm", "net"), "expected a Lanelet2 map .*, found <net>; "),
    "entities": (
        lambda t: '<!DOCTYPE osm [<!ENTITY a "b">]>' + t,
        "expected XML without a document type, found <!DOCTYPE",
    ),
    "cut off": (lambda t: t[:1500], "not well-formed XML"),
    "empty": (lambda t: "", "not well-formed XML: no element found"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_one_clear_line(tmp_path: Path, fault: str) -> None:
    change, expected = FAULTS[fault]
    drawing, _ = draw_crossing()
    path = tmp_path / "m.osm"
    path.write_text(change(drawing.text()))
    with pytest.raises(InputError, match=expected) as error:
        read_lanelet2(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


def test_degrees_become_metres_as_in_the_data_set(tmp_path: Path) -> None:
    """The data set's own test scene: cars at y = 2.5 m and 5.5 m drive in the middle of these."""
    lat = ("0.00000903483", "0.00003613932", "0.00006324382")
    lon = ("0.00000897435", "0.00090640957")
    nodes = "".join(
        f'<node id="{10 * k + j}" visible="true" version="1" lat="{a}" lon="{b}" />'
        for k, a in enumerate(lat)
        for j, b in enumerate(lon)
    )
    ways = "".join(
        f'<way id="{k + 100}"><nd ref="{10 * k}" /><nd ref="{10 * k + 1}" /></way>'
        for k in range(3)
    )
    lanelets = "".join(
        f'<relation id="{200 + k}"><member type="way" ref="101" role="left" />'
        f'<member type="way" ref="{right}" role="right" /><tag k="type" v="lanelet" /></relation>'
        for k, right in enumerate((100, 102))
    )
    path = tmp_path / "m.osm"
    path.write_text(f"<osm>{nodes}{ways}{lanelets}</osm>")
    east, west = read_lanelet2(path)
    assert np.allclose(east.xy_m[[0, -1]], [[1, 2.5], [101, 2.5]], atol=1e-5)
    assert np.allclose(west.xy_m[[0, -1]], [[101, 5.5], [1, 5.5]], atol=1e-5)


def test_speeds_with_units() -> None:
    said = {
        "50": 50 / 3.6,
        "50 km/h": 50 / 3.6,
        "25mph": 11.176,
        "13.9 m/s": 13.9,
        "30 KMH": 30 / 3.6,
    }
    assert {text: speed_mps(text) for text in said} == pytest.approx(said)
    assert [speed_mps(text) for text in ("", "fast", "50 knots", "-3")] == [None] * 4


# ---------------------------------------------------------------------------------------------
# Lanelet2's own library as the second opinion


def load(path: Path) -> Any:
    """The map as Lanelet2 reads it, without a fault."""
    import lanelet2

    projector = lanelet2.projection.UtmProjector(lanelet2.io.Origin(0, 0))
    found, faults = lanelet2.io.loadRobust(str(path), projector)
    assert list(faults) == []
    return found


def points(line: Any) -> FloatArray:
    return np.array([(point.x, point.y) for point in line])


@needs_lanelet2
@pytest.mark.parametrize("seed", [1, 2])
def test_lanelet2_agrees_on_directions_successors_and_middles(tmp_path: Path, seed: int) -> None:
    import lanelet2

    draw = random.Random(seed)
    text = SAMPLE.read_text(encoding="utf-8")
    text = re.sub(r".*(centerline|turn_direction|hatn_sim:lane).*\n", "", text)
    # Ways run in either direction.
    text = re.sub(
        r'((?: +<nd ref="\d+"/>\n)+)',
        lambda m: m[1] if draw.random() < 0.5 else "".join(reversed(m[1].splitlines(True))),
        text,
    )
    path = tmp_path / "map.osm"
    path.write_text(text, encoding="utf-8")
    lanes = {lane.id: lane for lane in read_lanelet2(path)}
    theirs = load(path)
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.VehicleCar
    )
    graph = lanelet2.routing.RoutingGraph(theirs, rules)
    lanelets = list(theirs.laneletLayer)
    assert len(lanelets) == len(lanes) == 13
    for lanelet in lanelets:
        lane = lanes[str(lanelet.id)]
        following = {str(other.id) for other in graph.following(lanelet)}
        assert set(lane.successors) == following
        start = (points(lanelet.leftBound)[0] + points(lanelet.rightBound)[0]) / 2
        assert np.linalg.norm(lane.xy_m[0] - start) < 1e-3
        # Theirs cuts corners by some decimetres.
        assert apart_m(lane.xy_m, points(lanelet.centerline)) < 0.4
        limit = rules.speedLimit(lanelet).speedLimit / 3.6
        assert lane.speed_limit_mps == pytest.approx(limit)


@needs_lanelet2
@pytest.mark.parametrize(
    "tags",
    [
        {"subtype": "road", "location": "urban"},
        {"subtype": "road", "location": "nonurban"},
        {"subtype": "highway", "location": "nonurban"},
        {"subtype": "bicycle_lane"},
        {"subtype": "bus_lane"},
        {"subtype": "walkway"},
        {"subtype": "shared_walkway"},
        {"subtype": "crosswalk"},
        {"subtype": "play_street"},
        {"subtype": "road", "participant:pedestrian": "yes"},
        {"subtype": "walkway", "participant:vehicle": "yes", "participant:bicycle": "no"},
        {"subtype": "road", "participant:vehicle:bus": "yes"},
        {"subtype": "road", "speed_limit": "30 mph"},
    ],
)
def test_lanelet2_agrees_on_who_may_drive(tmp_path: Path, tags: dict[str, str]) -> None:
    import lanelet2

    rows = "".join(f'<tag k="{k}" v="{v}" />' for k, v in {"type": "lanelet", **tags}.items())
    nodes = "".join(
        f'<node id="{k}" lat="{0.0001 * (k // 2)}" lon="{0.001 * (k % 2)}" />' for k in range(4)
    )
    path = tmp_path / "m.osm"
    path.write_text(
        f'<osm>{nodes}<way id="8"><nd ref="2" /><nd ref="3" /></way><way id="9"><nd ref="0" />'
        '<nd ref="1" /></way><relation id="10"><member type="way" ref="8" role="left" />'
        f'<member type="way" ref="9" role="right" />{rows}</relation></osm>'
    )
    lane = read_lanelet2(path)[0]
    lanelet = next(iter(load(path).laneletLayer))
    participants = lanelet2.traffic_rules.Participants
    for kind, participant in (
        (Kind.CAR, participants.VehicleCar),
        (Kind.LORRY, participants.VehicleTruck),
        (Kind.BUS, participants.VehicleBus),
        (Kind.BICYCLE, participants.Bicycle),
        (Kind.PEDESTRIAN, participants.Pedestrian),
    ):
        rules = lanelet2.traffic_rules.create(lanelet2.traffic_rules.Locations.Germany, participant)
        assert (kind in lane.kinds) == rules.canPass(lanelet), participant
        is_road = tags["subtype"] in ("road", "highway")
        if kind is Kind.CAR and Kind.CAR in lane.kinds and is_road:
            limit = rules.speedLimit(lanelet).speedLimit / 3.6
            assert lane.speed_limit_mps == pytest.approx(limit, rel=1e-3)


# ---------------------------------------------------------------------------------------------
# Written maps


def test_lanes_come_back_from_a_written_map(tmp_path: Path) -> None:
    lanes = crossing_lanes(angle_rad=0.3, shift_m=(900.0, -200.0))
    looks = [
        {"gate": Gate.STOP_LINE, "kinds": frozenset(Kind)},
        {"kinds": MOTOR, "speed_limit_mps": 7.77},
        {"kinds": frozenset({Kind.TRAM}), "id": '"<&> :e_0'},
        {"gate": Gate.GIVE_WAY_LINE, "kinds": ROAD_KINDS, "width_m": 4.1},
        {"kinds": frozenset({Kind.CAR, Kind.BUS, Kind.OTHER})},
        {"gate": Gate.SIGNAL, "kinds": frozenset({Kind.PEDESTRIAN})},
        {"kinds": frozenset[Kind]()},
    ]
    lanes = [replace(lane, **look) for lane, look in zip(lanes, looks, strict=True)]  # type: ignore[arg-type]
    lanes[1] = replace(lanes[1], successors=(lanes[2].id,))
    path = tmp_path / "map.osm"
    write_lanelet2(path, lanes)
    back = read_lanelet2(path)
    assert [lane.id for lane in back] == [lane.id for lane in lanes]
    by_id = {lane.id: lane for lane in back}
    for lane, other in zip(lanes, back, strict=True):
        shared = tuple(n for n in lane.successors if by_id[n].kinds & lane.kinds)
        assert other.successors == shared
        assert (other.kinds, other.gate) == (lane.kinds, lane.gate)
        assert (other.is_connection, other.turn) == (lane.is_connection, lane.turn)
        assert other.speed_limit_mps == pytest.approx(lane.speed_limit_mps, rel=1e-12)
        assert other.xy_m.shape == lane.xy_m.shape
        assert np.abs(other.xy_m - lane.xy_m).max() < 1e-4
    if sys.platform == "linux":
        theirs = load(path)
        assert len(theirs.laneletLayer) == 7 and len(theirs.regulatoryElementLayer) == 3


def test_a_lane_without_length_is_bridged(tmp_path: Path) -> None:
    lanes = {lane.id: lane for lane in crossing_lanes()}
    point = replace(
        lanes["we"], id="point", xy_m=np.array([[-8.0, 0.0], [-7.9, 0.0]]), successors=("we",)
    )
    lanes["w"] = replace(lanes["w"], successors=("point", "wn"))
    path = tmp_path / "map.osm"
    write_lanelet2(path, [*lanes.values(), point])
    back = {lane.id: lane for lane in read_lanelet2(path)}
    assert set(back) == set(lanes) and set(back["w"].successors) == {"we", "wn"}


def test_lanes_to_turn_around_are_wider_than_long_and_come_back(tmp_path: Path) -> None:
    """The bounds of such a lane cross: its centre line says which way it is driven."""
    # Two lanes side by side, against each other, and the way around at the end of the first.
    out, back = [(0.0, 0.0), (50.0, 0.0)], [(50.0, 1.5), (0.0, 1.5)]
    around = [(50.0, 0.0), (50.6, 0.4), (50.6, 1.1), (50.0, 1.5)]
    lanes = [
        drawn("out", out, "around"),
        drawn("around", around, "back", is_connection=True, turn=1),
        drawn("back", back),
    ]
    path = tmp_path / "map.osm"
    write_lanelet2(path, lanes)
    read = {one.id: one for one in read_lanelet2(path)}
    assert {name: one.successors for name, one in read.items()} == {
        "out": ("around",),
        "around": ("back",),
        "back": (),
    }
    np.testing.assert_allclose(read["around"].xy_m[[0, -1]], around[::3], atol=1e-3)
