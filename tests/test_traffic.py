"""Figures of traffic: counted by hand, and against SUMO's own record of the same run."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from conftest import scene_of

from hatn_sim.commands import scenarios
from hatn_sim.commands.scenarios import Stretch, measure
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame, Truth
from hatn_sim.score.traffic import (
    TrafficCount,
    count_traffic,
    density_figures,
    read_delays_s,
    risk_figures,
)
from hatn_sim.simulators.sumo import SumoSimulator


def frame(speeds_mps: dict[str, float], **truth: tuple[object, ...]) -> Frame:
    scene = scene_of(0.0, {name: (0.0, 0.0, 0.0, speed) for name, speed in speeds_mps.items()})
    nowhere = (None,) * len(speeds_mps)
    return Frame(scene, Truth(nowhere, **truth), done=False)  # type: ignore[arg-type]


def test_by_hand() -> None:
    frames = [
        frame({"a": 10.0, "b": 0.0}, collisions=(("a", "b"), ("b", "c"))),
        frame({"a": 9.0, "b": 0.0, "c": 5.0}, arrived=("d",)),  # a brakes at 10
        frame({"a": 8.0, "b": 0.0, "c": 4.56}, emergency_braking=("a",)),  # c at 4.4
        frame({"c": 4.11}, arrived=("a", "b"), collisions=(("a", "b"),)),  # c at 4.5
    ]
    count = count_traffic(frame({"a": 10.0}, collisions=(("b", "c"),)), frames, dt_s=0.1)
    assert count == TrafficCount(
        seconds=pytest.approx(0.4),
        frames=4,
        vehicle_frames=9,
        speed_sum_mps=pytest.approx(10 + 14 + 12.56 + 4.11),
        arrived=3,
        collisions=2,  # a and b twice; b and c were touching before
        emergency_brakings=1,
        hard_brakings=2,
    )
    whole = count.with_delays([1.0, 2.0, 6.0])
    assert density_figures(whole) == {
        "vehicles_at_once": 2.25,
        "throughput_per_h": pytest.approx(27000.0),
        "mean_speed_mps": pytest.approx(40.67 / 9),
        "mean_delay_s": 3.0,
    }
    assert risk_figures(whole) == {
        "collisions_per_1000": pytest.approx(2000 / 3),
        "emergency_brakings_per_1000": pytest.approx(1000 / 3),
        "hard_brakings_per_1000": pytest.approx(2000 / 3),
    }
    # Counts add up, figures then are those of all vehicles.
    assert density_figures(whole + whole)["mean_delay_s"] == 3.0
    assert (whole + TrafficCount()) == whole


def test_appearing_and_teleporting_are_no_braking() -> None:
    frames = [
        frame({"a": 0.0, "b": 20.0}, teleported=("a",)),
        frame({"b": 20.0}),
        frame({"a": 0.0, "b": 20.0}),
    ]
    assert count_traffic(frame({"a": 20.0}), frames, 0.1).hard_brakings == 0


def test_nothing_there() -> None:
    assert set(density_figures(TrafficCount()).values()) == {None}
    assert set(risk_figures(TrafficCount()).values()) == {None}
    empty = count_traffic(frame({}), [frame({})], 0.1)
    assert density_figures(empty) == {
        "vehicles_at_once": 0.0,
        "throughput_per_h": 0.0,
        "mean_speed_mps": None,
        "mean_delay_s": None,
    }


def test_against_the_record_that_sumo_keeps(tmp_path: Path) -> None:
    outputs = {name: tmp_path / f"{name}.xml" for name in ("tripinfo", "statistic", "summary")}
    words = [word for name, path in outputs.items() for word in (f"--{name}-output", str(path))]
    scenario = load_scenario("intersection5", risk="inattentive")
    with SumoSimulator(scenario, (*words, "--log", str(tmp_path / "log"))) as simulator:
        before = simulator.reset(1)
        count = count_traffic(before, (simulator.step() for _ in range(4000)), 0.1)
    count = count.with_delays(read_delays_s(outputs["tripinfo"], 0.0))

    statistics = ElementTree.parse(outputs["statistic"]).getroot()
    trips = statistics.find("vehicleTripStatistics")
    assert trips is not None and count.arrived > 50
    assert count.arrived == count.delays == int(trips.attrib["count"])
    figures = density_figures(count)
    assert figures["mean_delay_s"] == pytest.approx(float(trips.attrib["timeLoss"]), abs=0.006)
    steps = [step.attrib for step in ElementTree.parse(outputs["summary"]).getroot()]
    assert sum(int(step["running"]) for step in steps) == count.vehicle_frames

    log = (tmp_path / "log").read_text()
    emergencies = set(re.findall(r"Vehicle '(\S+)' performs emergency braking", log))
    assert count.emergency_brakings == len(emergencies) > 3
    pairs = re.findall(r"Vehicle '(\S+)'; junction collision with vehicle '(\S+)',", log)
    assert count.collisions == len({frozenset(pair) for pair in pairs}) > 0
    assert count.hard_brakings >= count.emergency_brakings


def test_a_stretch_leaves_the_build_up_out(monkeypatch: pytest.MonkeyPatch) -> None:
    stretch = Stretch("tjunction", "normal", "courteous", seed=1, duration_s=60.0)
    monkeypatch.setattr(scenarios, "WARM_UP_S", 0.0)
    from_begin = measure(stretch)
    monkeypatch.setattr(scenarios, "WARM_UP_S", 60.0)
    after = measure(stretch)
    both = measure(replace(stretch, duration_s=120.0))
    assert from_begin.frames == after.frames == 600
    assert from_begin.vehicle_frames < after.vehicle_frames
    assert after.arrived == after.delays > from_begin.arrived
    assert both.frames == 1200
    monkeypatch.setattr(scenarios, "WARM_UP_S", 0.0)
    whole = measure(replace(stretch, duration_s=120.0))
    parts = from_begin + after
    assert (whole.arrived, whole.vehicle_frames) == (parts.arrived, parts.vehicle_frames)
    assert whole.delay_sum_s == pytest.approx(parts.delay_sum_s)
