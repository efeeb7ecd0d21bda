"""The paper's numbers against what the paper says of them, and ours beside them."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hatn_sim import cli
from hatn_sim.datatypes import HORIZON_FRAMES, Score
from hatn_sim.errors import InputError
from hatn_sim.evaluation.arrays import displacement_scores, goal_scores, mean_score, slot_scores
from hatn_sim.evaluation.paper import (
    EDN,
    INTENTION,
    SCENARIOS,
    SGN,
    SOTA,
    SUMMARY,
    TABLES,
    PaperTable,
    scenario_of,
)
from hatn_sim.evaluation.table import (
    AblationRow,
    compare,
    entries_json,
    read_rows,
    with_summary,
    write_csv,
    write_rows,
)
from hatn_sim.report.paper_table import paper_table


def mean(table: PaperTable, row: str, scenario: str, measure: str = "ade_3s") -> float:
    return table.rows[row][scenario, measure].mean


def lower(table: PaperTable, row: str, than: str, scenario: str, measure: str = "ade_3s") -> float:
    """In per cent, rounded as the paper does in its text."""
    return 100.0 - 100.0 * mean(table, row, scenario, measure) / mean(
        table, than, scenario, measure
    )


# --- the paper's numbers


def test_every_row_has_every_number() -> None:
    for parts in TABLES.values():
        for table in parts:
            places = {(scenario, measure) for scenario in SCENARIOS for measure in table.measures}
            assert all(set(row) == places for row in table.rows.values()), table.key


def test_later_tables_begin_with_the_best_of_the_earlier_ones() -> None:
    a, b, c, d, e = EDN
    assert a.rows["Frenet"] == b.rows["no speed"]
    assert b.rows["speed in"] == c.rows["no yaw"]
    assert c.rows["yaw in"] == d.rows["neither"]
    assert d.rows["incremental, aligned"] == e.rows["neither"]
    for table in INTENTION:
        for scenario in SCENARIOS:
            for measure in table.measures:
                found = mean(table, "No-Intention", scenario, measure)
                assert found == mean(e, "neither", scenario, measure)
    assert SUMMARY.rows["Ours"] == SOTA.rows["HATN"]


def test_what_the_text_says_of_the_tables() -> None:
    goal = "goal_error"
    assert mean(SGN, "GAT", "roundabout", goal) / mean(SGN, "Ours", "roundabout", goal) == (
        pytest.approx(1.58, abs=0.01)  # "much higher errors ... (58 %)"
    )
    assert SGN.rows["Ours"]["intersection", "slot_accuracy"].mean == pytest.approx(0.905)
    # "with ADE in 3 seconds lower by 41 % and 34 %"
    assert lower(SOTA, "HATN", "Trajectron++", "intersection") == pytest.approx(41, abs=0.5)
    assert lower(SOTA, "HATN", "Trajectron++", "roundabout") == pytest.approx(34.8, abs=0.5)
    # "reduced the ADE in 3 seconds by 35 % and 57 %", "in 0.3 seconds by 91 % and 95 %"
    for measure, said in (("ade_3s", (35, 57)), ("ade_0s3", (91, 95))):
        for scenario, share in zip(SCENARIOS, said, strict=True):
            found = lower(SUMMARY, "Representation", "Feature", scenario, measure)
            assert found == pytest.approx(share, abs=1.1)


def test_scenes_are_like_the_papers_by_name() -> None:
    assert scenario_of("intersection5") == scenario_of("DR_USA_Intersection_EP0") == "intersection"
    assert scenario_of("highway_roundabout") == "roundabout"
    assert scenario_of("tjunction") is None


# --- ours beside them


def scores_of(row: str, scene: str, **values: float) -> tuple[Score, ...]:
    return tuple(
        Score(measure, row, scene, "all", "none", v, "m", 500, 0.9 * v, 1.1 * v, std=0.5 * v)
        for measure, v in values.items()
    )


ROWS = [
    AblationRow(
        "edn.a",
        "Frenet",
        scores_of("Frenet", "intersection5", ade_3s=0.5, fde_3s=1.25, ade_0s3=0.125)
        + scores_of("Frenet", "tjunction", ade_3s=0.75),
    ),
    AblationRow("edn.a", "lines from tracks", scores_of("x", "intersection5", fde_3s=2.0)),
    AblationRow("sgn", "GAT", scores_of("GAT", "roundabout8", slot_accuracy=0.875)),
]


def test_numbers_stand_beside_those_of_the_same_row() -> None:
    entries = {(e.scene, e.row, e.measure): e for e in compare(EDN[0], ROWS)}
    assert len(entries) == 2 * 3 * 2  # scenes, rows, measures
    frenet = entries["intersection5", "Frenet", "fde_3s"]
    assert frenet.paper is not None and frenet.ours is not None
    assert (frenet.paper.mean, frenet.paper.std, frenet.ours.value) == (1.87, 1.48, 1.25)
    cartesian = entries["intersection5", "Cartesian", "ade_3s"]
    assert cartesian.paper is not None and cartesian.ours is None
    more = entries["intersection5", "lines from tracks", "fde_3s"]
    assert more.paper is None and more.ours is not None
    elsewhere = entries["tjunction", "Frenet", "ade_3s"]
    assert elsewhere.paper is None and elsewhere.ours is not None
    assert entries["tjunction", "Frenet", "fde_3s"].ours is None


def test_a_row_may_come_in_parts() -> None:
    whole = AblationRow("sgn", "GAT", scores_of("GAT", "intersection5", goal_error=0.5))
    entries = {(e.scene, e.measure): e.ours for e in compare(SGN, [*ROWS, whole]) if e.row == "GAT"}
    assert [score is not None for score in entries.values()] == [True, False, False, True]


def test_without_ours_the_papers_numbers_stand_alone() -> None:
    entries = compare(SOTA, ROWS)
    assert {entry.scene for entry in entries} == set(SCENARIOS)
    assert all(entry.ours is None and entry.paper is not None for entry in entries)


def test_the_summary_shows_rows_of_other_tables() -> None:
    rows = with_summary(ROWS)
    assert [(row.table, row.name) for row in rows[len(ROWS) :]] == [("summary", "Baseline")]
    entries = {(e.row, e.measure): e for e in compare(SUMMARY, rows) if e.scene == "intersection5"}
    ours = entries["Baseline", "ade_0s3"].ours
    assert ours is not None and ours.value == 0.125
    given = AblationRow("summary", "Baseline", scores_of("b", "intersection5", ade_3s=0.25))
    assert with_summary([*ROWS, given]) == [*ROWS, given]


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    write_rows(path, ROWS)
    assert read_rows(path) == ROWS
    entries = compare(EDN[0], ROWS)
    write_csv(tmp_path / "edn.csv", entries)
    with (tmp_path / "edn.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    listed = json.loads(entries_json(entries))
    assert len(lines) == len(listed) == len(entries)
    for line, entry in zip(lines, listed, strict=True):
        assert list(line) == list(entry)
        assert line == {key: "" if v is None else str(v) for key, v in entry.items()}


WORDY = {**asdict(ROWS[0].scores[0]), "value": "0.5"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "expected rows of ablations, found none"),
        ('[{"table": "edn.a", "name": "x"}]', "expected rows of ablations, found none"),
        (
            json.dumps([{"table": "sgn", "name": "x", "scores": [WORDY]}]),
            "row 'x': ade_3s: expected numbers, found ",
        ),
        ('[{"table": "edn", "name": "x", "scores": []}]', "unknown table 'edn' of row 'x'"),
    ],
)
def test_a_file_of_other_things_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "rows.json"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_rows(path)
    assert str(caught.value).startswith(f"{path}: {expected}") and "\n" not in str(caught.value)


def printed(table: PaperTable, rows: list[AblationRow]) -> str:
    console = Console(file=io.StringIO(), width=100)
    console.print(paper_table(table, compare(table, rows), "runs"))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_tables_fit_a_hundred_columns() -> None:
    widest = tuple(
        AblationRow(table.key, name, scores_of(name, "intersection5", **{m: 12.5}))
        for parts in TABLES.values()
        for table in parts
        for name in table.rows
        for m in table.measures[:1]
    )
    for parts in TABLES.values():
        for table in parts:
            text = printed(table, list(widest))
            assert max(len(line.rstrip()) for line in text.splitlines()) <= 100, table.key
            assert "…" not in text
            for name in table.rows:
                assert name.split()[0] in text
    text = printed(EDN[0], ROWS)
    for part in ("1.87 ± 1.48", "1.250 ± 0.625", "[1.125 1.375]", "over runs"):
        assert part in text
    assert "87.50 ± 43.75" in printed(SGN, ROWS)
    assert "88.8 ± 31.53" in printed(SGN, [])  # as the paper prints it
    assert "interval" not in printed(SOTA, ROWS)


def test_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_rows(Path("rows.json"), ROWS)
    write_rows(Path("edn.json"), [row for row in ROWS if row.table != "sgn"])
    words = ["evaluate", "--table", "edn", "--rows", "rows.json"]
    assert cli.main([*words, "--out", "out"]) == 0
    text = capsys.readouterr().out
    assert text.count("Encoder decoder network (") >= 5 and "0.500 ± 0.250" in text
    assert Path("out/edn.csv").is_file()
    assert cli.main([*words, "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {entry["table"] for entry in listed} == {part.key for part in EDN}
    for other, expected in (
        (["--table", "sgn", "--rows", "no.json"], "no.json: there are no rows of ablations"),
        (["--table", "adaptation", "--rows", "rows.json"], "--rows is of no use to --table adapt"),
        (["--table", "sgn", "--rows", "edn.json"], "edn.json: expected rows of --table sgn, found"),
        (["--table", "sgn", "--risk", "assertive"], "--risk is of no use to --table sgn"),
        ([*words[1:], "--seeds", "1"], "--seeds is of no use with --rows"),
        (["--table", "adaptation", "--epochs", "1"], "--epochs is of no use to --table adaptation"),
        (
            ["--table", "edn", "--tracks", "a.csv"],
            "--tracks is of no use to --table edn; leave it out, or name recordings in a file: --s",
        ),
        (["--rows", "rows.json"], "--rows is of no use without --table"),
    ):
        assert cli.main(["evaluate", *other]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"hatn-sim: {expected}")


# --- scores from arrays


def by_measure(scores: tuple[Score, ...]) -> dict[tuple[str, str], Score]:
    return {(score.measure, score.subset): score for score in scores}


def test_displacements_by_hand() -> None:
    future = np.zeros((3, HORIZON_FRAMES, 2))
    predicted = future.copy()
    predicted[1, :, 1] = 0.1 * np.arange(1, HORIZON_FRAMES + 1)
    predicted[2, :, 0] = 4.0
    goal_m = np.array([0.5, 15.0, 3.0])
    cluster = np.array([0, 0, 1])
    found = by_measure(displacement_scores("n", "s", predicted, future, goal_m, cluster))
    by_hand = {"ade_3s": 1.55, "ade_0s3": 0.2, "fde_3s": 3.0, "fde_0s3": 0.3}
    for measure, expected in by_hand.items():
        every = [0.0, expected, 4.0]
        score, moving = found[measure, "all"], found[measure, "moving"]
        assert (score.n, score.value) == (3, pytest.approx(np.mean(every)))
        assert score.std == pytest.approx(np.std(every))
        assert (moving.n, moving.value) == (2, pytest.approx(np.mean(every[1:])))
        assert score.low is not None and score.high is not None
        assert score.low == pytest.approx(np.mean(every[:2])), "one run drawn twice"
        assert score.high == pytest.approx(4.0)
    exact = by_measure(displacement_scores("n", "s", future, future, goal_m, cluster))
    assert {score.value for score in exact.values()} == {0.0}


def test_goals_and_slots_by_hand() -> None:
    cluster = np.array([0, 1])
    goals = by_measure(goal_scores("n", "s", np.array([1.0, 9.0]), np.array([0.5, 5.0]), cluster))
    assert (goals["goal_error", "all"].value, goals["goal_error", "moving"].value) == (2.25, 4.0)
    probability = np.array([[0.75, 0.25, 0.0], [0.5, 0.25, 0.25]])
    slots = by_measure(slot_scores("n", "s", probability, np.array([0, 2]), cluster))
    assert slots["slot_accuracy", "all"].value == 0.5
    assert slots["slot_brier", "all"].value == pytest.approx((0.125 + 0.875) / 2)


def test_no_samples_have_no_value() -> None:
    nothing, nobody = np.zeros(0), np.zeros(0, dtype=np.int64)
    empty = np.zeros((0, HORIZON_FRAMES, 2))
    for score in displacement_scores("n", "s", empty, empty, nothing, nobody):
        assert (score.value, score.n, score.low, score.std) == (None, 0, None, None)
    none = np.zeros(0, dtype=np.bool_)
    assert mean_score("x", "n", "s", "all", nothing, none, nobody, unit="1").value is None
