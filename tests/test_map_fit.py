"""A map of another place is refused; one that covers a part is doubted beside the scores."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import crossing_lanes
from test_track_lines import DrivenTrack, traffic, write_recording

from hatn_sim import cli
from hatn_sim.datatypes import Kind
from hatn_sim.recordings.fit import share_on_lanes
from hatn_sim.recordings.lanelet2.writer import write_lanelet2


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for k in range(3):
        write_recording(tmp_path, f"{k:03d}", traffic(5, seed=k))
    lanes = crossing_lanes()
    write_lanelet2(tmp_path / "whole.osm", lanes)
    # The same crossing, and much of its traffic near it, but turned by a quarter of a right angle.
    write_lanelet2(tmp_path / "other.osm", crossing_lanes(np.pi / 8))
    write_lanelet2(tmp_path / "part.osm", [one for one in lanes if one.id not in ("n", "wn")])
    return tmp_path


def words(verb: str, site: Path, map_name: str, *more: str) -> list[str]:
    named = [verb, "--tracks", str(site / "vehicle_tracks_*.csv"), "--map", map_name]
    return [*named, "--out", "out", "--duration", "8", "--quiet", *more]


def test_share_on_lanes_by_hand() -> None:
    """Along a lane to the east at y = 0, against it, across it, and too far beside it."""
    east = [one for one in crossing_lanes() if one.id == "e"]
    xy_m = np.array([[50.0, 2.5], [50.0, 0.0], [50.0, 0.0], [50.0, 3.5], [50.0, 0.0]])
    yaw_rad = np.deg2rad([0.0, 180.0, 90.0, 0.0, -40.0])
    assert share_on_lanes(east, xy_m, yaw_rad) == pytest.approx(2 / 5)


@pytest.mark.parametrize(
    ("verb", "more"),
    [
        ("run", ("--predictor", "constant_velocity", "--recordings", "000")),
        (
            "run",
            ("--predictor", "constant_velocity", "--recordings", "000", "--lines-from", "auto"),
        ),
        ("evaluate", ("--predictors", "constant_velocity", "--workers", "1")),
    ],
)
def test_a_map_of_another_place_is_refused(
    site: Path, capsys: pytest.CaptureFixture[str], verb: str, more: tuple[str, ...]
) -> None:
    assert cli.main(words(verb, site, "other.osm", *more)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected vehicles on the lanes of other.osm, found " in line
    assert "% of the places of vehicles on a lane" in line
    assert line.endswith("seem not to belong together; give the map of this place, in its place")
    assert not Path("out").exists()


def test_a_map_that_covers_a_part_is_said_beside_the_scores(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = words("run", site, "part.osm", "--predictor", "constant_velocity", "--recordings", "000")
    assert cli.main([*run, "--no-picture"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    doubt = "is part.osm the map of this place, and whole?"
    assert "vehicle_tracks_000.csv: only " in told and doubt in told
    assert cli.main(["score", "out"]) == 0
    assert doubt in " ".join(capsys.readouterr().out.split())
    assert cli.main(["score", "out", "--json"]) == 0
    assert all(doubt in score["lines"] for score in json.loads(capsys.readouterr().out))
    (doubts,) = json.loads(Path("out", "run.json").read_text())["settings"]["doubts"]
    assert doubts.endswith(doubt)


def test_of_a_map_that_fits_nothing_is_said(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = words("run", site, "whole.osm", "--predictor", "constant_velocity", "--recordings", "000")
    assert cli.main([*run, "--no-picture"]) == 0
    assert "the map of this place" not in capsys.readouterr().out
    assert "doubts" not in json.loads(Path("out", "run.json").read_text())["settings"]


def test_who_is_parked_beside_the_road_tells_nothing_of_the_map(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten times as many stand on a car park, all the time, as drive along the lanes."""
    driven = traffic(2, seed=7)
    frames = max(len(one.xy_m) for one in driven)
    for k in range(60):
        spot_m = np.tile((10.0 + 2.5 * (k % 10), 10.0 + 5.0 * (k // 10)), (frames, 1))
        driven.append(DrivenTrack("900", f"parked{k}", Kind.CAR, spot_m, np.full(frames, 1.6)))
    write_recording(site, "900", driven)
    run = words("run", site, "whole.osm", "--predictor", "constant_velocity", "--recordings", "900")
    assert cli.main([*run, "--no-picture"]) == 0
    told = "".join(capsys.readouterr())
    assert "the map of this place" not in told
    assert "doubts" not in json.loads(Path("out", "run.json").read_text())["settings"]


def test_a_predictor_that_fails_at_once_leaves_no_folder(
    site: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("hasty.py").write_text(
        "class Hasty:\n    name = 'hasty'\n    def init(self, road): pass\n"
        "    def observe(self, *_): raise KeyError('x')\n    def predict(self, state): pass\n"
    )
    monkeypatch.syspath_prepend(str(site))
    for _ in range(2):
        assert cli.main(words("run", site, "whole.osm", "--predictor", "hasty:Hasty")) == 2
        assert "predictor 'hasty' failed at " in capsys.readouterr().err
        assert not Path("out").exists()
