"""What is learnt from, tuned on and tested on: named in options or a file, and kept apart."""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

import pytest

from hatn_sim.errors import InputError
from hatn_sim.learn.split import make_split, traffic_of_runs, traffic_of_scenes, traffic_of_tracks
from hatn_sim.learn.split_file import read_split
from hatn_sim.resources import scenarios_dir

CALLED = {"train": "--seeds", "tune": "--tune", "test": "--test"}
SAMPLE = scenarios_dir() / "recorded_sample"


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Recordings 000, 001 and 002 of a place, of different content."""
    folder = tmp_path / "site"
    folder.mkdir()
    shutil.copy(SAMPLE / "map.osm", folder)
    for k in range(3):
        text = (SAMPLE / "vehicle_tracks_000.csv").read_text()
        lines = text.splitlines(keepends=True)
        (folder / f"vehicle_tracks_00{k}.csv").write_text("".join(lines[: len(lines) - 5 * k]))
    return folder


def split_of(folder: Path, text: str) -> Path:
    path = folder / "split.toml"
    path.write_text(text)
    return path


TRACKS = 'tracks = "vehicle_tracks_*.csv"\nmap = "map.osm"\nrecordings = "{}"\n'


def test_a_file_names_every_kind_of_traffic(site: Path) -> None:
    split = read_split(
        split_of(
            site,
            """
[[train]]
scenes = ["intersection4_allway", "tjunction"]
seeds = "1-2,5"
risks = ["courteous", "assertive"]
duration_s = 30
[[train]]
scenes = ["highway_intersection"]
seeds = [3]
warm_up_s = 10
[[train]]
"""
            + TRACKS.format("000-001")
            + "[[tune]]\n"
            + TRACKS.format("002")
            + "[[test]]\nscenes = 'intersection5'\nseeds = 9\n",
        )
    )
    assert [(one.scenario.name, one.seed, one.scenario.risk) for one in split.train] == [
        ("intersection4_allway", 1, "courteous"),
        ("intersection4_allway", 2, "assertive"),
        ("intersection4_allway", 5, "courteous"),
        ("tjunction", 1, "courteous"),
        ("tjunction", 2, "assertive"),
        ("tjunction", 5, "courteous"),
        ("highway_intersection", 3, None),
        ("site", 0, None),
        ("site", 0, None),
    ]
    assert [one.duration_s for one in split.train] == [30.0] * 6 + [600.0, None, None]
    assert [one.warm_up_s for one in split.train] == [60.0] * 6 + [10.0, 0.0, 0.0]
    card = split.card()
    assert card["train"][0]["seeds"] == [1, 5] and card["train"][1]["risk"] == "assertive"
    files = ["vehicle_tracks_000.csv", "vehicle_tracks_001.csv"]
    digests = [hashlib.sha256((site / name).read_bytes()).hexdigest() for name in files]
    of_map = hashlib.sha256((site / "map.osm").read_bytes()).hexdigest()
    assert card["train"][-1] == {
        "site": "site",
        "lines": "lanes",
        "map": "map.osm",
        "map_sha256": of_map,
        "recordings": files,
        "sha256": digests,
    }
    assert card["test"][0]["seeds"] == [9]
    assert str(site) not in str(card)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[[tain]]\n", "unknown table 'tain'; did you mean 'train' or 'tune'?"),
        ("train = 3\n", "train: expected tables [[train]], found 3"),
        ("[tune]\nruns = 'x'\n", "expected tables [[tune]], found [tune]; double the brackets"),
        (
            '[[train]]\ntracks = "*.csv"\nmap = "map.osm"\nrecordings = "4-0"\n',
            "recordings: expected names like 000-004,017, found '4-0'; say 0-4",
        ),
        ("[[train]]\nseeds = 3\n", "[[train 1]]: expected one of scenes, tracks, runs in it"),
        ("[[train]]\nscenes = 'tjunction'\nsedes = 3\n", "unknown key 'sedes'; did you mean 'see"),
        ("[[train]]\nscenes = 'tjunction'\n", "seeds is missing: add seeds like"),
        ("[[train]]\nscenes = 'tjunction'\nseeds = '4-x'\n", "seeds: expected seeds like 7, 1-12"),
        ("[[train]]\nscenes = [3]\nseeds = 1\n", "scenes: expected a list of texts, found [3]"),
        ("[[train]]\nscenes = 'tjunctoin'\nseeds = 1\n", "unknown scene 'tjunctoin'; did you mean"),
        ("[[train]]\ntracks = 'vehicle_tracks_*.csv'\n", "map is missing: add a text"),
        (f"[[train]]\n{TRACKS}lines = 'track'\n", "lines: unknown 'track'; did you mean 'tracks'?"),
        ("[[train]]\n" + TRACKS.format("007"), "there is no recording '007'"),
        ("[[train]]\nruns = ['nothing']\n", "nothing: there are no such tracks"),
        ("[[train]]\nscenes = 'tjunction'\nseeds = 1\n", "[[tune]]: expected at least one piece"),
        ("[[train\n", "not valid TOML"),
    ],
)
def test_a_file_at_fault_is_one_line(site: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as wrong:
        read_split(split_of(site, text))
    assert expected in str(wrong.value) and "\n" not in str(wrong.value)


def test_a_file_that_overlaps_itself(site: Path) -> None:
    text = "[[train]]\n" + TRACKS.format("000-001") + "[[test]]\n" + TRACKS.format("1-2")
    path = split_of(site, text + "[[tune]]\nscenes = 'tjunction'\nseeds = 1\n")
    with pytest.raises(InputError) as wrong:
        read_split(path)
    assert str(wrong.value).startswith(
        f"{path}: [[train]] and {path}: [[test]] share {site / 'vehicle_tracks_001.csv'}: what is"
    )


def test_the_same_seed_is_the_same_traffic_whoever_drives() -> None:
    parts = {
        "train": traffic_of_scenes(["tjunction", "intersection5"], [1, 2], ["courteous"]),
        "tune": traffic_of_scenes(["tjunction"], [2, 3], ["assertive"], "dense"),
    }
    with pytest.raises(InputError, match=r"^--seeds and --tune share seed 2 of tjunction: what is"):
        make_split(parts, CALLED)
    parts["tune"] = traffic_of_scenes(["tjunction"], [3]) + traffic_of_scenes(["roundabout8"], [1])
    assert len(make_split(parts, CALLED).train) == 4


@pytest.mark.parametrize("way", ["link", "hard link", "copy", "roundabout path"])
def test_the_same_recording_under_another_name(site: Path, tmp_path: Path, way: str) -> None:
    other = tmp_path / "other"
    other.mkdir()
    theirs = other / "vehicle_tracks_900.csv"
    ours = site / "vehicle_tracks_001.csv"
    match way:
        case "link":
            theirs.symlink_to(ours)
        case "hard link":
            os.link(ours, theirs)
        case "copy":
            shutil.copy(ours, theirs)
        case _:
            theirs = other / ".." / "site" / ours.name
    parts = {
        "train": traffic_of_tracks([str(site / "vehicle_*.csv")], site / "map.osm", "000-001"),
        "tune": traffic_of_tracks([str(theirs)], site / "map.osm"),
    }
    with pytest.raises(InputError, match=r"share .*vehicle_tracks_001\.csv: "):
        make_split(parts, CALLED)


def test_named_twice_in_one_part(site: Path) -> None:
    once = traffic_of_scenes(["tjunction"], [1])
    tune = traffic_of_scenes(["tjunction"], [2])
    with pytest.raises(InputError, match=r"^--seeds: tjunction, seed 1, .* is named twice"):
        make_split({"train": [*once, *traffic_of_scenes(["tjunction"], [1])], "tune": tune}, CALLED)


def test_cases_overlap_by_case(tmp_path: Path) -> None:
    """A file of version 1.2: whole against some of its cases, and some against others."""
    shutil.copy(SAMPLE / "map.osm", tmp_path)
    head, *rows = (SAMPLE / "vehicle_tracks_000.csv").read_text().splitlines()
    text = [f"case_id,{head}", *(f"{1 + k % 2}.0,{row}" for k, row in enumerate(rows))]
    path = tmp_path / "place_train.csv"
    path.write_text("\n".join(text) + "\n")

    def cases(names: str) -> list[object]:
        return [*traffic_of_tracks([str(path)], tmp_path / "map.osm", names)]

    make_split({"train": cases("1"), "tune": cases("2")}, CALLED)  # type: ignore[dict-item]
    for first, second in (("1", "1-2"), ("", "2"), ("2", "")):
        with pytest.raises(InputError, match="share"):
            make_split({"train": cases(first), "tune": cases(second)}, CALLED)  # type: ignore[dict-item]


def test_a_run_is_the_seed_it_was_made_with(tmp_path: Path) -> None:
    from hatn_sim import cli

    words = "run tjunction --seed 4 --duration 1 --warm-up 0 --predictor constant_velocity"
    out = tmp_path / "run"
    assert cli.main([*words.split(), "--no-picture", "--quiet", "--out", str(out)]) == 0
    runs = traffic_of_runs([str(out)])
    assert (runs[0].scenario.name, runs[0].seed) == ("tjunction", 4)
    with pytest.raises(InputError, match="share seed 4 of tjunction"):
        make_split({"train": traffic_of_scenes(["tjunction"], [4]), "tune": runs}, CALLED)
