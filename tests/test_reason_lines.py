"""Lines of `suggestions.jsonl` in which the reason alone is new, of a real run."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hatn_sim import cli
from hatn_sim.log import RunWriter, read_run
from hatn_sim.log.schema import SUGGESTIONS_FILE
from hatn_sim.score.logged import advised_in

WORDS = [
    "run",
    "intersection5",
    "--density",
    "dense",
    "--risk",
    "inattentive",
    "--duration",
    "10",
    "--seed",
    "301",
    "--assist",
    "--quiet",
    "--no-picture",
    "--json",
    "--out",
]
Told = dict[str, tuple[Any, ...]]
"""What egos are told: action, slot, why; and where that is not silence whether it is feasible, and
whether a time is told."""


def told(one: dict[str, Any]) -> tuple[Any, ...]:
    always = one["action"], one["slot_id"], one["reason"]
    silent = one["action"] == "abstain"
    return always if silent else (*always, one["feasible"], one["target_time_s"] is None)


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (path / SUGGESTIONS_FILE).read_text().splitlines()]


def without_reasons_alone(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those in which what is advised changes: as if reasons had no lines."""
    last: dict[str, Any] = {}
    kept: list[dict[str, Any]] = []
    for line in lines:
        feasible = line["action"] == "abstain" or line.get("feasible")
        advised = (line["action"], line.get("slot_id"), feasible)
        if last.get(line["ego_id"]) != advised:
            kept.append(line)
        last[line["ego_id"]] = advised
    return kept


def test_a_new_reason_has_its_line_and_scores_do_not_see_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    advised: dict[int, Told] = {}
    write = RunWriter.write

    def watched(writer: RunWriter, index: int, frame: Any, advice: Any) -> None:
        main = next(iter(advice.values()))
        advised[index] = {one.ego_id: told(asdict(one)) for one in main.suggestions}
        write(writer, index, frame, advice)

    monkeypatch.setattr(RunWriter, "write", watched)
    out, bare = tmp_path / "run", tmp_path / "bare"
    assert cli.main([*WORDS, str(out)]) == 0
    lines = lines_of(out)

    # Carried on from line to line, the log tells every ego what it was told, at every moment.
    assert sorted(advised) == list(range(100))
    now: Told = {}
    for index in range(100):
        for line in lines:
            if line["frame"] != index:
                continue
            name, before = line["ego_id"], now.pop(line["ego_id"], None)
            if line["action"] is not None:
                now[name] = told(line)
            assert now.get(name) != before, "a line in which nothing is new"
        assert now == advised[index], index

    kept = without_reasons_alone(lines)
    alone = [line for line in lines if line not in kept]
    assert len(alone) > 5 and {line["action"] for line in alone} >= {"abstain", "yield"}
    shutil.copytree(out, bare)
    (bare / SUGGESTIONS_FILE).write_text("".join(f"{json.dumps(line)}\n" for line in kept))
    head = json.loads((bare / "run.json").read_text())
    head["line_counts"][SUGGESTIONS_FILE] = len(kept)
    (bare / "run.json").write_text(json.dumps(head))
    scored, expected = advised_in(read_run(out)), advised_in(read_run(bare))
    assert scored.encounters > 5 and scored.sampled > 100 and len(scored.probability) > 20
    np.testing.assert_equal(asdict(scored), asdict(expected))
