"""Samples of any traffic, cut side by side and kept."""

from __future__ import annotations

import os
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from test_whole_file import little_room

from hatn_sim import cli
from hatn_sim.errors import HatnSimError, InputError, SimulatorError
from hatn_sim.evaluation.pool import Teller
from hatn_sim.kept import folder_for
from hatn_sim.learn import cache as cache_module
from hatn_sim.learn import sources
from hatn_sim.learn.cache import SampleCache, key_of
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.sources import gather, samples_of
from hatn_sim.learn.split import Traffic, traffic_of_runs, traffic_of_scenes, traffic_of_tracks
from hatn_sim.learn.watch import Nobody
from hatn_sim.resources import scenarios_dir

SAMPLE = scenarios_dir() / "recorded_sample"


class Told(Nobody):
    def __init__(self) -> None:
        self.steps: list[str] = []
        self.lines: list[str] = []

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        self.steps.append(f"{stage} {done}/{total} {words}")

    def say(self, line: str) -> None:
        self.lines.append(line)


def equal(one: Samples, other: Samples) -> bool:
    return all(
        np.array_equal(getattr(one, field.name), getattr(other, field.name))
        for field in fields(Samples)
    )


def short(seed: int, scene: str = "tjunction") -> Traffic:
    return traffic_of_scenes([scene], [seed], (), None, 6.0, 20.0)[0]


@pytest.fixture(scope="module")
def cut() -> Samples:
    return samples_of(short(4))


def test_the_log_of_a_run_gives_the_samples_of_its_simulation(tmp_path: Path, cut: Samples) -> None:
    words = "run tjunction --seed 4 --duration 6.1 --warm-up 20 --predictor constant_velocity"
    out = tmp_path / "run"
    assert cli.main([*words.split(), "--no-picture", "--quiet", "--out", str(out)]) == 0
    assert len(cut) > 10
    assert equal(samples_of(traffic_of_runs([str(out)])[0]), cut)


def test_highway_env_and_recorded_tracks_are_traffic_too() -> None:
    highway = traffic_of_scenes(["highway_intersection"], [1], (), None, 5.0, 10.0)[0]
    assert len(samples_of(highway)) > 10
    tracks = traffic_of_tracks([str(SAMPLE / "vehicle_tracks_000.csv")], SAMPLE / "map.osm")
    recorded = samples_of(tracks[0])
    assert len(recorded) > 100
    assert recorded.history_mask[:, 0, 0].mean() > 0.9


def test_cases_give_samples_with_ten_frames_behind_them(tmp_path: Path) -> None:
    """Ten frames of history and thirty of future: one sample for each vehicle of a case."""
    shutil.copy(SAMPLE / "map.osm", tmp_path)
    head, *rows = (SAMPLE / "vehicle_tracks_000.csv").read_text().splitlines()
    first = min(int(row.split(",")[1]) for row in rows) + 300
    picked = [row for row in rows if first <= int(row.split(",")[1]) < first + 40]
    path = tmp_path / "place_train.csv"
    path.write_text("\n".join([f"case_id,{head}", *(f"1.0,{row}" for row in picked)]) + "\n")
    ids = [row.split(",")[0] for row in picked]
    whole = sum(ids.count(name) == 40 for name in set(ids))
    cut = samples_of(traffic_of_tracks([str(path)], tmp_path / "map.osm")[0])
    known = cut.future_mask.all(axis=1)
    assert int(known.sum()) == whole > 0
    assert not cut.history_mask[known, 0, 0].any() and cut.history_mask[known, 0, 1:].all()


def test_jobs_come_out_in_order_and_once_cut_out_of_the_cache(tmp_path: Path, cut: Samples) -> None:
    kept, watch = SampleCache(tmp_path / "kept"), Told()
    traffic = [short(5, "intersection4_allway"), short(4)]
    first = gather("train", traffic, kept, 2, watch)
    of_last = replace(cut, run=cut.run + 1)
    last = Samples(**{f.name: getattr(first, f.name)[-len(cut) :] for f in fields(Samples)})
    assert equal(last, of_last)
    assert watch.steps[-1] == f"traffic to train 2/2 {len(first):,} samples"
    assert kept.size_bytes() > 1000
    again = gather("train", traffic, kept, 2, watch)
    assert equal(again, first)
    assert watch.steps[-1].endswith("samples, 2 from the cache")


@pytest.mark.parametrize("damage", ["cut off", "changed", "empty", "no archive", "other rows"])
def test_a_damaged_file_is_as_if_it_were_not_there(
    tmp_path: Path, cut: Samples, damage: str
) -> None:
    kept, traffic = SampleCache(tmp_path), short(4)
    assert kept.load(traffic) is None
    assert kept.store(traffic, cut) is None
    (path,) = tmp_path.iterdir()
    data = path.read_bytes()
    match damage:
        case "cut off":
            path.write_bytes(data[: len(data) // 2])
        case "changed":
            path.write_bytes(data[:9000] + bytes([data[9000] ^ 1]) + data[9001:])
        case "empty":
            path.write_bytes(b"")
        case "no archive":
            path.write_bytes(b"x" * 1000)
        case _:
            assert kept.store(traffic, replace(cut, slot=cut.slot[1:])) is None
    assert kept.load(traffic) is None
    assert kept.store(traffic, cut) is None
    found = kept.load(traffic)
    assert found is not None and equal(found, cut)


def test_the_key_hangs_on_what_samples_hang_on(tmp_path: Path) -> None:
    def tracks(folder: str) -> Traffic:
        path = tmp_path / folder
        return traffic_of_tracks([str(path / "vehicle_tracks_000.csv")], path / "map.osm")[0]

    shutil.copytree(SAMPLE, tmp_path / "a")
    before = key_of(tracks("a"))
    os.utime(tmp_path / "a" / "map.osm", (1, 1))
    assert key_of(tracks("a")) == before
    shutil.copytree(SAMPLE, tmp_path / "b" / "a")
    assert key_of(tracks("b/a")) == before
    with (tmp_path / "a" / "map.osm").open("a") as file:
        file.write("<!-- changed -->\n")
    assert key_of(tracks("a")) != before
    scenes = [
        traffic_of_scenes(["tjunction"], [1]),
        traffic_of_scenes(["tjunction"], [2]),
        traffic_of_scenes(["tjunction"], [1], ["assertive"]),
        traffic_of_scenes(["tjunction"], [1], density="dense"),
        traffic_of_scenes(["tjunction"], [1], duration_s=30.0),
        traffic_of_scenes(["tjunction"], [1], warm_up_s=30.0),
        traffic_of_scenes(["roundabout8"], [1]),
        traffic_of_scenes(["highway_merge"], [1]),
    ]
    assert len({key_of(one) for (one,) in scenes}) == len(scenes)


def test_the_key_hangs_on_the_traffic_beside_a_users_configuration(tmp_path: Path) -> None:
    """... and not on the weights, checkpoints and logs that a training leaves there."""
    tjunction = scenarios_dir() / "tjunction"
    shutil.copytree(tjunction, tmp_path / "mine")
    shutil.copytree(tjunction.parent / "drivers", tmp_path / "drivers")
    config = tmp_path / "mine" / "tjunction.sumocfg"

    def key() -> str:
        return key_of(traffic_of_scenes([str(config)], [1])[0])

    before = key()
    for name in ("w.safetensors", "w.json", "train.log"):
        (tmp_path / "mine" / name).write_text(name)
    assert key() == before
    (tmp_path / "mine" / "included.rou.xml").write_text("<routes/>")
    included = key()
    assert included != before
    with (tmp_path / "mine" / "tjunction.net.xml").open("a") as file:
        file.write("<!-- changed -->\n")
    assert key() not in (before, included)


def test_the_folder_stays_within_its_bound(
    tmp_path: Path, cut: Samples, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = SampleCache(tmp_path)
    kept.store(short(1), cut)
    size = kept.size_bytes()
    monkeypatch.setattr(cache_module, "LARGEST_BYTES", int(2.5 * size))
    kept.store(short(2), cut)
    for path in tmp_path.iterdir():
        os.utime(path, (1, 1))
    assert kept.load(short(1)) is not None  # used again, so 2 is the one that goes
    kept.store(short(3), cut)
    assert kept.size_bytes() == 2 * size
    assert [kept.load(short(seed)) is None for seed in (1, 2, 3)] == [False, True, False]


def test_where_samples_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert folder_for("samples") == tmp_path / "hatn_sim" / "samples"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert folder_for("samples") == Path.home() / ".cache" / "hatn_sim" / "samples"


def test_a_full_disk_costs_the_cache_only(tmp_path: Path, cut: Samples) -> None:
    kept = SampleCache(tmp_path / "kept")
    with little_room(10_000):
        said = kept.store(short(4), cut)
    assert said is not None and said.startswith(f"cache {kept.folder}: ")
    assert "the samples of tjunction, seed 4, courteous, normal are not kept" in said
    assert list((tmp_path / "kept").iterdir()) == []


def test_a_job_that_fails_is_one_line_and_the_others_are_kept(tmp_path: Path) -> None:
    shutil.copytree(SAMPLE, tmp_path / "site")
    path = tmp_path / "site" / "vehicle_tracks_000.csv"
    path.write_text(path.read_text() + "1,2,3\n")
    broken = traffic_of_tracks([str(path)], tmp_path / "site" / "map.osm")
    kept = SampleCache(tmp_path / "kept")
    with pytest.raises(InputError) as failed:
        gather("train", [short(4), *broken], kept, 1, Told())
    assert str(failed.value).startswith(f"site, 000: {path}")
    assert "\n" not in str(failed.value)
    assert kept.load(short(4)) is not None


def _die(_: Traffic, __: Teller) -> Samples:
    os._exit(3)


def _fail(*_: object) -> Samples:
    raise ZeroDivisionError("no vehicles")


def test_a_process_that_dies_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_cut", _die)
    with pytest.raises(HatnSimError, match=r"a process was killed from outside, perhaps"):
        gather("train", [short(4), short(5)], SampleCache(None), 2, Told())


def test_a_bug_in_a_job_is_one_line_that_says_where(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "samples_of", _fail)
    with pytest.raises(SimulatorError) as failed:
        gather("train", [short(4)], SampleCache(None), 1, Told())
    said = str(failed.value)
    assert said.startswith("tjunction, seed 4, courteous, normal: failed: ZeroDivisionError: no ve")
    assert "test_samples.py:" in said
