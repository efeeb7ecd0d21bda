"""Following TTC and DRAC against SUMO's own record of surrogate safety measures (SSM device)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from hatn_sim.assist.pairs import FOLLOW, pairs_of
from hatn_sim.assist.risk import deceleration_to_avoid_mps2, time_to_collision_s
from hatn_sim.config import load_scenario
from hatn_sim.perception import begin, perceive
from hatn_sim.simulators.sumo import SumoSimulator

FOLLOWS = ("2", "3")
"""SUMO's types of an encounter on one lane: the ego follows, or leads."""
CONFIG = """<configuration>
  <input><net-file value="{net}"/><route-files value="{routes}"/>
    <additional-files value="{drivers}"/></input>
  <ssm_device><device.ssm.probability value="1"/><device.ssm.measures value="TTC DRAC"/>
    <device.ssm.thresholds value="30 0.05"/><device.ssm.file value="{out}"/></ssm_device>
</configuration>
"""


def test_following_is_measured_as_sumo_does(tmp_path: Path) -> None:
    scene = load_scenario("tjunction")
    folder = scene.config_path.parent
    config, out = tmp_path / "ssm.sumocfg", tmp_path / "ssm.xml"
    config.write_text(
        CONFIG.format(
            net=folder / "tjunction.net.xml",
            routes=folder / "tjunction.rou.xml",
            drivers=scene.driver_path,
            out=out,
        )
    )
    ours: dict[tuple[float, str, str], tuple[float, float]] = {}
    with SumoSimulator(load_scenario(str(config))) as simulator:
        frame, state = simulator.reset(301), begin(simulator.road)
        for _ in range(1000):
            frame = simulator.step()
            state = perceive(state, frame.scene, None)
            seen, speed = state.seen, frame.scene.speed_mps
            pairs = pairs_of(state.road, seen.scene, seen.lines, seen.leader, seen.leader_s_m)
            ttc = time_to_collision_s(pairs, speed)
            drac = deceleration_to_avoid_mps2(pairs, speed, np.zeros_like(pairs.room_m))[:, 1]
            for q in np.flatnonzero(pairs.type == FOLLOW).tolist():
                leader, follower = (frame.scene.ids[v] for v in pairs.index[q])
                key = (round(frame.scene.time_s, 1), follower, leader)
                ours[key] = float(ttc[q]), float(drac[q])
    found: list[tuple[float, float]] = []
    for conflict in ElementTree.parse(out).getroot().iter("conflict"):
        for place, name in enumerate(("minTTC", "maxDRAC")):
            value = conflict.find(name)
            if value is None or value.get("type") not in FOLLOWS:
                continue
            pair = (conflict.get("ego"), conflict.get("foe"))
            follower, leader = pair if value.get("type") == "2" else pair[::-1]
            key = (round(float(value.get("time") or "nan"), 1), str(follower), str(leader))
            if key in ours:
                found.append((ours[key][place], float(value.get("value") or "nan")))
    measured, sumo = np.array(found).T
    assert len(found) >= 20
    # In bends a gap along lanes is not quite one between outlines.
    np.testing.assert_allclose(measured, sumo, rtol=0.15, atol=0.01)
    assert np.median(np.abs(measured - sumo) / sumo) < 0.05
