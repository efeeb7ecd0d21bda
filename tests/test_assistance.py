"""Measures of assistance from hand-made runs: dangers, thresholds, rates, intervals, the file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import scene_of

from hatn_sim.assist.alert import AlertState, Met, alert, with_touched
from hatn_sim.assist.moment import PairDangers
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import SafetyEvent, Score
from hatn_sim.errors import InputError
from hatn_sim.evaluation.comparison import (
    by_risk,
    by_scene,
    compare_rules,
    curves_of,
    thresholds_by_scene,
    write_curves,
)
from hatn_sim.score.advised import Advised
from hatn_sim.score.assessed import AssessedRun, read_assessed, write_assessed
from hatn_sim.score.assistance import (
    alert_scores,
    counterfactual_scores,
    suggestion_scores,
    warned,
)
from hatn_sim.score.dangers import DangerRecorder, DangerTrace, alerts_at
from hatn_sim.score.sweep import (
    best_within,
    operating,
    quietest_at,
    sweep,
    thresholds_of,
)

RULE = "hatn"


def dangers(first: list[int], second: list[int], danger: list[float]) -> PairDangers:
    return PairDangers(np.array(first), np.array(second), np.array(danger))


def trace_of(*rows: tuple[float, str, str, float]) -> DangerTrace:
    """From (time, vehicle, vehicle, danger)."""
    recorder = DangerRecorder()
    for time_s, one, other, danger in rows:
        recorder.add(time_s, [one, other], dangers([0], [1], [danger]))
    return recorder.trace()


def held(
    start_s: float, end_s: float, pair: str, danger: float
) -> list[tuple[float, str, str, float]]:
    times = np.arange(start_s, end_s + 0.05, 0.2)
    return [(float(time_s), pair[0], pair[1], danger) for time_s in times]


def event(
    start_s: float, tier: str = "T2", pair: str = "ab", near_s: float | None = None
) -> SafetyEvent:
    second = pair[1] if len(pair) > 1 else None
    return SafetyEvent(tier, pair[0], second, start_s, "contact", near_s)


def run_of(
    seed: int = 1,
    risk: str = "courteous",
    events: tuple[SafetyEvent, ...] = (),
    rows: list[tuple[float, str, str, float]] | None = None,
    scene: str = "scene",
    hours: float = 0.5,
) -> AssessedRun:
    """A run of two minutes from 100 s on."""
    advised = Advised(
        encounters=10,
        switches=1,
        crossings=20,
        sampled=8,
        abstained=3,
        probability=np.array([0.9, 0.6, 0.75, 0.55]),
        agrees=np.array([True, False, True, True]),
        always_yield_agrees=np.array([True, False, False, True]),
    )
    return AssessedRun(
        scene, risk, seed, (100.0, 220.0), hours, events, {RULE: trace_of(*(rows or []))}, advised
    )


def value(scores: list[Score], measure: str) -> float | None:
    (score,) = [one for one in scores if one.measure == measure]
    return score.value


# ---------------------------------------------------------------------------------------------
# Dangers to alerts


def test_an_alert_begins_at_the_threshold_and_ends_where_danger_was_last_near_it() -> None:
    dangers = [0.5, 0.9, 1.0, 1.5, 0.85, 0.7, 0.7]
    rows = [(0.2 * k, "b", "a", danger) for k, danger in enumerate(dangers)]
    (alert,) = alerts_at(trace_of(*rows), 1.0)
    assert (alert.first_id, alert.second_id, alert.danger) == ("a", "b", 1.5)
    assert (alert.onset_s, alert.peak_s, alert.end_s) == pytest.approx((0.4, 0.6, 1.4))
    assert alerts_at(trace_of(*rows), 1.6) == []


@pytest.mark.parametrize(("gap_s", "count"), [(0.4, 1), (1.0, 1), (2.6, 2)])
def test_pauses_are_bridged_and_a_pair_is_not_warned_of_again_at_once(
    gap_s: float, count: int
) -> None:
    again_s = 1.0 + gap_s
    rows = [*held(0.0, 1.0, "ab", 1.0), *held(again_s, again_s + 1.0, "ab", 2.0)]
    found = alerts_at(trace_of(*rows), 1.0)
    assert len(found) == count
    assert found[0].onset_s == 0.0
    assert found[-1].danger == 2.0
    assert found[-1].end_s == pytest.approx(again_s + 1.0)


def test_of_a_pair_named_twice_the_worse_counts_and_pairs_do_not_mix() -> None:
    recorder = DangerRecorder()
    ids = ["z", "a", "m"]
    recorder.add(1.0, ids, dangers([0, 1, 2], [1, 0, 1], [1.0, 3.0, 2.0]))
    trace = recorder.trace()
    found = {
        (trace.ids[a], trace.ids[b]): d
        for a, b, d in zip(trace.first, trace.second, trace.danger, strict=True)
    }
    assert found == {("a", "z"): 3.0, ("a", "m"): 2.0}


@pytest.mark.parametrize("seed", range(8))
def test_alerts_afterwards_are_those_that_were_raised_live(seed: int) -> None:
    rng = np.random.default_rng(seed)
    settings = AssistSettings()
    level = np.abs(np.cumsum(rng.normal(0.0, 0.5, (150, 3)), axis=0)) * (rng.random((150, 3)) < 0.8)
    first, second = np.array([0, 0, 1]), np.array([1, 2, 2])
    recorder, state, met = DangerRecorder(), AlertState(), Met()
    raised: list[tuple[str, str, str, float]] = []
    nothing = PairDangers(first[:0], second[:0], level[0, :0])
    for k in range(180):
        at_m = {"c": 0.0, "a": 9.0 if k % 70 < 40 + 4 * seed else 3.0, "b": 18.0}
        scene = scene_of(0.2 * k, {name: (x_m, 0.0, 0.0, 1.0) for name, x_m in at_m.items()})
        found = PairDangers(first, second, level[k]) if k < len(level) else nothing
        met, marked = with_touched(met, scene, found)
        recorder.add(scene.time_s, scene.ids, marked)
        state, edges = alert(state, scene, found, settings, None)
        raised += [(*sorted((e.ego_id, e.other_id)), e.edge, e.time_s) for e in edges]
    told = [
        (one.first_id, one.second_id, edge, time_s)
        for one in alerts_at(recorder.trace(), settings.alert_onset, settings)
        for edge, time_s in (("onset", one.onset_s), ("peak", one.peak_s), ("end", one.end_s))
    ]
    assert len(told) > 6
    assert sorted(told) == sorted(raised)


# ---------------------------------------------------------------------------------------------
# Measures


def test_measures_by_hand() -> None:
    rows = [
        *held(110.0, 112.0, "ab", 2.0),  # hit, 2 s ahead
        *held(130.0, 130.4, "ab", 2.0),  # hit, 1 s ahead of a collision
        *held(140.0, 141.0, "cd", 2.0),  # false
        *held(150.0, 151.0, "ef", 2.0),  # meets a close encounter only
        *held(160.0, 161.0, "gh", 0.5),  # under the threshold
    ]
    events = (
        event(112.0),
        event(131.0, "T1"),
        event(170.0, pair="kl"),  # missed
        event(151.0, "T3", "ef", 0.8),
        event(180.0, "T3", "ef", 1.2),
        event(190.0, pair="m"),  # unattributed
        event(195.0, "brief", "ab"),
    )
    # The offence behind the collision showed 0.9 s before; of the missed event nothing is known.
    warnable_s = np.array([np.inf, 0.9, np.nan, np.nan, np.nan, np.nan, np.nan])
    run = replace(run_of(1, events=events, rows=rows), warnable_s=warnable_s)
    scores = alert_scores(warned([run], RULE, 1.0), RULE, "s", "r")
    expected = {
        "recall_in_time": 1.0,
        "recall_brief": 0.0,
        "event_recall": 2 / 3,
        "recall_1s0": 2 / 3,
        "recall_1s5": 1 / 3,
        "recall_2s0": 1 / 3,
        "recall_2s5": 0.0,
        "recall_t1": 1.0,
        "recall_t2": 0.5,
        "recall_t3_1s5": 0.5,
        "recall_t3_1s0": 1.0,
        "precision": 2 / 3,
        "false_alarms_per_hour": 2.0,
        "false_alarms_per_100_crossings": 5.0,
        "near_alarms_per_hour": 2.0,
        "duplicates": 0.0,
        "events_per_hour": 6.0,
        "unattributed_per_hour": 2.0,
        "brief_per_hour": 2.0,
    }
    for measure, wanted in expected.items():
        assert value(scores, measure) == pytest.approx(wanted), measure
    assert value(scores, "lead_time_s") in (pytest.approx(1.0), pytest.approx(2.0))


def test_without_events_recall_has_no_value() -> None:
    scores = alert_scores(warned([run_of(k) for k in range(6)], RULE, 1.0), RULE, "s", "r")
    by_measure = {score.measure: score for score in scores}
    for measure in ("event_recall", "recall_1s5", "lead_time_s", "precision", "duplicates"):
        score = by_measure[measure]
        assert (score.value, score.n, score.low, score.high) == (None, 0, None, None)
    rate = by_measure["false_alarms_per_hour"]
    # 97.5 % of Poisson counts of this mean are not 0: 3 hours were looked at.
    assert (rate.value, rate.low, rate.n) == (0.0, 0.0, 6)
    assert rate.high == pytest.approx(-np.log(0.025) / 3.0)


def test_lead_times_are_quantiles_and_their_interval_is_over_runs() -> None:
    def led(seed: int, lead_s: float) -> AssessedRun:
        return run_of(seed, events=(event(150.0),), rows=held(150.0 - lead_s, 150.0, "ab", 2.0))

    same = warned([led(k, 2.0) for k in range(5)], RULE, 1.0)
    scores = {one.measure: one for one in alert_scores(same, RULE, "s", "r")}
    assert (scores["lead_time_s"].value, scores["lead_time_s"].n) == (pytest.approx(2.0), 5)
    assert scores["lead_time_s"].low == pytest.approx(2.0)
    mixed = warned([led(k, lead) for k, lead in enumerate((1.0, 2.0, 3.0, 4.0, 5.0))], RULE, 1.0)
    scores = {one.measure: one for one in alert_scores(mixed, RULE, "s", "r")}
    assert [
        scores[name].value for name in ("lead_time_s_q1", "lead_time_s", "lead_time_s_q3")
    ] == pytest.approx([2.0, 3.0, 4.0])
    low, high = scores["lead_time_s"].low, scores["lead_time_s"].high
    assert low is not None and high is not None and 1.0 <= low < 3.0 < high <= 5.0


def test_a_share_of_all_or_of_none_is_not_certain() -> None:
    """Three events, all preceded: with a chance of 0.025 ** (1/3) that happens once in 40."""
    runs = [
        run_of(seed, events=(event(150.0),), rows=held(148.0, 150.0, "ab", 0.9))
        for seed in (1, 2, 3)
    ]
    scores = {one.measure: one for one in alert_scores(warned(runs, RULE, 0.5), RULE, "s", "r")}
    recall = scores["event_recall"]
    assert (recall.value, recall.high) == (1.0, 1.0)
    assert recall.low == pytest.approx(0.025 ** (1 / 3))
    assert scores["recall_2s5"].value == 0.0
    assert scores["recall_2s5"].high == pytest.approx(1.0 - 0.025 ** (1 / 3))


def test_suggestions_by_hand() -> None:
    scores = suggestion_scores([run_of(1), run_of(2)], RULE, "s", "r")
    assert value(scores, "suggestion_agreement") == 0.75
    assert value(scores, "always_yield_agreement") == 0.5
    assert value(scores, "suggestion_switches") == 0.1
    assert value(scores, "suggestion_abstained") == 0.375
    brier = (0.1**2 + 0.6**2 + 0.25**2 + 0.45**2) / 4
    assert value(scores, "suggestion_brier") == pytest.approx(brier)
    # Of 15 bins: 0.55 (right) alone, 0.6 (wrong), 0.75 (right) and 0.9 (right) each alone.
    assert value(scores, "suggestion_ece") == pytest.approx((0.45 + 0.6 + 0.25 + 0.1) / 4)


def test_verdicts_and_regret_by_hand() -> None:
    def alert_line(verdict: str, ignored: int) -> dict[str, object]:
        said = {"about": "alert", "lost": False, "verdict": verdict, "to_the_end": "harmful"}
        return {**said, "ignored": [{}] * ignored}

    def slot_line(driver: str | None, own: float, yielding: float, his: float) -> dict[str, object]:
        said = {"about": "suggestion", "lost": False, "action": "yield", "driver_action": driver}
        said |= {"regret_to_best": own - min(his, 0.0), "slots_differ": yielding > 0.0}
        said |= {"slots": [{"collisions": 1}, {"collisions": int(own > 1.0)}]}
        return {**said, "regret": own, "always_yield_regret": yielding, "driver_regret": his}

    lines = (
        alert_line("useful", 1),
        alert_line("unavailing", 2),
        alert_line("unneeded", 0),
        alert_line("harmful", 0),
        {"about": "alert", "lost": True},
        slot_line("yield", 0.0, 2.0, -3.0),
        slot_line("pass", 1.0, 4.0, 3.0),
        slot_line(None, 2.0, 0.0, 1.0),
    )
    scores = counterfactual_scores([replace(run_of(), counterfactuals=lines)], RULE, "s", "r")
    expected = {
        "useful_share": 0.5,
        "harmful_share": 0.25,
        "harmful_to_the_end_share": 1.0,
        "unneeded_share": 0.25,
        "regret": 1.0,
        "always_yield_regret": 2.0,
        "driver_regret": 1 / 3,
        "regret_where_different": 1.0,
        "driver_regret_where_different": 3.0,
        "regret_to_best": 2.0,
        "always_yield_regret_to_best": 3.0,
        "slots_differ": 2 / 3,
        "all_slots_collide": 1 / 3,
        "lost_branches": 1 / 8,
    }
    assert {one.measure: one.value for one in scores} == pytest.approx(expected)
    assert counterfactual_scores([run_of()], RULE, "s", "r") == []


# ---------------------------------------------------------------------------------------------
# Sweeps


def graded(seed: int, risk: str, severity: float, false: float) -> AssessedRun:
    """An event that a danger of `severity` precedes by 2 s, and a danger for nothing."""
    rows = [*held(148.0, 150.0, "ab", severity), *held(120.0, 121.0, "cd", false)]
    return run_of(seed, risk, (event(150.0),) if risk != "courteous" else (), rows)


def test_a_sweep_counts_false_alarms_in_courteous_traffic_alone() -> None:
    runs = [
        graded(1, "courteous", 0.1, 1.0),
        graded(2, "inattentive", 3.0, 5.0),
        graded(3, "inattentive", 2.0, 5.0),
        graded(4, "inattentive", 0.6, 5.0),
    ]
    thresholds = thresholds_of(runs, RULE)
    assert thresholds == sorted(thresholds, reverse=True)
    at = {one.threshold: one for one in sweep(runs, RULE, thresholds)}
    assert at[3.0].false_alarms_per_hour == 0.0
    assert at[3.0].event_recall == pytest.approx(1 / 3)
    assert at[2.0].event_recall == pytest.approx(2 / 3)
    assert at[0.6].event_recall == 1.0
    assert at[0.6].false_alarms_per_hour == 2.0
    best = best_within(list(at.values()), 0.5)
    assert best is not None and best.threshold == 2.0
    assert best_within(list(at.values()), 2.0) == at[0.6]
    assert best_within([operating(runs, RULE, 0.5)], 0.1) is None


def test_a_curve_has_the_lead_time_of_the_scores() -> None:
    # Alerts of 2 s and of 1 s before the event: the median of an even number is the lower one.
    runs = [
        graded(2, "inattentive", 3.0, 0.0),
        run_of(3, "inattentive", (event(150.0),), held(149.0, 150.0, "ab", 3.0)),
    ]
    scores = alert_scores(warned(runs, RULE, 1.0), RULE, "s", "r")
    (lead,) = [one.value for one in scores if one.measure == "lead_time_s"]
    assert operating(runs, RULE, 1.0).lead_time_s == lead == pytest.approx(1.0)


def test_without_courteous_runs_false_alarms_are_counted_in_all() -> None:
    runs = [graded(2, "inattentive", 3.0, 5.0), graded(3, "assertive", 2.0, 5.0)]
    assert operating(runs, RULE, 4.0).false_alarms_per_hour == 2.0


def test_rules_side_by_side_at_equal_false_alarms(tmp_path: Path) -> None:
    runs = [graded(k, risk, 2.0, 1.0) for k in range(3) for risk in ("courteous", "inattentive")]
    # Another rule raises the same dangers but is never sure: it has to give up its events.
    vague = [
        replace(run, traces={**run.traces, "vague": graded(1, run.risk, 1.0, 2.0).traces[RULE]})
        for run in runs
    ]
    curves = curves_of(vague)
    settings = AssistSettings(alert_onset=1.5, alert_end=1.2)
    scores = compare_rules(vague, thresholds_by_scene(vague, curves, settings), settings)
    told = {
        (one.predictor, one.subset): one.value for one in scores if one.measure == "event_recall"
    }
    assert told["hatn", "inattentive"] == 1.0
    assert told["vague", "inattentive"] == 0.0
    assert told["oracle", "all"] == 1.0
    assert told["hatn", "courteous"] is None
    # Half an hour each, nothing happens: ours raises one alert of its two dangers, and the other
    # rule has to raise both to recall as much.
    same = {
        (one.predictor, one.subset): one.value
        for one in scores
        if one.measure == "false_alarms_per_hour_at_equal_recall"
    }
    assert same["hatn", "courteous"] == 2.0
    assert same["vague", "courteous"] == 4.0
    write_curves(tmp_path / "curves.csv", curves)
    lines = (tmp_path / "curves.csv").read_text().splitlines()
    assert lines[0].startswith("scene,rule,threshold,false_alarms_per_hour")
    assert len(lines) == 1 + sum(len(curve) for of in curves.values() for curve in of.values())


def test_where_nothing_happens_thresholds_are_those_of_the_scenes_with_events() -> None:
    def with_vague(run: AssessedRun, danger: float) -> AssessedRun:
        vague = graded(1, run.risk, danger, 2.0).traces[RULE]
        return replace(run, traces={**run.traces, "vague": vague})

    settings = AssistSettings(alert_onset=1.5, alert_end=1.2)
    telling = [with_vague(graded(k, "inattentive", 2.0, 1.0), 1.0) for k in range(2)]
    # Ours is silent here, and the other rule as loud as before.
    empty = graded(5, "courteous", 0.1, 1.0)
    silent = [with_vague(replace(empty, scene="suppress_warn_crossing"), 0.1)]
    runs = [*telling, *silent]
    thresholds = thresholds_by_scene(runs, curves_of(runs, settings), settings)
    there = thresholds["suppress_warn_crossing"]
    assert there.chosen_on == (telling[0].scene,)
    assert there.equal_recall["vague"] <= 1.0 < there.equal_rate["vague"]
    rates = {
        (one.predictor, one.measure): one.value
        for one in compare_rules(runs, thresholds, settings)
        if one.scene == "suppress_warn_crossing" and one.unit == "1/h"
    }
    assert rates["hatn", "false_alarms_per_hour_at_equal_recall"] == 0.0
    assert rates["vague", "false_alarms_per_hour_at_equal_recall"] == 2.0  # one in half an hour

    alone = thresholds_by_scene(silent, curves_of(silent, settings), settings)
    assert "vague" not in alone["suppress_warn_crossing"].equal_rate


def test_the_quietest_threshold_that_recalls_enough() -> None:
    runs = [graded(1, "courteous", 0.1, 1.0), graded(2, "inattentive", 3.0, 5.0)]
    curve = sweep(runs, RULE, [3.0, 1.0])
    quietest = quietest_at(curve, 1.0)
    assert quietest is not None and quietest.threshold == 3.0
    assert quietest_at(curve[:0], 0.5) is None


def test_runs_are_pooled_over_scenes_and_profiles() -> None:
    runs = [run_of(1, scene="a"), run_of(1, "assertive", scene="a"), run_of(1, scene="b")]
    assert {name: len(of) for name, of in by_scene(runs).items()} == {"a": 2, "b": 1, "all": 3}
    assert {name: len(of) for name, of in by_risk(runs).items()} == {
        "courteous": 2,
        "assertive": 1,
        "all": 3,
    }
    assert list(by_risk(runs[:1])) == ["courteous"]
    assert list(by_risk([run_of(risk="")])) == ["all"]


# ---------------------------------------------------------------------------------------------
# The file


def test_a_run_is_read_as_it_was_written(tmp_path: Path) -> None:
    rows = held(110.0, 112.0, "ab", 2.0)
    run = replace(
        run_of(7, events=(event(112.0), event(120.0, pair="a")), rows=rows),
        counterfactuals=({"alert_id": "a1", "verdict": "useful"},),
        made_with={"seed": 7},
        notices=("a notice",),
        warnable_s=np.array([np.inf, np.nan]),
    )
    write_assessed(tmp_path / "run.npz", run)
    again = read_assessed(tmp_path / "run.npz")
    for name in (
        "scene",
        "risk",
        "seed",
        "window_s",
        "vehicle_hours",
        "events",
        "counterfactuals",
        "made_with",
        "notices",
    ):
        assert getattr(again, name) == getattr(run, name), name
    assert alerts_at(again.traces[RULE], 1.0) == alerts_at(run.traces[RULE], 1.0)
    np.testing.assert_array_equal(again.warnable_s, run.warnable_s)
    assert again.advised.agrees.tolist() == run.advised.agrees.tolist()
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut off", b"something else"])
def test_a_damaged_file_is_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match="delete it") as told:
        read_assessed(path)
    assert "\n" not in str(told.value)
