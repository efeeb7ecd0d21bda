"""SUMO nets built from lanes, held against the lanes and against SUMO's own reading of them."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import crossing_lanes, lane

from hatn_sim import cli
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Gate, Kind, Lane
from hatn_sim.errors import InputError
from hatn_sim.log.road_file import write_road
from hatn_sim.recordings.sumo_net import export
from hatn_sim.recordings.sumo_net.check import check_net
from hatn_sim.recordings.sumo_net.cut import cut_long
from hatn_sim.recordings.sumo_net.export import write_net
from hatn_sim.recordings.sumo_net.plan import plan_net
from hatn_sim.simulators.sumo_net import read_net

SCENES = ("intersection4_allway", "intersection5", "roundabout4_two_lane", "roundabout8")


def net_of(scene: str) -> Path:
    return load_scenario(scene).config_path.with_name(f"{scene}.net.xml")


def junction_types(path: Path) -> dict[str, str]:
    root = ElementTree.parse(path).getroot()
    return {
        element.attrib["id"]: element.attrib["type"]
        for element in root.iter("junction")
        if element.attrib["type"] not in ("dead_end", "internal")
    }


@pytest.mark.parametrize("scene", SCENES)
def test_a_net_built_from_a_scenes_lanes_is_the_scenes(scene: str, tmp_path: Path) -> None:
    given = read_net(net_of(scene))
    path = tmp_path / "built.net.xml"
    check = check_net(given, write_net(given, path), read_net(path))
    assert check.lanes == len(given)
    assert check.distance_m_median < 0.01 and check.distance_m_p99 < 0.05
    assert check.distance_m_max < 0.1
    assert check.successors_kept == check.successors >= len(given) - 20
    original = ElementTree.parse(net_of(scene)).getroot()
    built = ElementTree.parse(path).getroot()
    normal = [
        {edge.attrib["id"] for edge in root.iter("edge") if edge.get("function") != "internal"}
        for root in (original, built)
    ]
    assert len(normal[0]) == len(normal[1])
    location = built.find("location")
    assert location is not None and location.attrib["netOffset"] in ("0.000,0.000", "0.00,0.00")
    # Those who give way in the one net do so in the other.
    ways = [
        sorted(
            connection.attrib["state"]
            for connection in root.iter("connection")
            if "via" in connection.attrib and not connection.attrib["from"].startswith(":")
        )
        for root in (original, built)
    ]
    assert ways[0] == ways[1]


def test_a_crossing_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "crossing.net.xml.gz"
    lanes = crossing_lanes(shift_m=(5000.0, -300.0))
    plan = write_net(lanes, path)
    assert {edge.id for edge in plan.edges} == {"w", "e", "s", "n"}
    assert len(plan.nodes) == 5
    assert {(c.source[0], c.target[0]) for c in plan.connections} == {
        ("w", "e"),
        ("w", "n"),
        ("s", "n"),
    }
    built = {one.id: one for one in read_net(path)}
    west = built["w_0"]
    np.testing.assert_allclose(west.xy_m[[0, -1]], [[4892, -300], [4992, -300]], atol=0.002)
    assert west.width_m == pytest.approx(3.2) and west.speed_limit_mps == pytest.approx(13.9)
    assert west.gate is Gate.STOP_LINE and built["s_0"].gate is Gate.NONE
    assert {built[name].turn for name in west.successors} == {0, 1}


def test_lanes_side_by_side_are_one_edge_and_a_chain_is_one_lane() -> None:
    lanes = [
        lane("left", [(0, 3.2), (60, 3.2)], "left2"),
        lane("left2", [(60, 3.2), (120, 3.2)]),
        lane("right", [(0, 0), (120, 0)]),
        lane("oncoming", [(120, 6.4), (0, 6.4)]),
        lane("path", [(0, -3), (120, -3)]),
    ]
    lanes[-1] = Lane(**{**lanes[-1].__dict__, "kinds": frozenset({Kind.PEDESTRIAN})})
    plan = plan_net(lanes)
    assert [[chain.given for chain in edge.lanes] for edge in plan.edges] == [
        [("right",), ("left", "left2")],
        [("oncoming",)],
    ]
    assert plan.connections == ()


def test_a_long_slip_road_is_inside_the_junction_only_where_it_merges(tmp_path: Path) -> None:
    slip = [(-100.0, -20.0), (-20.0, -4.0), (0.0, 0.0)]
    lanes = [
        lane("main", [(-150, 0), (-100, 0)], "through"),
        lane("through", [(-100, 0), (0, 0)], "on", is_connection=True),
        lane("ramp", [(-150, -30), (-100, -20)], "slip"),
        lane("slip", slip, "on", is_connection=True),
        lane("on", [(0, 0), (100, 0)]),
    ]
    cut = cut_long({one.id: one for one in lanes})
    assert list(cut) == ["main", "through", "through~1", "ramp", "slip", "slip~1", "on"]
    assert not cut["slip"].is_connection and cut["slip~1"].is_connection
    assert cut["slip"].successors == ("slip~1",) and cut["slip~1"].successors == ("on",)
    np.testing.assert_allclose(cut["slip"].xy_m[-1], cut["slip~1"].xy_m[0])
    # Two metres apart 10 m before they meet, for a slope of one in five; and the margin.
    assert cut["slip~1"].xy_m[0, 0] == pytest.approx(-14.0, abs=1.5)
    path = tmp_path / "merge.net.xml"
    check = check_net(lanes, write_net(lanes, path), read_net(path))
    assert check.successors_kept == check.successors == 6
    assert check.distance_m_max < 0.01
    assert list(junction_types(path).values()) == ["priority"]


def test_right_of_way_follows_the_gates() -> None:
    def arms(*gates: Gate) -> list[Lane]:
        lanes: list[Lane] = []
        for number, gate in enumerate(gates):
            angle = np.pi / 2 * number
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

            def at(points: list[tuple[float, float]], turn: np.ndarray = turn) -> list[object]:
                return (np.array(points) @ turn).tolist()

            into = lane(f"in{number}", at([(-80, -2), (-9, -2)]), f"x{number}", gate=gate)  # type: ignore[arg-type]
            over = lane(f"x{number}", at([(-9, -2), (9, -2)]), f"out{number}", is_connection=True)  # type: ignore[arg-type]
            lanes += [into, over, lane(f"out{number}", at([(9, -2), (80, -2)]))]  # type: ignore[arg-type]
        return lanes

    def type_of(*gates: Gate) -> str:
        (kind,) = {node.type for node in plan_net(arms(*gates)).nodes if len(node.shape_m) > 4}
        return kind

    none, stop, give = Gate.NONE, Gate.STOP_LINE, Gate.GIVE_WAY_LINE
    assert type_of(stop, stop, stop, stop) == "allway_stop"
    assert type_of(none, stop, none, stop) == "priority_stop"
    assert type_of(none, give, none, give) == "priority"
    assert type_of(none, none, none, none) == "right_before_left"
    assert type_of(Gate.SIGNAL, none, none, none) == "traffic_light"
    plan = plan_net(arms(none, give, none, give))
    assert {edge.id: edge.has_right_of_way for edge in plan.edges if edge.id[0] == "i"} == {
        "in0": True,
        "in1": False,
        "in2": True,
        "in3": False,
    }


def test_the_command_tells_how_true_the_net_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    road = tmp_path / "road.json.gz"
    write_road(road, crossing_lanes())
    out = tmp_path / "made" / "place.net.xml"
    assert cli.main(["net", str(road), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "4 edges, 5 junctions and 3 connections from 7 lanes" in told
    assert "successors kept: 6 of 6 (100.0 %)" in told
    assert cli.main(["net", str(road), "--out", str(out), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["successors_kept"] == 6 and figures["distance_m_max"] < 0.01


def test_what_is_asked_wrongly_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    road = tmp_path / "road.json.gz"
    write_road(road, crossing_lanes())

    def said(*words: str) -> str:
        assert cli.main(["net", *words]) == 2
        text = capsys.readouterr().err
        assert text.count("\n") == 1
        return text

    assert "ends in .net.xml" in said(str(road), "--out", str(tmp_path / "x.xml"))
    assert "cannot be written" in said(str(road), "--out", str(road / "x.net.xml"))
    write_road(road, [])
    assert "found none" in said(str(road), "--out", str(tmp_path / "x.net.xml"))
    monkeypatch.setattr(export.shutil, "which", lambda *_: None)
    write_road(road, crossing_lanes())
    assert "pip install 'hatn-sim[gui]'" in said(str(road), "--out", str(tmp_path / "x.net.xml"))
    with pytest.raises(InputError, match="no lane for vehicles"):
        write_net([], tmp_path / "x.net.xml")
