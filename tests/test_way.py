"""How far along its way a vehicle is, where the way is bent tighter than the vehicle is long."""

from __future__ import annotations

import numpy as np
import pytest

from hatn_sim.geometry import resample
from hatn_sim.way import STEP_M, Way

LEG_M = 60.0


@pytest.mark.parametrize("length_m", [4.5, 7.5, 12.0, 16.5])
@pytest.mark.parametrize("radius_m", [1.6, 1.75, 3.2, 5.0])
@pytest.mark.parametrize("turned_deg", [90.0, 135.0, 180.0])
def test_a_vehicle_is_followed_through_a_bend(
    radius_m: float, length_m: float, turned_deg: float
) -> None:
    """Front and rear keep to the way, so that the centre is on the chord between them."""
    turn = np.linspace(0.0, np.deg2rad(turned_deg), 60)
    bend = radius_m * np.stack((np.sin(turn), 1.0 - np.cos(turn)), axis=1)
    leave = LEG_M * np.array([np.cos(turn[-1]), np.sin(turn[-1])])
    line = np.concatenate(([[-LEG_M, 0.0]], bend, [bend[-1] + leave]))
    xy_m = resample(line, STEP_M)
    at_m = STEP_M * np.arange(len(xy_m))

    def place(s_m: float) -> np.ndarray:
        return np.array([np.interp(s_m, at_m, axis) for axis in xy_m.T])

    points = [(x, y) for x, y in xy_m.tolist()]
    way = Way((), xy_m, points, 30.0, None, None, ())
    before_m, worst_m = 30.0, 0.0
    for s_m in np.arange(30.0, at_m[-1] - 10.0, 0.5):
        front, rear = place(s_m + 0.5 * length_m), place(s_m - 0.5 * length_m)
        way = way.moved(0.5 * (front + rear))
        assert way.s_m > before_m - 0.01, "nobody drives back"
        before_m = way.s_m
        # Folded over a bend, the centre is near to much of it for a while.
        worst_m = max(worst_m, abs(way.s_m - s_m))
    assert way.s_m == pytest.approx(s_m, abs=0.01)
    assert worst_m < length_m
