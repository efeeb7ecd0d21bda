"""A choice of lines fitted to other recordings than the one that is scored."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import crossing_lanes
from test_track_lines import traffic as drivers
from test_track_lines import write_recording

from hatn_sim import cli
from hatn_sim.config import Scenario, load_tracks
from hatn_sim.errors import HatnSimError
from hatn_sim.learn import others_choice
from hatn_sim.learn.line_choice import ChoiceFigures, choice_figures, fit_line_choice
from hatn_sim.learn.line_samples import ChoiceSamples, choice_samples, joined
from hatn_sim.learn.others_choice import EVERY_FRAMES, OthersChoice, choices_of_others
from hatn_sim.learn.sources import played
from hatn_sim.learn.split import Traffic
from hatn_sim.learn.watch import Nobody
from hatn_sim.line_choice import HAND_MADE_CHOICE, LineChoice, shipped_line_choice
from hatn_sim.log import Run, read_run
from hatn_sim.log.choice_file import read_run_choice
from hatn_sim.perception import begin, choose_lines_by
from hatn_sim.recordings.each import each_recording
from hatn_sim.recordings.lanelet2.writer import write_lanelet2
from hatn_sim.recordings.track_lines import source
from hatn_sim.road import Road
from hatn_sim.score.line_origin import said_lines

RECORDINGS = ("000", "001", "002", "003")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where `evaluate` leaves its folders; sums of torch are in one order."""
    torch.set_num_threads(1)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def make_site(folder: Path, vehicles: int = 8) -> Path:
    write_lanelet2(folder / "map.osm", crossing_lanes())
    for k, name in enumerate(RECORDINGS):
        write_recording(folder, name, drivers(vehicles, seed=k))
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of a crossing where turns are cut by metres, eight vehicles on each way."""
    return make_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def keep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("keep")


@pytest.fixture(scope="module")
def found(site: Path, keep: Path) -> OthersChoice:
    """What is fitted for 000, kept in a folder."""
    torch.set_num_threads(1)
    return found_for(scenes(site, "000"), keep)["000"]


def scenes(site: Path, *recordings: str) -> dict[str, Scenario]:
    tracks = [str(site / "vehicle_tracks_*.csv")]
    return each_recording(load_tracks(tracks, site / "map.osm", recordings), "auto")


class Told(Nobody):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, line: str) -> None:
        self.lines.append(line)


def found_for(
    by_name: dict[str, Scenario],
    keep: Path | None = None,
    workers: int = 1,
    starts: Sequence[LineChoice] = (),
) -> dict[str, OthersChoice]:
    return choices_of_others(by_name, starts or [shipped_line_choice()], 2, keep, workers, Nobody())


def samples_on(scene: Scenario, recording: str) -> ChoiceSamples:
    """The choices in a recording, on the lines of a scene."""
    assert scene.recorded is not None
    there = replace(scene, recorded=replace(scene.recorded, recordings=(recording,)))
    with played(Traffic("test", there, 0, 0.0, None, ())) as (simulator, frames):
        return choice_samples(simulator.road, frames, shipped_line_choice(), EVERY_FRAMES)


# -- what is fitted to --------------------------------------------------------------------------


def test_it_is_better_on_the_recording_that_it_has_not_seen(
    site: Path, found: OthersChoice
) -> None:
    by_name = scenes(site, "000")
    assert found.choice is not None and found.recordings == RECORDINGS[1:]
    unseen = samples_on(by_name["000"], "000")
    before, after = (
        choice_figures(unseen, shipped_line_choice()),
        choice_figures(unseen, found.choice),
    )
    assert after.n == before.n > 20
    assert after.log_loss < before.log_loss and after.wrong <= before.wrong
    # The figures that it was taken for, worked out here.
    parts = [samples_on(by_name["000"], name) for name in found.recordings]
    assert found.cases == sum(map(len, parts))
    halves = joined([parts[0], parts[2]]), parts[1]

    def over(figures: Sequence[ChoiceFigures]) -> tuple[int, float, float]:
        counts = [one.n for one in figures]
        wrong = np.average([one.wrong for one in figures], weights=counts)
        log_loss = np.average([one.log_loss for one in figures], weights=counts)
        return sum(counts), float(wrong), float(log_loss)

    start = shipped_line_choice()
    crossed = [choice_figures(halves[k], fit_line_choice(halves[1 - k], start)) for k in range(2)]
    assert found.fitted == pytest.approx(over(crossed), abs=1e-4)
    assert found.before == pytest.approx(over([choice_figures(h, start) for h in halves]), abs=1e-4)


def test_the_scored_recording_has_no_part_in_it(tmp_path: Path, found: OthersChoice) -> None:
    site = make_site(tmp_path)
    own = site / "vehicle_tracks_000.csv"
    head = own.read_text().partition("\n")[0]
    own.write_text(f"{head}\nno,numbers\n")  # what is in there is not even read
    again = found_for(scenes(site, "000"))["000"]
    assert again.choice is not None and again.about() == found.about()
    # Those of the others have a part.
    other = site / "vehicle_tracks_003.csv"
    other.write_text(f"{head}\nno,numbers,either\n")  # a copy of the first would have no part
    with pytest.raises(HatnSimError, match=r"003\.csv"):
        found_for(scenes(site, "000"))


@pytest.mark.slow
def test_every_recording_has_that_of_the_others_with_any_number_of_workers(
    site: Path, found: OthersChoice
) -> None:
    both = found_for(scenes(site, "000", "002"), workers=2)
    assert list(both) == ["000", "002"]
    assert both["000"].about() == found.about()
    assert both["002"].recordings == ("000", "001", "003")
    assert both["002"].choice is not None and both["002"].about() != found.about()


def test_the_same_lines_drawn_by_others_are_no_reason_to_be_fitted_to(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two recordings may both add nothing to the lines: neither may learn from itself."""
    by_name = scenes(site, "000", "001")
    for name, scene in by_name.items():
        assert scene.recorded is not None and scene.recorded.drawn is not None
        drawn = replace(scene.recorded.drawn, sha256="the same")
        by_name[name] = replace(scene, recorded=replace(scene.recorded, drawn=drawn))
    monkeypatch.setattr("hatn_sim.learn.others_choice.MOST_S", 0.5)  # too short for any choice
    found = found_for(by_name)
    assert {one.cases for one in found.values()} == {0}
    assert found["000"].recordings == ("001", "002", "003")
    assert found["001"].recordings == ("000", "002", "003")


@pytest.mark.slow
def test_one_that_is_not_better_is_not_taken(
    site: Path, found: OthersChoice, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_name = scenes(site, "000")
    by_hand = HAND_MADE_CHOICE.to_arrays()
    worse = LineChoice.from_arrays({**by_hand, "linear": -by_hand["linear"]})
    with monkeypatch.context() as patch:
        patch.setattr("hatn_sim.learn.others_choice.fit_line_choice", lambda *_: worse)
        told = Told()
        refused = choices_of_others(by_name, [shipped_line_choice()], 2, None, 1, told)["000"]
    assert refused.choice is None and refused.about()["source"] == "weights"
    assert refused.fitted is not None and "000: as in the weights; 001, 002, 003" in told.lines[-1]
    # It has to be better than each of those that are used otherwise.
    assert found.choice is not None
    assert found_for(by_name, starts=[shipped_line_choice(), found.choice])["000"].choice is None


def test_with_too_few_choices_nothing_is_fitted(tmp_path: Path) -> None:
    site = make_site(tmp_path, vehicles=1)
    for k, path in enumerate(sorted(site.glob("*.csv"))):  # alike, but no copies
        path.write_text(path.read_text().replace(",4.5,", f",4.5{k * '0'},"))
    tracks = load_tracks([str(site / "vehicle_tracks_*.csv")], site / "map.osm", ("000",))
    told = Told()
    by_name = each_recording(tracks, "tracks")
    found = choices_of_others(by_name, [shipped_line_choice()], 2, None, 1, told)["000"]
    assert found.choice is None and found.fitted is None
    assert "too few to fit one" in told.lines[-1]
    assert choices_of_others(by_name, [shipped_line_choice()], 4, None, 1, told) == {}


def test_what_was_fitted_is_kept(
    site: Path, keep: Path, found: OthersChoice, monkeypatch: pytest.MonkeyPatch
) -> None:
    def from_nothing(traffic: Sequence[Traffic], *_: object) -> object:
        if traffic:
            raise HatnSimError("played again")
        return iter(())

    monkeypatch.setattr(others_choice, "_gather", from_nothing)
    by_name = scenes(site, "000")
    again = found_for(by_name, keep)["000"]
    assert again.choice is not None and again.about() == found.about()
    with pytest.raises(HatnSimError, match="played again"):  # it hangs on what it begins with
        found_for(by_name, keep, starts=[HAND_MADE_CHOICE])
    (path,) = keep.iterdir()
    path.write_text(path.read_text()[:100])
    with pytest.raises(HatnSimError, match="played again"):
        found_for(by_name, keep)


# -- where it is used ---------------------------------------------------------------------------


def test_everybody_on_a_road_chooses_by_what_the_road_was_given() -> None:
    road = Road(crossing_lanes())
    assert begin(road).choice is shipped_line_choice()
    assert begin(road, HAND_MADE_CHOICE).choice is HAND_MADE_CHOICE
    given = LineChoice.from_arrays(HAND_MADE_CHOICE.to_arrays())
    choose_lines_by(road, given)
    assert begin(road) is begin(road, HAND_MADE_CHOICE) and begin(road).choice is given


def evaluate(site: Path, *words: object) -> int:
    tracks = ["--tracks", str(site / "vehicle_tracks_*.csv"), "--map", str(site / "map.osm")]
    fixed = ["--recordings", "000-001", "--predictors", "constant_velocity,idm", "--workers", "1"]
    return cli.main(["evaluate", *tracks, *fixed, "--duration", "8", *map(str, words)])


def log(out: str, recording: str) -> Run:
    (path,) = Path(out, "runs").glob(f"*-{recording}")
    return read_run(path)


@pytest.mark.slow
def test_evaluate_says_what_chose(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(site, "--out", "fitted", "--json") == 0
    printed = capsys.readouterr()
    said = "lines: other recordings; choice: fitted to other recordings"
    assert all(score["lines"] == said for score in json.loads(printed.out))
    assert "choice of lines for 000: fitted to other recordings; 001, 002, 003" in printed.err
    for name in ("000", "001"):
        about = log("fitted", name).header["settings"]["choice_from"]
        assert about["source"] == "tracks" and name not in about["recordings"]
        drawn_with = read_run_choice(log("fitted", name).path)
        assert drawn_with is not None and drawn_with.sha256 == about["sha256"]
        assert about["held_out"]["fitted"]["log_loss"] < about["held_out"]["weights"]["log_loss"]
    assert evaluate(site, "--out", "fitted") == 0
    printed = capsys.readouterr()
    assert "2 of 2 runs are in" in printed.err and said in printed.out
    assert evaluate(site, "--out", "fitted", "--choice-from", "weights", "--quiet") == 2
    assert (
        "was made with other --choice-from, or other recordings in --tracks"
        in capsys.readouterr().err
    )
    assert evaluate(site, "--out", "plain", "--choice-from", "weights", "--quiet") == 0
    assert "choice: as in the weights" in capsys.readouterr().out
    assert log("plain", "000").header["settings"]["choice_from"] == {"source": "weights"}


def test_several_origins_are_counted() -> None:
    def header(lines: str, choice: str) -> dict[str, object]:
        return {"settings": {"lines_from": {"source": lines}, "choice_from": {"source": choice}}}

    mixed = [header("tracks", "tracks"), header("tracks", "tracks"), header("tracks", "weights")]
    assert said_lines(mixed) == (
        "lines: other recordings; choice: fitted to other recordings (2 of 3 recordings), "
        "as in the weights (1 of 3 recordings)"
    )
    older = {"settings": {"lines_from": {"source": "lanes"}}}
    assert said_lines([older]) == "lines: lanes of the map; choice: as in the weights"
    assert said_lines([{"settings": {}}, {}]) == ""


def test_a_choice_is_asked_for_where_there_is_something_to_fit_it_to(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*words: str) -> str:
        assert cli.main([*words, "--choice-from", "tracks"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    assert "--choice-from tracks goes with --tracks; leave it out" in refused(
        "evaluate", "--scenes", "tjunction"
    )
    alone = ["--tracks", str(site / "vehicle_tracks_000.csv"), "--map", str(site / "map.osm")]
    told = refused("evaluate", *alone, "--predictors", "constant_velocity")
    assert "expected lines drawn from 2 other recordings or more" in told and "found 0" in told
    assert "found 0 for tjunction" in refused("run", "tjunction")


@pytest.mark.slow
def test_what_was_fitted_and_drawn_is_found_by_an_evaluation_elsewhere(
    site: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--recordings", "000", "--cache", "kept", "--out")
    assert evaluate(site, *words, "first") == 0
    said = capsys.readouterr().err
    assert "reference lines from tracks: 0 of 4, reading 001" in said
    assert "reference lines from tracks: 4 of 4, drawn from " in said
    assert {path.suffix for path in Path("kept").iterdir()} == {".json", ".gz"}

    def never(*_: object) -> None:
        raise AssertionError("made once more")

    source._drawn.cache_clear()  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(source, "lanes_from_paths", never)
    monkeypatch.setattr("hatn_sim.learn.others_choice.fit_line_choice", never)
    assert evaluate(site, *words, "second") == 0
    assert "reference lines from tracks" not in capsys.readouterr().err
    first, second = log("first", "000"), log("second", "000")
    for key in ("lines_from", "choice_from"):
        assert first.header["settings"][key] == second.header["settings"][key]
    assert (
        Path(first.path, "road.json.gz").read_bytes() == (second.path / "road.json.gz").read_bytes()
    )
