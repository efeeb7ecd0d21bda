"""Signs of danger at hand-drawn moments, against answers by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of, with_signal_at_south
from test_alert import moment

from hatn_sim.assist.moment import Moment
from hatn_sim.assist.signs import (
    MOST_MPS2,
    SIGNS,
    kept_travel_m,
    signs_at_constant_velocity,
    signs_of,
)
from hatn_sim.datatypes import Prediction
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road


def sign(of: Moment, name: str, *, steady: bool = False) -> float:
    """One sign of the only pair; 0 where the pair is not looked at."""
    found = (signs_at_constant_velocity if steady else signs_of)(of).of
    assert len(found) <= 1
    return float(found[0, SIGNS.index(name)]) if len(found) else 0.0


def test_every_sign_has_one_name() -> None:
    found = signs_of(moment((20.0, 9.0, 0.0), (20.0, 9.0, 0.0)))
    assert found.of.shape == (1, len(SIGNS))
    assert len(set(SIGNS)) == len(SIGNS)
    assert np.isfinite(found.of).all()


def test_two_who_go_on_into_each_other_meet_in_every_future() -> None:
    both = moment((20.0, 9.0, 0.0), (20.0, 9.0, 0.0))
    # At 9 m/s both are in an area of 16.5 m ... 23.5 m at once: 1.83 s ... 2.61 s, -0.78 s apart.
    at_once, soon = 1.0 / (1.0 + np.exp((-0.78 - 0.5) / 0.25)), 1.0 / (1.0 + np.exp(-4.34))
    for name in ("meet, one predicted, one predicted", "meet, at most", "meet, mean"):
        assert sign(both, name) == pytest.approx(at_once * soon, abs=0.01)
    # After 1 s they are 7.5 m before it, and the other is out of it 14.5 m later.
    t = 14.5 / 9.0
    needed = 2.0 * (9.0 * t - 7.5) / t**2
    name = "braking needed by the better placed, after the reaction time"
    assert sign(both, name) == pytest.approx(needed / MOST_MPS2, rel=0.03)
    assert sign(both, "crossing") == 1.0
    assert sign(both, "angle of the lines (cosine)") == pytest.approx(0.0, abs=1e-6)
    assert sign(both, "speed of the slower") == pytest.approx(9.0 / 14.0)


def test_one_who_brakes_meets_only_in_the_futures_in_which_he_does_not() -> None:
    brakes = moment((20.0, 9.0, 0.0), (20.0, 9.0, -6.0))  # will stand after 6.75 m
    assert sign(brakes, "meet, one going on, one going on") < 0.01
    assert sign(brakes, "meet, one at constant speed, one at constant speed") > 0.9
    assert sign(brakes, "one brakes") == pytest.approx(6.0 / 9.0, rel=0.01)


def test_two_who_set_off_meet_if_both_go_on() -> None:
    # 3.5 m before the area, at 1 m/s and 2 m/s2: there after 1.4 s; at 1 m/s after 3.5 s.
    both = moment((7.0, 1.0, 2.0), (7.0, 1.0, 2.0))
    assert sign(both, "meet, one going on, one going on") > 0.95
    assert sign(both, "meet within 3 s, both going on") > 0.9
    assert sign(both, "meet within 3 s, both at constant speed") < 0.5
    assert sign(both, "both speed up") == pytest.approx(4.0 / 3.0, rel=0.01)


def test_pairs_far_off_are_not_looked_at() -> None:
    assert not len(signs_of(moment((60.0, 5.0, 0.0), (60.0, 5.0, 0.0))).of)


@pytest.mark.parametrize(
    ("closed", "speed_mps", "looked_at"),
    [(False, 0.0, True), (True, 0.0, False), (True, 0.2, False), (True, 0.4, True)],
)
def test_who_stands_at_a_closed_signal_is_in_no_danger(
    closed: bool, speed_mps: float, looked_at: bool
) -> None:
    lanes = with_signal_at_south(crossing_lanes())
    # Its front bumper is half a metre before the signal.
    of = moment((25.0, 9.0, 0.0), (11.0, speed_mps, 0.0), lanes=lanes, closed=(closed,))
    for found in (signs_of(of), signs_at_constant_velocity(of)):
        assert (len(found.of) > 0) == looked_at


def test_nobody_has_no_signs() -> None:
    state = perceive(begin(Road(crossing_lanes())), scene_of(0.0, {}), None)
    nobody = Prediction(
        (), np.zeros((0, 3, 30, 2)), np.zeros((0, 3)), np.zeros(0, bool), np.zeros(0, bool)
    )
    for of in (signs_of, signs_at_constant_velocity):
        assert of(Moment(state.road, state.seen, nobody)).of.shape == (0, len(SIGNS))


def test_who_is_at_his_line_and_comes_out_before_another() -> None:
    # The line is 8 m before the middle, the front bumper 2.5 m before the centre.
    creeps = moment((11.0, 1.0, 0.0), (25.0, 9.0, 0.0))
    name = "one creeps at its line, the other comes"
    assert sign(creeps, name) > 0.4
    assert sign(moment((25.0, 1.0, 0.0), (25.0, 9.0, 0.0)), name) < 0.01  # far from it
    assert sign(moment((11.0, 1.0, 0.0), (25.0, 1.0, 0.0)), name) < 0.01  # nobody comes
    # 9 m/s, 4.5 m before the line: 9 m/s2 to stop.
    cannot = "one cannot stop at its line and meets"
    assert sign(moment((15.0, 9.0, 0.0), (15.0, 9.0, 0.0)), cannot) > 0.9
    assert sign(moment((30.0, 9.0, 0.0), (30.0, 9.0, 0.0)), cannot) == 0.0


def test_what_was_predicted_is_a_sign_for_ours_only() -> None:
    sure = moment((22.0, 9.0, 0.0), (20.0, 9.0, 0.0), north_yields=0.9)
    assert sign(sure, "both are to yield") == pytest.approx(0.5)
    assert sign(sure, "both are to pass") == pytest.approx(0.1)
    assert sign(sure, "who goes first is in doubt") == pytest.approx(1.0)
    assert sign(sure, "who goes first is predicted") == 1.0
    assert sign(sure, "both are to yield", steady=True) == 0.0
    assert sign(sure, "who goes first is predicted", steady=True) == 0.0


@pytest.mark.parametrize("of", [signs_of, signs_at_constant_velocity])
def test_who_of_the_two_is_named_first_does_not_matter(of: object) -> None:
    one = moment((18.0, 8.0, 1.0), (21.0, 6.0, -1.0), north_yields=0.8)
    pairs = one.pairs
    turned = {
        name: getattr(pairs, name)[:, ::-1]
        for name in ("index", "room_m", "clear_m", "to_point_m", "length_m")
    }
    other = replace(one)
    other.__dict__["pairs"] = replace(pairs, **turned)
    np.testing.assert_allclose(of(other).of, of(one).of)  # type: ignore[operator]


def test_kept_motion_ends_at_a_standstill_and_at_the_fastest() -> None:
    travelled = kept_travel_m(np.array([3.0, 13.0, 20.0]), np.array([-3.0, 5.0, 0.0]))
    np.testing.assert_allclose(travelled[0, -1], sum(3.0 - 0.3 * k for k in range(1, 11)) * 0.1)
    assert travelled[1, -1] < 14.0 * 3.0
    np.testing.assert_allclose(travelled[2, -1], 60.0)
