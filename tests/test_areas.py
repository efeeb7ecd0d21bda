"""Areas of conflict against outlines that are driven along the lines, step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of

from hatn_sim.assist.areas import areas_m
from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.datatypes import ConflictType, FloatArray
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road

DOWN = -np.pi / 2


def way(road: Road, line: int, s_m: FloatArray, length_m: float) -> Boxes:
    """The outlines of a body whose bumpers are on a line, its middle at [X]."""
    which, none = np.full(len(s_m), line), np.zeros(len(s_m))
    front = road.locate(which, s_m + 0.5 * length_m, none)
    rear = road.locate(which, s_m - 0.5 * length_m, none)
    yaw = np.arctan2(front[:, 1] - rear[:, 1], front[:, 0] - rear[:, 0])
    return Boxes(0.5 * (front + rear), yaw, np.tile([length_m, 2.0], (len(s_m), 1)))


@pytest.mark.parametrize("at_x_m", [-5.5, -5.0, -4.0])
@pytest.mark.parametrize("length_m", [3.8, 5.0, 9.0])
def test_areas_are_those_that_outlines_share(at_x_m: float, length_m: float) -> None:
    # A left turn, a quarter circle of 8 m, cut at different places by whoever drives straight on.
    through = lane("ns", [(at_x_m, 60), (at_x_m, -60)], is_connection=True)
    road = Road([one for one in crossing_lanes() if one.id != "we"] + [through])
    at = {"turns": (-20.0, 0.0, 0.0, 5.0), "goes": (at_x_m, 30.0, DOWN, 5.0)}
    scene = scene_of(0.0, at, blinker=1)
    scene.size_m[0, 0] = length_m
    state = begin(road)
    for frame in range(3):
        state = perceive(state, replace(scene, time_s=0.1 * frame), None)
    lines = state.seen.lines
    (conflict,) = road.conflicts(*lines.line.tolist())
    assert conflict.type is ConflictType.CROSS
    point = np.array([conflict.point_s_m])
    index, line = np.array([[0, 1]]), lines.line[None]
    before, beyond = areas_m(road, scene, index, line, point, np.array([ConflictType.CROSS]))
    step = np.arange(-20.0, 20.0, 0.1)
    ways = [
        way(road, int(lines.line[k]), point[0, k] + step, float(scene.size_m[k, 0])) for k in (0, 1)
    ]
    for k, (own, other) in enumerate((ways, ways[::-1])):
        met = np.array([overlap(own[i], other).any() for i in range(len(step))])
        first, last = step[met.argmax()], step[len(met) - 1 - met[::-1].argmax()]
        assert before[0, k] == pytest.approx(-first, abs=0.4)
        assert beyond[0, k] == pytest.approx(last, abs=0.4)
