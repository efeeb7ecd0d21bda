"""Inferred lines held against true ones: samples, shares and scores by hand; command and figure."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import lane, scene_of

from hatn_sim.commands import evaluate_lines
from hatn_sim.datatypes import Lines
from hatn_sim.errors import InputError
from hatn_sim.road import Road
from hatn_sim.score.line_accuracy import (
    INSIDE_M,
    LineSamples,
    PassageBook,
    judge_lines,
    line_scores,
    pooled,
    share_by_distance,
    told_share,
)


def fork() -> Road:
    """One lane to a junction at x = 0: straight on into two lanes of one edge, and left.

    The left turn is split in two inside the junction. Edges are named before the underscore.
    """
    return Road(
        [
            lane("in_0", [(-100, 0), (0, 0)], "x0", "x1", "y0"),
            lane("x0", [(0, 0), (20, 0)], "out_0", is_connection=True),
            lane("x1", [(0, 0), (20, 3)], "out_1", is_connection=True),
            lane("y0", [(0, 0), (10, 0)], "y1", is_connection=True, turn=1),
            lane("y1", [(10, 0), (10, 20)], "left_0", is_connection=True, turn=1),
            lane("out_0", [(20, 0), (200, 0)]),
            lane("out_1", [(20, 3), (200, 3)]),
            lane("left_0", [(10, 20), (10, 200)]),
        ]
    )


def edge(name: str) -> str:
    return name.partition("_")[0]


STRAIGHT, BESIDE, LEFT = (
    ("in_0", "x0", "out_0"),
    ("in_0", "x1", "out_1"),
    (
        "in_0",
        "y0",
        "y1",
        "left_0",
    ),
)


def lines_of(road: Road, routes: list[tuple[str, ...] | None], s_m: list[float]) -> Lines:
    line = np.array([-1 if route is None else road.line(route) for route in routes])
    nothing = np.zeros(len(line))
    return Lines(line, np.array(s_m), nothing, nothing, np.full(len(line), 0.5))


def judged(
    true: tuple[str, ...], mine: tuple[str, ...] | None, s_m: float, blinker: int = 0
) -> LineSamples:
    """The sample of a car of 5 m whose centre is at s on both lines."""
    road = fork()
    scene = scene_of(0.0, {"v": (s_m - 100.0, 0.0, 0.0, 5.0)}, blinker)
    mine_lines, true_lines = lines_of(road, [mine], [s_m]), lines_of(road, [true], [s_m])
    return judge_lines(road, PassageBook(road, edge), scene, mine_lines, true_lines)


def test_passages_by_hand() -> None:
    road = fork()
    (one,) = PassageBook(road, edge).passages(road.line(LEFT))
    assert (one.approach, one.connections, one.exit_lane) == ("in", ("y0", "y1"), "left_0")
    assert (one.entry_s_m, one.end_s_m, one.turn, one.has_choice) == (100.0, 130.0, 1, True)
    (inside,) = PassageBook(road, edge).passages(road.line(("y1", "left_0")))
    assert (inside.approach, inside.entry_s_m, inside.has_choice) == ("", 0.0, False)


@pytest.mark.parametrize(
    ("true", "mine", "s_m", "distance_m", "right"),
    [
        (LEFT, LEFT, 60.0, 37.5, True),
        (LEFT, STRAIGHT, 60.0, 37.5, False),
        (STRAIGHT, BESIDE, 97.0, 0.5, True),  # before the junction the exit counts
        (STRAIGHT, BESIDE, 97.5, INSIDE_M, False),  # inside it the lane
        (STRAIGHT, None, 97.5, INSIDE_M, False),
        (LEFT, LEFT, 105.0, INSIDE_M, True),
        (LEFT, ("y1", "left_0"), 110.0, INSIDE_M, True),  # of what is still to be driven
    ],
)
def test_samples_by_hand(
    true: tuple[str, ...],
    mine: tuple[str, ...] | None,
    s_m: float,
    distance_m: float,
    right: bool,
) -> None:
    sample = judged(true, mine, s_m)
    assert sample.vehicle.tolist() == ["v"]
    assert sample.distance_m[0] == pytest.approx(distance_m)
    assert sample.right.tolist() == [right]
    assert sample.has_line.tolist() == [mine is not None]
    assert sample.probability.tolist() == [0.0 if mine is None else 0.5]
    assert sample.turn.tolist() == [1 if true == LEFT else 0]


def test_who_is_no_sample() -> None:
    assert len(judged(STRAIGHT, STRAIGHT, 10.0).vehicle) == 0, "further than 80 m"
    assert len(judged(STRAIGHT, STRAIGHT, 150.0).vehicle) == 0, "past the last junction"
    scene = scene_of(0.0, {"v": (0.0, 0.0, 0.0, 5.0)})
    none = lines_of(fork(), [None], [0.0])
    empty = judge_lines(fork(), PassageBook(fork(), edge), scene, none, none)
    assert len(empty.vehicle) == 0, "on no route"
    assert [score.value for score in line_scores(empty, "x")] == [None] * 10


def a_run() -> LineSamples:
    """Inside: 3 of 4 right. On the last 20 m: 2 of 3 right, blinkers on at the first two."""
    return pooled(
        [
            *[judged(LEFT, LEFT, 105.0, 1)] * 2,
            judged(STRAIGHT, STRAIGHT, 105.0),
            judged(STRAIGHT, BESIDE, 105.0),
            judged(LEFT, LEFT, 90.0, 1),
            judged(STRAIGHT, LEFT, 95.0, 1),
            judged(STRAIGHT, STRAIGHT, 80.0),
            judged(STRAIGHT, None, 50.0),
        ]
    )


def test_a_line_under_the_number_of_another_has_its_own_passages() -> None:
    road = fork()
    book = PassageBook(road, edge)
    straight = road.line(STRAIGHT)
    assert [one.exit for one in book.passages(straight)] == ["out"]
    road.touch(np.array([-1]))
    road.release(idle_frames=0)
    assert road.line(LEFT) == straight
    assert [one.exit for one in book.passages(straight)] == ["left"]


def test_scores_by_hand() -> None:
    scores = {score.measure: score for score in line_scores(a_run(), "here")}
    found = {name.removeprefix("line_"): (s.value, s.n) for name, s in scores.items()}
    assert found == {
        "right_inside": (0.75, 4),
        "right_inside_choice": (0.75, 4),
        "right_20m_blinker": (0.5, 2),
        "right_20m": (pytest.approx(2 / 3), 3),
        "right_20m_choice": (pytest.approx(2 / 3), 3),
        "right_when_given": (pytest.approx(5 / 7), 7),
        "mean_probability": (0.5, 7),
        "fallback_share": (0.125, 8),
        "wrong_lane_share": (0.25, 4),
        "told_20m_blinker": (0.5, 2),
    }
    assert {score.scene for score in scores.values()} == {"here"}


def test_what_approach_and_blinker_tell_by_hand() -> None:
    """Three signal left and two of them turn; whoever knows that is right about two of three."""
    samples = pooled([judged(way, None, 90.0, 1) for way in (LEFT, LEFT, STRAIGHT)])
    assert told_share(samples) == (pytest.approx(2 / 3), 3)
    assert told_share(pooled([judged(LEFT, LEFT, 90.0, 0)])) == (None, 0)


def test_shares_by_distance_by_hand() -> None:
    run = a_run()
    share, count = share_by_distance(run, np.ones(len(run.vehicle), dtype=np.bool_))
    assert count.tolist() == [4, 2, 1, 0, 1, 0]
    np.testing.assert_allclose(share, [0.75, 0.5, 1.0, np.nan, 0.0, np.nan])


def arguments(tmp_path: Path, **more: object) -> argparse.Namespace:
    given = {
        "table": "lines",
        "scenes": ("tjunction",),
        "seeds": (3,),
        "duration": 20.0,
        "warm_up": 20.0,
        "out": tmp_path / "out",
        "json": True,
        "quiet": True,
    }
    return argparse.Namespace(**(given | more))


def test_the_command_scores_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate_lines.main(arguments(tmp_path)) == 0
    scores = {one["measure"]: one for one in json.loads(capsys.readouterr().out)}
    assert scores["line_right_inside"]["value"] > 0.9
    assert scores["line_right_inside"]["predictor"] == "lines"
    assert (tmp_path / "out" / "lines.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "out" / "lines.pdf").read_bytes()[:4] == b"%PDF"
    assert json.loads((tmp_path / "out" / "scores.json").read_text("utf-8"))
    with pytest.raises(InputError, match="exists already"):
        evaluate_lines.main(arguments(tmp_path))


def test_the_command_prints_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate_lines.main(arguments(tmp_path, json=False)) == 0
    printed = capsys.readouterr().out
    assert "tjunction: inferred lines that are right" in printed
    assert "inside a junction" in printed
    assert "metres to the junction" in printed


def test_a_run_that_is_over_before_the_first_sample(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    street = str(Path(__file__).parent / "nets" / "street.sumocfg")
    over = arguments(tmp_path, scenes=(street,), warm_up=3000.0, json=False, quiet=False)
    assert evaluate_lines.main(over) == 0
    printed = capsys.readouterr()
    assert "no vehicle came near a junction" in printed.err
    assert "inside a junction" in printed.out and "0.0 %" not in printed.out
    assert (tmp_path / "out" / "lines.png").exists()


def test_recorded_tracks_are_left_out(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="recorded_sample: recorded tracks know no routes"):
        evaluate_lines.main(arguments(tmp_path, scenes=("recorded_sample",)))
