"""Distances of vehicles to their lines, on hand-drawn roads where they are known."""

from __future__ import annotations

import json
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import lane, scene_of

from hatn_sim.commands import fidelity as command
from hatn_sim.datatypes import Frame, Route, Truth
from hatn_sim.errors import InputError
from hatn_sim.road import Road
from hatn_sim.score.fidelity import Closeness, measure_fidelity

TWO_LANES = (lane("right", [(0, 0), (300, 0)]), lane("left", [(0, 4), (300, 4)]))


def frame(
    time_s: float,
    places: dict[str, tuple[float, float]],
    routes: dict[str, Route],
    collisions: tuple[tuple[str, str], ...] = (),
) -> Frame:
    """Cars at x, y that drive east at 10 m/s."""
    scene = scene_of(time_s, {name: (x, y, 0.0, 10.0) for name, (x, y) in places.items()})
    truth = Truth(routes=tuple(routes.get(name) for name in scene.ids), collisions=collisions)
    return Frame(scene, truth, done=False)


def found(frames: Iterator[Frame], warm_up_s: float = 0.0) -> dict[tuple[str, str], Closeness]:
    rows = measure_fidelity(frames, Road(TWO_LANES), warm_up_s)
    assert [row.mode for row in rows] == ["route"] * 4 + ["inferred"] * 4
    return {(row.mode, row.state): row for row in rows}


def test_offsets_from_a_straight_lane_are_read_off() -> None:
    def frames() -> Iterator[Frame]:
        for k in range(100):
            places = {"a": (10.0 + k, 0.25), "b": (10.0 + k, 4.0 - (0.5 if k == 99 else 0.0))}
            yield frame(0.1 * k, places, {"a": ("right",), "b": ("left",)})

    rows = found(frames())
    for mode in ("route", "inferred"):
        row = rows[mode, "all"]
        assert (row.n, row.without_line, row.within_1_m) == (200, 0.0, 1.0)
        assert row.median_m == pytest.approx(0.25) and row.max_m == pytest.approx(0.5)
        # 199 of 200 are at most 0.25 m off: the 99 % quantile is the 198.01st of 0 ... 199
        assert row.q99_m == pytest.approx(0.25)
        assert rows[mode, "keeping lane"].n == 200
        assert rows[mode, "changing lanes"] == Closeness(
            mode, "changing lanes", 0, None, None, None, None, None, None
        )
    assert found(frames(), warm_up_s=5.0)["route", "all"].n == 100


def test_a_change_of_lanes_counts_three_seconds_to_either_side() -> None:
    def frames() -> Iterator[Frame]:
        for k in range(150):
            y = float(np.clip((k - 60) * 0.1, 0.0, 4.0))  # half way at k = 80
            routes: dict[str, Route] = {"a": ("right",) if k < 80 else ("left",), "b": ("right",)}
            yield frame(0.1 * k, {"a": (10.0 + k, y), "b": (100.0 + k, 0.0)}, routes)

    rows = found(frames())
    changing = rows["route", "changing lanes"]
    assert changing.n == 61
    assert changing.max_m == pytest.approx(2.0)
    assert rows["route", "keeping lane"].n == 300 - 61
    assert rows["route", "keeping lane"].max_m == 0.0
    assert rows["inferred", "changing lanes"].n == 61


def test_who_touched_another_is_crashed_from_then_on() -> None:
    def frames() -> Iterator[Frame]:
        for k in range(40):
            places = {"a": (10.0 + k, 0.0), "b": (12.0 + k, 0.0), "c": (60.0 + k, 4.0)}
            pairs = (("a", "b"),) if k == 30 else ()
            yield frame(0.1 * k, places, {"a": ("right",), "b": ("right",)}, pairs)

    rows = found(frames())
    assert rows["route", "crashed"].n == 20
    assert rows["route", "all"].without_line == pytest.approx(1 / 3)  # c has no route
    assert rows["inferred", "all"].without_line == 0.0


def test_nobody_is_no_number() -> None:
    for row in measure_fidelity([frame(0.0, {}, {})], Road(TWO_LANES)):
        assert row.n == 0 and row.max_m is None and row.without_line is None


def words(scene: str, **more: object) -> SimpleNamespace:
    arguments = {"duration": 3.0, "seed": None, "warm_up": None, "json": False} | more
    return SimpleNamespace(fidelity=scene, **arguments)


def test_the_command_prints_a_table_or_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(words("highway_merge")) == 0  # type: ignore[arg-type]
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "distance of vehicles to their lines: highway_merge, seed 1, 3 s"
    assert [line.split()[0] for line in lines[2:]] == ["route"] * 4 + ["inferred"] * 4
    assert command.main(words("highway_merge", json=True, seed=2)) == 0  # type: ignore[arg-type]
    said = json.loads(capsys.readouterr().out)
    assert (said["scene"], said["seed"], said["duration_s"]) == ("highway_merge", 2, 3.0)
    assert said["closeness"][0]["state"] == "all"
    assert said["closeness"][0]["n"] > 100


def test_the_command_knows_scenes_only() -> None:
    with pytest.raises(InputError, match="unknown scene 'highway_merg'; did you mean 'highway_me"):
        command.main(words("highway_merg"))  # type: ignore[arg-type]
