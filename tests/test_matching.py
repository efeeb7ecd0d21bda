"""Each rule by which alerts are matched with events (METHOD 7), by hand."""

from __future__ import annotations

import pytest

from hatn_sim.datatypes import AlertInterval, SafetyEvent
from hatn_sim.score.matching import Outcome, match, matches

HIT, DUPLICATE, NEAR, FALSE, OUTSIDE = Outcome


def alert(onset_s: float, end_s: float, pair: str = "ab", type_: str = "CONFLICT") -> AlertInterval:
    return AlertInterval(pair[0], pair[1], type_, onset_s, end_s, onset_s, 0.5, 1.0)


def event(start_s: float, tier: str = "T2", pair: str = "ab") -> SafetyEvent:
    return SafetyEvent(tier, pair[0], pair[1] if len(pair) > 1 else None, start_s, "contact")


@pytest.mark.parametrize(
    ("onset_s", "end_s", "expected"),
    [
        (8.0, 12.0, True),  # still active
        (8.0, 8.5, True),  # over, but it began 2 s before
        (5.0, 5.5, True),  # exactly 5 s before
        (4.9, 5.5, False),  # over, and longer ago
        (1.0, 10.0, True),  # 9 s before, and active at the very start
        (1.0, 9.9, False),
        (10.0, 12.0, False),  # with the event, not before it
        (10.1, 12.0, False),
        (9.9, 12.0, True),
    ],
)
def test_which_alert_matches(onset_s: float, end_s: float, expected: bool) -> None:
    assert matches(alert(onset_s, end_s), event(10.0)) == expected


def test_the_earliest_counts_and_the_others_are_duplicates() -> None:
    alerts = [alert(9.0, 9.5), alert(7.0, 7.5), alert(8.0, 8.2, type_="DEVIATION")]
    found = match([event(10.0)], alerts)
    assert found.alert_of_event.tolist() == [1]
    assert found.lead_s.tolist() == [3.0]
    assert found.outcome.tolist() == [DUPLICATE, HIT, DUPLICATE]


def test_another_pair_and_another_time_are_false() -> None:
    alerts = [alert(9.0, 11.0, "ac"), alert(2.0, 3.0), alert(11.0, 12.0)]
    found = match([event(10.0)], alerts)
    assert found.alert_of_event.tolist() == [-1]
    assert found.outcome.tolist() == [FALSE, FALSE, FALSE]


def test_one_alert_warns_of_the_braking_and_of_the_crash() -> None:
    found = match([event(10.0), event(11.5, "T1")], [alert(8.0, 12.0), alert(10.5, 12.0)])
    assert found.lead_s.tolist() == [2.0, 3.5]
    assert found.outcome.tolist() == [HIT, DUPLICATE]


def test_a_hit_of_one_event_stays_one_where_it_is_a_duplicate_of_another() -> None:
    found = match([event(10.0), event(14.0)], [alert(8.5, 14.5), alert(12.0, 14.5)])
    assert found.alert_of_event.tolist() == [0, 0]
    assert found.outcome.tolist() == [HIT, DUPLICATE]
    found = match([event(10.0), event(16.0)], [alert(8.5, 10.5), alert(9.5, 16.5)])
    assert found.alert_of_event.tolist() == [0, 1]
    assert found.outcome.tolist() == [HIT, HIT]


@pytest.mark.parametrize("tier", ["T3", "brief"])
def test_an_alert_that_meets_only_what_is_not_severe_is_neither_hit_nor_false(tier: str) -> None:
    found = match([event(10.0, tier)], [alert(9.0, 11.0), alert(9.5, 11.0)])
    assert found.outcome.tolist() == [NEAR, NEAR]
    both = match([event(10.0, tier), event(10.5)], [alert(9.0, 11.0), alert(10.2, 11.0)])
    assert both.outcome.tolist() == [HIT, DUPLICATE]


def test_an_unattributed_braking_is_matched_by_nothing() -> None:
    found = match([event(10.0, pair="a")], [alert(9.0, 11.0)])
    assert found.alert_of_event.tolist() == [-1]
    assert found.is_scored.tolist() == [False]
    assert found.outcome.tolist() == [FALSE]


def test_what_is_outside_of_the_window_is_not_scored_but_matches() -> None:
    events = [event(99.0), event(101.0, pair="cd"), event(202.0, pair="ef")]
    alerts = [
        alert(98.0, 99.5),
        alert(99.5, 101.5, "cd"),
        alert(199.0, 202.0, "ef"),
        alert(201.0, 202.0, "gh"),
    ]
    found = match(events, alerts, (100.0, 200.0))
    assert found.is_scored.tolist() == [False, True, False]
    assert found.alert_of_event.tolist() == [0, 1, 2]
    # The last but one begins in the window and is judged by what came 2 s after it.
    assert found.outcome.tolist() == [OUTSIDE, OUTSIDE, HIT, OUTSIDE]


def test_nothing_at_all() -> None:
    found = match([], [])
    assert found.alert_of_event.shape == found.outcome.shape == (0,)
