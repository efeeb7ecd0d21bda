"""Runs made up for tests of the page: two cars at a crossing, with advice, an alert and events."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from conftest import lane

from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
    Advice,
    Alert,
    Frame,
    Gate,
    Prediction,
    Scene,
    Suggestion,
    Truth,
)
from hatn_sim.graph import build_graphs
from hatn_sim.log import RunWriter
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road

FRAMES = 150
SPEED_MPS = 8.0
FIRST_S = 100.0
ALERT_FRAMES = (30, 45)
COLLISION_FRAME = 60
NAMES = ("eastbound", "northbound")
HOSTILE = (
    "</script><img src=x onerror=alert(1)>",
    '"><svg onload=alert(2)>\u2028\u2029<!-- ]]> é',
)
CROSSING = [
    lane("east", [(-80.0, 0.0), (0.0, 0.0), (160.0, 0.0)]),
    lane("north", [(0.0, -80.0), (0.0, 0.0), (0.0, 160.0)], gate=Gate.GIVE_WAY_LINE),
]


def scene_at(frame: int, names: Sequence[str]) -> Scene:
    """Both go straight on; the first name is eastbound and gets there first."""
    count = len(names)
    along = np.array([-20.0, -36.0])[:count] + SPEED_MPS * DT_S * frame
    east = np.arange(count) == 0
    return Scene(
        time_s=FIRST_S + DT_S * frame,
        ids=tuple(names),
        xy_m=np.stack((np.where(east, along, 0.0), np.where(east, 0.0, along)), axis=1),
        yaw_rad=np.where(east, 0.0, 0.5 * np.pi),
        speed_mps=np.full(count, SPEED_MPS),
        size_m=np.tile([4.0, 1.8], (count, 1)),
        kind=np.zeros(count, dtype=np.int64),
        colour=np.array([(30, 200, 60), (210, 40, 40)][:count], dtype=np.int64).reshape(-1, 3),
        blinker=np.zeros(count, dtype=np.int64),
        signal_closed=np.zeros(0, dtype=bool),
    )


def made_up_run(
    out: Path,
    frames: int = FRAMES,
    names: Sequence[str] = NAMES,
    finished: bool = True,
    words: str = "Pass before northbound",
) -> Path:
    """Write the log of such a run, in which the first is told `words`; returns its folder."""
    command = f"hatn-sim run crossing --drive '{names[0] if names else ''}'"
    head = {"scene": "crossing", "title": " ".join(names) or "empty", "command": command}
    writer = RunWriter(out, head | {"settings": {"lines": "inferred", "drive": list(names)}})
    state = begin(Road(CROSSING))
    for frame in range(frames):
        scene = scene_at(frame, names)
        state = perceive(state, scene, None)
        graphs = build_graphs(state.road, state.seen)
        ahead_m = SPEED_MPS * DT_S * np.arange(1, HORIZON_FRAMES + 1)
        heading = np.stack((np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)), axis=1)
        straight = scene.xy_m[:, None] + heading[:, None] * ahead_m[:, None]
        slower = scene.xy_m[:, None] + heading[:, None] * 0.5 * ahead_m[:, None]
        chance = np.zeros(graphs.node_mask.shape)
        chance[:, 0], chance[:, 1:2] = 0.2, 0.8
        prediction = Prediction(
            ids=scene.ids,
            xy_m=np.stack((straight, slower), axis=1),
            mode_probability=np.tile([0.75, 0.25], (len(names), 1)),
            fallback=np.zeros(len(names), dtype=bool),
            adapted=np.zeros(len(names), dtype=bool),
            lines=state.seen.lines,
            graphs=graphs,
            slot_probability=np.where(graphs.has_conflict[:, None], chance, 0.0),
        )
        crash = ((names[0], names[1]),) if names and frame == COLLISION_FRAME else ()
        truth = Truth((None,) * len(names), collisions=crash)
        advice = Advice(prediction, *_told(frame, scene, names, words))
        writer.write(frame, Frame(scene, truth, False), {"made_up": advice})
    writer.close(finished=finished)
    write_road(out / ROAD_FILE, CROSSING)
    return out


def hostile_run(out: Path) -> Path:
    """The same run; names, title and command hold markup."""
    return made_up_run(out, names=HOSTILE)


def _told(
    frame: int, scene: Scene, names: Sequence[str], words: str
) -> tuple[tuple[Suggestion, ...], tuple[Alert, ...]]:
    if not names:
        return (), ()
    said = Suggestion(
        names[0], scene.time_s, "pass", names[1], 0.8, 0.6, None, SPEED_MPS, True,
        words, (SPEED_MPS,) * 50, "likely",
    )  # fmt: skip
    edges = {ALERT_FRAMES[0]: ("onset",), ALERT_FRAMES[1]: ("peak", "end")}.get(frame, ())
    alerts = tuple(
        Alert("a1", edge, "CONFLICT", scene.time_s, names[0], names[1], 0.5, f"near {names[1]}")
        for edge in edges
    )
    return (said,), alerts
