"""Advice at signals, in SUMO's own traffic: held against what only the simulator knows."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hatn_sim import cli
from hatn_sim.datatypes import Lane, Route, Scene
from hatn_sim.log import read_run

FROM_S, FOR_S = 20, 40
NEAR_M = 40.0
QUICK = ("--quiet", "--no-picture")


def stands_at_red(lanes: dict[str, Lane], route: Route, scene: Scene, vehicle: int) -> bool:
    """By the route that it is on: it stands before the end of a lane whose link is closed."""
    yaw_rad = scene.yaw_rad[vehicle]
    heading = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    for name, following in pairwise(route):
        link = (lanes[name].signals or {}).get(following)
        away_m = float((lanes[name].xy_m[-1] - scene.xy_m[vehicle]) @ heading)
        if link is not None and scene.signal_closed[link] and 0.0 < away_m < NEAR_M:
            return float(scene.speed_mps[vehicle]) < 0.1
    return False


def test_nobody_is_told_of_one_who_stands_at_a_red_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["run", "learn_signals4", "--seed", "9501", "--lines", "route"]
    words += ["--warm-up", str(FROM_S), "--duration", str(FOR_S), "--out", "run"]
    assert cli.main([*words, *QUICK]) == 0
    run = read_run(Path("run"))
    lanes = {lane.id: lane for lane in run.lanes}
    said, stood = 0, 0
    for number, frame in enumerate(run.frames()):
        scene = frame.scene
        at_red = {
            name
            for v, (name, route) in enumerate(zip(scene.ids, frame.truth.routes, strict=True))
            if route is not None and stands_at_red(lanes, route, scene, v)
        }
        stood += len(at_red)
        for change in run.suggestions:
            if change.frame == number and change.suggestion is not None:
                said += 1
                assert at_red.isdisjoint((change.ego_id, change.suggestion.slot_id))
    assert said > 5 and stood > 300
