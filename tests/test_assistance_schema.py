"""The JSON Schema of suggestions and alerts that ships, against the logs of runs."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from hatn_sim import cli
from hatn_sim.log import read_run
from hatn_sim.log.schema import (
    ALERTS_FILE,
    ASSISTANCE_SCHEMA_FILE,
    SCHEMA_VERSION,
    SUGGESTIONS_FILE,
)

SCHEMA: dict[str, Any] = json.loads(
    files("hatn_sim.log").joinpath(ASSISTANCE_SCHEMA_FILE).read_text(encoding="utf-8")
)


def validator(line: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator({**SCHEMA, "$ref": f"#/$defs/{line}"})


def test_it_is_a_schema_of_the_version_of_the_log() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["version"] == SCHEMA_VERSION


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
    assert len(logged[0].suggestion.profile_mps) == 50  # type: ignore[union-attr]
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


def test_all_advised_leaves_nobody_to_adapt(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "tjunction", "--assist", "--adapt", "mekf"]) == 2
    assert "nobody who is advised is adapted" in capsys.readouterr().err
