"""The JSON Schemas of suggestions, alerts and counterfactuals that ship, against logs of runs."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from hatn_sim import cli
from hatn_sim.assist.choice import Why
from hatn_sim.datatypes import Alert, SafetyEvent, Suggestion
from hatn_sim.log import read_run
from hatn_sim.log.schema import (
    ALERTS_FILE,
    ASSISTANCE_SCHEMA_FILE,
    COUNTERFACTUALS_FILE,
    COUNTERFACTUALS_SCHEMA_FILE,
    SCHEMA_VERSION,
    SUGGESTIONS_FILE,
)
from hatn_sim.score.counterfactual import AlertVerdict, SlotCost
from hatn_sim.score.counterfactual_tally import VERDICTS


def shipped(name: str) -> dict[str, Any]:
    return json.loads(files("hatn_sim.log").joinpath(name).read_text(encoding="utf-8"))


SCHEMA = shipped(ASSISTANCE_SCHEMA_FILE)
COUNTERFACTUALS = jsonschema.Draft202012Validator(shipped(COUNTERFACTUALS_SCHEMA_FILE))


def validator(line: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator({**SCHEMA, "$ref": f"#/$defs/{line}"})


def test_every_reason_is_in_the_schema_and_explained() -> None:
    told = SCHEMA["$defs"]["suggestion"]["properties"]["reason"]
    assert told["enum"] == [one.name.lower() for one in Why]
    assert all(f"{one}: " in told["description"] for one in told["enum"])


def test_it_is_a_schema_of_the_version_of_the_log() -> None:
    for name in (ASSISTANCE_SCHEMA_FILE, COUNTERFACTUALS_SCHEMA_FILE):
        schema = shipped(name)
        jsonschema.Draft202012Validator.check_schema(schema)
        assert schema["version"] == SCHEMA_VERSION
        assert f"Version {SCHEMA_VERSION}." in schema["description"]


def test_lines_of_a_run_are_of_the_schema(tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ["run", "intersection5", "--risk", "inattentive", "--duration", "20", "--seed", "301"]
    assert (
        cli.main([*words, "--assist", "--quiet", "--no-picture", "--json", "--out", str(out)]) == 0
    )
    lines = {}
    for name, line in ((SUGGESTIONS_FILE, "suggestion_line"), (ALERTS_FILE, "alert_line")):
        lines[name] = [json.loads(one) for one in (out / name).read_text().splitlines()]
        check = validator(line)
        for one in lines[name]:
            check.validate(one)
    told = lines[SUGGESTIONS_FILE]
    assert {one["action"] for one in told} >= {"yield", "pass", None}
    logged = [change for change in read_run(out).suggestions if change.suggestion is not None]
    said = [one.suggestion for one in logged if one.suggestion and one.suggestion.profile_mps]
    assert said and all(len(one.profile_mps) == 50 for one in said)
    assert all(one.action != "abstain" for one in said)
    # The advice of one who leaves ends.
    left = {one["ego_id"] for one in told} - set(list(read_run(out).scenes())[-1].ids)
    last = {one["ego_id"]: one["action"] for one in told}
    assert left and all(last[name] is None for name in left)


@pytest.mark.parametrize(
    "wrong",
    [
        {"frame": 1, "ego_id": "a", "action": "hurry"},
        {"frame": 1, "ego_id": "a", "action": "yield"},
        {"frame": -1, "ego_id": "a", "action": None},
        {"frame": 1, "ego_id": "a", "action": None, "more": 1},
    ],
)
def test_other_lines_are_not(wrong: dict[str, Any]) -> None:
    assert not validator("suggestion_line").is_valid(wrong)


@pytest.mark.parametrize("action", ["yield", "pass", "abstain"])
def test_a_suggestion_of_each_action(action: str) -> None:
    said = Suggestion(
        "a", 1.0, action, "b", 0.9, 0.8, None, 3.0, False, "Wait", (3.0,) * 50, "held"
    )
    validator("suggestion_line").validate({"frame": 0, **plain(said)})
    silent = {"target_time_s": None, "advised_speed_mps": None, "profile_mps": []}
    validator("suggestion_line").validate({"frame": 0, **plain(said), **silent})
    assert not validator("suggestion_line").is_valid({"frame": 0, **plain(said), "reason": ""})
    longer = replace(said, profile_mps=(3.0,) * 51)
    assert not validator("suggestion_line").is_valid({"frame": 0, **plain(longer)})


@pytest.mark.parametrize("type_", ["CONFLICT", "DEVIATION"])
@pytest.mark.parametrize("edge", ["onset", "peak", "end"])
def test_an_alert_of_each_edge(edge: str, type_: str) -> None:
    said = Alert("a00001", edge, type_, 1.0, "a", "b", 0.5, "they meet")
    validator("alert_line").validate({"frame": 0, **plain(said)})
    for wrong in ({"edge": "middle"}, {"type": "WORRY"}, {"severity": 1.5}, {"other_id": ""}):
        assert not validator("alert_line").is_valid({"frame": 0, **plain(said), **wrong})
    told = replace(said, action="brake", room_m=-0.2, open_s=2.5, text="Brake: let it go first")
    validator("alert_line").validate({"frame": 0, **plain(told)})
    for wrong in ({"action": "swerve"}, {"open_s": -1.0}, {"open_s": 7.0}):
        assert not validator("alert_line").is_valid({"frame": 0, **plain(told), **wrong})


def plain(said: Suggestion | Alert) -> dict[str, Any]:
    """As it is read from a file."""
    return json.loads(json.dumps(asdict(said)))


ALERT: dict[str, Any] = {
    "frame": 95,
    "time_s": 9.5,
    "ego_id": "a",
    "about": "alert",
    "lost": False,
    "alert_id": "a00001",
    "type": "CONFLICT",
    "other_id": "b",
    "action": "brake",
}
SUGGESTION: dict[str, Any] = {
    "frame": 95,
    "time_s": 9.5,
    "ego_id": "a",
    "about": "suggestion",
    "lost": False,
    "action": "pass",
    "slot_id": "b",
}
EVENT = SafetyEvent("T2", "a", "b", 12.4, "emergency braking", 0.3)
CONTACT = SafetyEvent("T1", "a", "b", 12.6, "contact")
COST = SlotCost(0.0, None, 0.0, 0.5, 0, 0, 0.25)
JUDGED: dict[str, Any] = {
    "slots": [{"action": action, "slot_id": "b", **asdict(COST)} for action in ("yield", "pass")],
    "driver": asdict(COST),
    "driver_action": None,
    "regret": 0.0,
    "always_yield_regret": 2.5,
    "driver_regret": -1.0,
    "slots_differ": True,
    "best_total": -0.75,
    "regret_to_best": 1.0,
}


@pytest.mark.parametrize(
    ("said", "right"),
    [
        # Of an alert: every verdict, a branch that was lost, what is missing or too much.
        *(
            (ALERT | asdict(AlertVerdict(verdict, (EVENT, CONTACT), (), -1.5, 0.0, 2.5)), True)
            for verdict in VERDICTS
        ),
        (ALERT | asdict(AlertVerdict("fine", (), (), 0.0, 0.0, 0.0)), False),
        (ALERT, False),
        (ALERT | {"lost": True}, True),
        (ALERT | {"lost": True, "type": "WORRY"}, False),
        (ALERT | {"lost": True, "more": 1}, False),
        # Of a suggestion.
        (SUGGESTION | JUDGED, True),
        (SUGGESTION | JUDGED | {"action": "yield", "driver_action": "pass"}, True),
        (SUGGESTION | JUDGED | {"driver_action": "b"}, False),
        (SUGGESTION | JUDGED | {"action": "abstain"}, False),
        (SUGGESTION | JUDGED | {"regret": -0.1}, False),
        (SUGGESTION | JUDGED | {"slots": JUDGED["slots"][:1]}, False),
        (SUGGESTION | JUDGED | {"driver": asdict(COST) | {"more": 1}}, False),
        (SUGGESTION, False),
        (SUGGESTION | {"lost": True}, True),
        # Of both, or of neither.
        (SUGGESTION | JUDGED | {"alert_id": "a00001"}, False),
        (ALERT | {"lost": True, "about": "weather"}, False),
    ],
)
def test_what_a_line_of_counterfactuals_may_be(said: dict[str, Any], right: bool) -> None:
    assert COUNTERFACTUALS.is_valid(json.loads(json.dumps(said))) == right


def test_lines_of_counterfactuals_are_of_the_schema(tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ["run", "do_warn_crossing", "--seed", "301", "--warm-up", "4", "--duration", "14"]
    words += ["--counterfactuals", "1", "--quiet", "--no-picture", "--json", "--out", str(out)]
    assert cli.main(words) == 0
    lines = [json.loads(one) for one in (out / COUNTERFACTUALS_FILE).read_text().splitlines()]
    assert {one["about"] for one in lines} == {"alert", "suggestion"}
    for one in lines:
        COUNTERFACTUALS.validate(one)
    for one in (one for one in lines if one["about"] == "suggestion"):
        said = [(slot["action"], slot["slot_id"]) for slot in one["slots"]]
        totals = [slot["total"] for slot in one["slots"]]
        own = totals[said.index((one["action"], one["slot_id"]))]
        assert one["regret"] == own - min(totals)
        assert one["regret_to_best"] == own - min(*totals, one["driver"]["total"])


def test_all_advised_leaves_nobody_to_adapt(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "tjunction", "--assist", "--adapt", "mekf"]) == 2
    assert "nobody who is advised is adapted" in capsys.readouterr().err
