"""Verdicts and costs on branches made by hand, and a run that is judged without being changed."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hatn_sim import cli
from hatn_sim.datatypes import DT_S, Branch, FloatArray, SafetyEvent, SemanticGraphs
from hatn_sim.score.counterfactual import (
    CounterfactualSettings,
    concerning,
    first_difference_s,
    judge_alert,
    regret,
    slot_costs,
    verdict,
)
from hatn_sim.score.counterfactual_tally import tally, tally_words
from hatn_sim.score.what_if import driver_action, is_sampled

FRAMES = 51


def branch(
    speeds_mps: dict[str, FloatArray],
    starts_m: dict[str, tuple[float, float]],
    collisions: tuple[tuple[float, str, str], ...] = (),
) -> Branch:
    """Cars of 5 m x 2 m, all driving east from their starts; speeds [B], trapezoids between."""
    speed = np.array(list(speeds_mps.values()), np.float64).T
    way = np.zeros(speed.shape)
    way[1:] = np.cumsum(0.5 * DT_S * (speed[1:] + speed[:-1]), axis=0)
    start = np.array([starts_m[name] for name in speeds_mps])
    xy_m = np.stack(
        (start[:, 0] + way, np.broadcast_to(start[:, 1], way.shape)), axis=-1, dtype=np.float64
    )
    return Branch(
        ids=tuple(speeds_mps),
        time_s=np.asarray(100.0 + DT_S * np.arange(len(speed)), np.float64),
        valid=np.ones(speed.shape, np.bool_),
        xy_m=xy_m,
        yaw_rad=np.zeros(speed.shape),
        speed_mps=speed,
        size_m=np.tile([5.0, 2.0], (len(speeds_mps), 1)),
        collisions=collisions,
        emergency_braking=(),
    )


def constant(mps: float) -> FloatArray:
    return np.full(FRAMES, mps, np.float64)


def slowing(mps2: float, to_mps: float) -> FloatArray:
    """From 10 m/s."""
    return np.asarray(np.maximum(10.0 - mps2 * DT_S * np.arange(FRAMES), to_mps), np.float64)


def event(tier: str, first: str = "a", second: str | None = "b") -> SafetyEvent:
    return SafetyEvent(tier, first, second, 3.0, "contact")


# ---------------------------------------------------------------------------------------------
# Verdicts


@pytest.mark.parametrize(
    ("ignored", "obeyed", "expected"),
    [
        ([], [], "unneeded"),
        ([event("T1")], [], "useful"),
        ([event("T2")], [], "useful"),
        ([event("T1"), event("T2")], [event("T2")], "useful"),  # braking instead of contact
        ([], [event("T2")], "harmful"),
        ([event("T2")], [event("T1")], "harmful"),
        ([event("T1")], [event("T2", "a", "c")], "harmful"),  # another pair pays for it
        ([event("T2")], [event("T2")], "unavailing"),
        ([event("T2", "a", None)], [], "useful"),
    ],
)
def test_a_verdict_compares_pair_by_pair(
    ignored: list[SafetyEvent], obeyed: list[SafetyEvent], expected: str
) -> None:
    assert verdict(ignored, obeyed) == expected


def test_events_of_third_ones_do_not_count() -> None:
    events = [event("T1", "c", "d"), event("T2", "a", None), event("T1", "b", "c"), event("T1")]
    assert concerning(events, "a") == (events[1], events[3])
    assert concerning(events, "b") == (events[2], events[3])


def test_an_alert_obeyed() -> None:
    """The follower runs into the ego unless it goes on; then one on the next lane brakes."""
    starts = {"ego": (0.0, 0.0), "behind": (-20.0, 0.0), "aside": (-10.0, 8.0), "far": (0.0, 500.0)}
    ramp = slowing(3.0, 4.0)
    ignored = branch(
        {"ego": constant(2.0), "behind": constant(10.0), "aside": constant(10.0), "far": ramp},
        starts,
        collisions=((102.0, "behind", "ego"), (102.1, "behind", "ego")),
    )
    obeyed = branch(
        {"ego": constant(10.0), "behind": constant(10.0), "aside": ramp, "far": ramp}, starts
    )
    judged = judge_alert(ignored, obeyed, "ego")
    assert judged.verdict == "useful"
    assert [one.tier for one in judged.ignored] == ["T1"] and judged.obeyed == ()
    # 10 m/s for 5 s, against 10 to 4 m/s in 2 s and 4 m/s for 3 s.
    assert judged.others_lost_m == pytest.approx(50.0 - (14.0 + 12.0))
    assert judged.others_braking_mps2 == pytest.approx(3.0)  # of the one aside: "far" is unaffected
    assert judged.others_braked_mps2 == 0.0
    assert judge_alert(obeyed, ignored, "ego").verdict == "harmful"
    assert judge_alert(obeyed, obeyed, "ego").verdict == "unneeded"


def test_braking_that_was_under_way_is_no_event_of_an_alert() -> None:
    starts = {"ego": (0.0, 0.0), "other": (60.0, 0.0)}
    hard, later = slowing(6.0, 0.0), constant(10.0)
    later[20:] = slowing(6.0, 0.0)[: FRAMES - 20]
    at_once, in_two_s, never = (
        branch({"ego": own, "other": constant(0.0)}, starts)
        for own in (hard, later, constant(10.0))
    )
    assert [one.start_s for one in judge_alert(in_two_s, never, "ego").ignored] == [102.0]
    assert judge_alert(in_two_s, never, "ego").verdict == "useful"
    assert judge_alert(at_once, at_once, "ego").verdict == "unneeded"
    assert judge_alert(at_once, never, "ego").verdict == "unneeded"
    # But whoever brakes so only where he obeys does it for that.
    assert judge_alert(never, at_once, "ego").verdict == "harmful"


def test_what_a_driver_does_when_he_has_his_vehicle_back_is_his_own_doing() -> None:
    starts = {"ego": (0.0, 0.0), "other": (60.0, 0.0)}
    later = constant(10.0)
    later[40:] = slowing(6.0, 0.0)[: FRAMES - 40]
    never, in_four_s = (
        branch({"ego": own, "other": constant(0.0)}, starts) for own in (constant(10.0), later)
    )
    assert judge_alert(never, in_four_s, "ego", 4.0).verdict == "harmful"
    late = judge_alert(never, in_four_s, "ego", 3.9)
    assert (late.verdict, late.obeyed, late.to_the_end) == ("unneeded", (), "harmful")
    assert judge_alert(in_four_s, never, "ego", 3.9).verdict == "unneeded"  # and so either way


# ---------------------------------------------------------------------------------------------
# Costs


def test_costs_by_hand() -> None:
    """Following 9.6 m behind at 10 m/s, which is there within a second."""
    starts = {"ego": (0.0, 0.0), "behind": (-14.6, 0.0)}
    settings = CounterfactualSettings()
    slow, fast = (
        branch({"ego": constant(mps), "behind": behind}, starts)
        for mps, behind in (
            (5.0, slowing(4.0, 5.0)),
            (10.0, constant(10.0)),
        )
    )
    costs = slot_costs([slow, fast], "ego", settings)
    assert [cost.delay_s for cost in costs] == pytest.approx([2.5, 0.0])  # 25 of 50 m at 10 m/s
    assert [cost.others_braking_mps2 for cost in costs] == pytest.approx([4.0, 0.0])
    assert [cost.discomfort_mps2 for cost in costs] == [0.0, 0.0]
    assert costs[1].least_gap_s == pytest.approx(1.0)
    assert [(cost.evasions, cost.collisions) for cost in costs] == [(0, 0), (0, 0)]
    missing_s = settings.gap_s - 1.0
    assert costs[1].total == pytest.approx(settings.per_missing_gap_s * missing_s)
    totals = [cost.total for cost in costs]
    assert regret(totals, 1) == 0.0 and regret(totals, 0) == pytest.approx(totals[0] - totals[1])


def test_a_contact_costs_most_and_nobody_near_is_no_gap() -> None:
    starts = {"ego": (0.0, 0.0), "other": (0.0, 50.0)}
    speeds = {"ego": constant(5.0), "other": constant(5.0)}
    settings = CounterfactualSettings()
    alone, hit = branch(speeds, starts), branch(speeds, starts, ((101.0, "ego", "other"),))
    free, crashed = slot_costs([alone, hit], "ego", settings)
    assert free.least_gap_s is None and free.total == 0.0
    assert [(one.tier, one.second_id, one.start_s) for one in crashed.events] == [
        ("T1", "other", 101.0)
    ]
    assert crashed.collisions == 1 and crashed.total == pytest.approx(settings.per_collision)


def test_when_the_offender_first_did_otherwise() -> None:
    lawful = slowing(2.0, 0.0)
    starts = {"a": (0.0, 0.0)}
    one, other = branch({"a": constant(10.0)}, starts), branch({"a": lawful}, starts)
    assert first_difference_s(one, other, "a") == pytest.approx(100.3)  # 0.6 m/s after 0.3 s
    assert first_difference_s(one, one, "a") is None


def test_samples_have_their_rate_and_repeat() -> None:
    drawn = [is_sampled(0.3, 5, "Alert", number) for number in range(4000)]
    assert drawn == [is_sampled(0.3, 5, "Alert", number) for number in range(4000)]
    assert np.mean(drawn) == pytest.approx(0.3, abs=0.03)
    assert all(is_sampled(1.0, 5, number) for number in range(50))


def test_the_tally() -> None:
    def suggestion(own: float, driver: str | None) -> dict[str, Any]:
        line = {"about": "suggestion", "lost": False, "action": "yield", "driver_action": driver}
        line |= {"regret": own, "always_yield_regret": 4.0, "driver_regret": 2.0}
        # The first makes no difference, and is bad either way.
        slots = [{"total": total, "collisions": own == 1.0} for total in (5.0, own + 4.0)]
        return line | {"regret_to_best": own + 1.0, "slots": slots}

    alerts = [{"about": "alert", "lost": False, "verdict": v} for v in ("useful", "unneeded")]
    lines = [*alerts, suggestion(1.0, "yield"), suggestion(2.0, "pass"), suggestion(3.0, None)]
    found = tally([*lines, {"about": "alert", "lost": True}])
    assert (found.alerts, found.alerts_on_events, found.lost) == (2, 1, 1)
    assert (found.regrets.n, found.regrets.advised, found.regrets.always_yield) == (3, 2.0, 4.0)
    assert (found.regrets_where_differs.n, found.regrets_where_differs.advised) == (1, 2.0)
    differ = found.regrets_where_slots_differ
    assert (differ.n, differ.advised, differ.to_best, found.all_collide) == (2, 2.5, 3.5, 1)
    words = tally_words(found, CounterfactualSettings())
    assert words[2].startswith("2 of these where it matters which slot is taken: mean regret 2.50")
    assert words[0].startswith("counterfactuals: 2 alerts judged: 1 useful, 1 unneeded, 0 harmful")
    assert words[-1].startswith("settings of counterfactuals: reaction_s 1, horizon_s 8")
    assert tally([]).regrets.advised is None
    late = tally([one | {"to_the_end": "harmful"} for one in alerts])
    assert tally_words(late, CounterfactualSettings())[1].endswith(
        ": 0 useful, 0 unneeded, 2 harmful, 0 unavailing"
    )


# ---------------------------------------------------------------------------------------------
# What the driver does about the vehicle that the advice names


def crossing(other_mps: FloatArray, ego_mps: FloatArray) -> Branch:
    """The ego comes from the west, the other from the south; they cross at (0, 0)."""
    one = branch({"ego": ego_mps, "other": other_mps}, {"ego": (-20.0, 0.0), "other": (-20.0, 0.0)})
    turned = one.xy_m.copy()
    turned[:, 1] = one.xy_m[:, 1, ::-1]
    return replace(one, xy_m=turned)


def graphs_of() -> SemanticGraphs:
    """The ego's graph, with the other behind node 1; what is not asked for is empty."""
    told: dict[str, Any] = {field.name: np.zeros(0) for field in fields(SemanticGraphs)}
    told |= {
        "ids": ("ego", "other"),
        "ego": np.array([0]),
        "rear": np.array([[0, 1, -1]]),
        "focus_mask": np.array([[True, True, False]]),
        "ego_to_conflict_m": np.array([[20.0, 20.0, 0.0]]),
        "rear_to_conflict_m": np.array([[0.0, 20.0, 0.0]]),
        "conflict_xy_m": np.zeros((1, 3, 2)),
    }
    return SemanticGraphs(**told)


@pytest.mark.parametrize(
    ("other_mps", "ego_mps", "expected"),
    [
        (constant(8.0), constant(10.0), "pass"),
        (constant(10.0), constant(8.0), "yield"),
        (constant(8.0), constant(8.0), "yield"),  # at once, as in labels
        (constant(1.0), constant(10.0), "pass"),  # it is still on its way at the end
        (constant(10.0), constant(1.0), "yield"),
        (constant(1.0), constant(1.0), None),
    ],
)
def test_what_the_driver_does_about_another(
    other_mps: FloatArray, ego_mps: FloatArray, expected: str | None
) -> None:
    assert driver_action(crossing(other_mps, ego_mps), graphs_of(), 0, "other") == expected


def test_nothing_is_told_of_another_who_never_comes() -> None:
    both = crossing(constant(5.0), constant(10.0))
    assert driver_action(both, graphs_of(), 0, "other") == "pass"
    # It drives as far as the conflict, but elsewhere.
    elsewhere = both.xy_m.copy()
    elsewhere[:, 1, 0] = 30.0
    assert driver_action(replace(both, xy_m=elsewhere), graphs_of(), 0, "other") is None
    # It leaves view before.
    valid = both.valid.copy()
    valid[20:, 1] = False
    assert driver_action(replace(both, valid=valid), graphs_of(), 0, "other") is None
    # The advice names somebody with whom there is no conflict.
    alone = replace(graphs_of(), focus_mask=np.array([[True, False, False]]))
    assert driver_action(both, alone, 0, "other") is None


# ---------------------------------------------------------------------------------------------
# In a run


def test_a_run_is_not_changed_by_being_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "roundabout8", "--risk", "inattentive", "--seed", "3", "--duration", "8"]
    words += ["--warm-up", "40", "--no-picture", "--quiet", "--assist"]
    plain, judged = tmp_path / "plain", tmp_path / "judged"
    assert cli.main([*words, "--out", str(plain)]) == 0
    assert cli.main([*words, "--out", str(judged), "--counterfactuals", "0.5"]) == 0
    assert "settings of counterfactuals: " in capsys.readouterr().out

    def files(folder: Path) -> dict[str, bytes]:
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and path.name not in ("run.json", "timing.json")
        }

    before, after = files(plain), files(judged)
    lines = [json.loads(line) for line in after.pop("counterfactuals.jsonl").splitlines()]
    assert before == after
    assert any(line["about"] == "suggestion" for line in lines)
    for line in lines:
        assert not line["lost"] and line["ego_id"]
        if line["about"] == "suggestion":
            slots = [(slot["action"], slot["slot_id"]) for slot in line["slots"]]
            assert (line["action"], line["slot_id"]) in slots and slots[0][0] == "yield"
            assert line["ego_id"] not in [slot_id for _, slot_id in slots]
            assert line["regret"] >= 0.0
    settings = json.loads((judged / "run.json").read_text())["settings"]["counterfactuals"]
    assert (
        settings["rates"] == {"alerts": 0.5, "suggestions": 0.5} and settings["reaction_s"] == 1.0
    )


def test_what_cannot_be_branched_is_run_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "highway_merge", "--duration", "1", "--warm-up", "0", "--no-picture"]
    out = tmp_path / "run"
    assert cli.main([*words, "--out", str(out), "--quiet", "--counterfactuals", "1"]) == 0
    assert "hatn-sim: run without counterfactuals: highway-env" in capsys.readouterr().err
    assert not (out / "counterfactuals.jsonl").exists()


def test_a_rate_that_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["run", "intersection5", "--counterfactuals", "1.5"])
    assert "expected a share above 0 and up to 1, found '1.5'" in capsys.readouterr().err
