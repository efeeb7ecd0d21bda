"""The bench: every stage on the same steps, with memory and the vehicles there really were."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import scene_of

from hatn_sim import bench, cli
from hatn_sim.bench import STAGES, Stopwatch, peak_memory_mb
from hatn_sim.bench_scaling import APART_M, copy_lanes, copy_scene
from hatn_sim.envs import speed
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.weights_io import save_weights
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road

LINUX = sys.platform == "linux"


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "raw.safetensors"
    sgn, edn = SemanticGraphNetwork(SgnSettings(width=8)), EncoderDecoderNetwork(EdnSettings(8))
    save_weights(path, sgn, edn, {})
    return path


@pytest.mark.slow
def test_every_stage_beside_the_bare_step(
    weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bench", "--scene", "intersection5", "--vehicles", "12,4", "--steps", "20"]
    assert cli.main([*words, "--weights", str(weights), "--json"]) == 0
    small, large = json.loads(capsys.readouterr().out)
    assert (small["wanted"], large["wanted"]) == (4, 12)  # in rising order
    assert small["scale"] <= large["scale"]
    for one in (small, large):
        assert one["scene"] == "intersection5" and one["steps"] == 20
        assert abs(one["vehicles"] - one["wanted"]) < 4
        at = {timing["stage"]: timing for timing in one["timings"]}
        assert list(at) == list(STAGES)
        assert at["sumo"]["ratio"] == 1.0
        for timing in one["timings"]:
            assert timing["median_ms"] > 0.0 and timing["mean_ms"] > 0.0
            ratio = timing["median_ms"] / at["sumo"]["median_ms"]
            assert timing["ratio"] == pytest.approx(ratio)
        # One is a part of the other on every step.
        assert at["sumo"]["median_ms"] < at["simulator"]["median_ms"] < at["tick"]["median_ms"]
        if LINUX:
            branch = one["branch"]
            assert branch["steps"] == 60 and 0.0 < branch["start_ms"] < branch["whole_ms"]
            assert branch["bare_ms"] > 0.0
            assert one["peak_mb"] > one["worker_peak_mb"] > 20.0


def test_the_table_names_vehicles_stages_and_memory(
    weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bench", "--scene", "tjunction", "--vehicles", "3", "--steps", "5"]
    assert cli.main([*words, "--weights", str(weights)]) == 0
    table = capsys.readouterr().out
    assert all(title in table for title in STAGES.values())
    assert "x1.0" in table
    assert "tjunction at " in table and "SUMO worker " in table


def test_more_vehicles_than_the_scene_holds(
    weights: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "SCALES", (1.0,))
    monkeypatch.setattr(bench, "FILL_S", 20.0)
    words = ["bench", "--scene", "tjunction", "--vehicles", "5000", "--weights", str(weights)]
    assert cli.main(words) == 2
    line = capsys.readouterr().err
    assert line.startswith("hatn-sim: tjunction: holds at most ")
    assert line.endswith(
        " at once, 5000 were asked for; choose fewer --vehicles or another --scene\n"
    )


def test_the_stopwatch_gives_back_what_was_done_and_leaves_out_what_was_not() -> None:
    watch = Stopwatch()
    assert watch.time("graphs", divmod, 7, 2) == (3, 1)
    watch.taken_ms["sumo"] += [2.0, 4.0, 30.0]
    watch.taken_ms["log"] += [1.0, 1.0, 40.0]
    at = {timing.stage: timing for timing in watch.timings()}
    assert list(at) == ["sumo", "graphs", "log"]
    assert (at["log"].median_ms, at["log"].mean_ms, at["log"].ratio) == (1.0, 14.0, 0.25)


@pytest.mark.skipif(not LINUX, reason="the peak of another process is Linux's to tell")
def test_the_peak_of_memory_is_the_process_own() -> None:
    here = bytearray(300_000_000)  # of the parent: not to be counted
    program = "held = bytearray(100_000_000); held = None; print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None and child.stdout.readline()
        peak_mb = peak_memory_mb(str(child.pid))
        child.communicate(b"\n")
    assert peak_mb is not None and 100.0 < peak_mb < 200.0 and len(here)
    own_mb = peak_memory_mb("self")
    assert own_mb is not None and own_mb > 300.0
    assert peak_memory_mb("0") is None


def test_copies_of_a_scene_have_graphs_of_their_own(crossing: Road) -> None:
    lanes = list(crossing.lanes.values())
    scene = scene_of(0.0, {"a": (-30.0, 0.0, 0.0, 8.0), "b": (0.0, -40.0, np.pi / 2, 8.0)})
    alone = build_graphs(crossing, perceive(begin(crossing), scene, None).seen)
    wide = Road([lane for copy in range(3) for lane in copy_lanes(lanes, copy)])
    graphs = build_graphs(wide, perceive(begin(wide), copy_scene(scene, 3), None).seen)
    assert graphs.ids == ("0/a", "0/b", "1/a", "1/b", "2/a", "2/b")
    for copy in range(3):
        own = slice(2 * copy, 2 * copy + 2)
        np.testing.assert_allclose(graphs.x[own], alone.x, atol=1e-9)
        np.testing.assert_allclose(graphs.conflict_xy_m[own, :2, 0], copy * APART_M, atol=1e-6)


def test_environments_beside_those_of_highway_env(
    weights: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speed, "CHUNK_FRAMES", 5)
    monkeypatch.setattr(speed, "RESETS", 1)
    monkeypatch.setattr(speed, "KNOWN_EPISODES", 2)
    monkeypatch.setattr(speed, "TOGETHER", 2)
    words = ["bench", "--envs", "--scene", "intersection5", "--steps", "5", "--weights"]
    assert cli.main([*words, str(weights), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    first, *others = told["speeds"]
    assert first["what"] == "highway-env, intersection-v2" and first["ratio"] == 1.0
    assert [one["what"] for one in others][:2] == ["no prediction", "hatn, each second, advised"]
    assert others[-1]["what"] == "hatn, each frame, 2 side by side"
    for one in told["speeds"]:
        ratio = one["frames_per_s"] / first["frames_per_s"]
        assert one["ratio"] == pytest.approx(ratio) and one["vehicles"] > 1.0
        # 15 frames a second there, 10 here.
        assert one["ratio_of_time"] == pytest.approx(ratio * (1.0 if one is first else 1.5))
    later = "hatn, from episode 5 on"  # after the first, one that is timed, and two that are not
    assert [one["what"] for one in told["resets"]] == ["no prediction", "hatn", later]
    assert all(one["reset_ms"] > one["bare_ms"] > 0.0 for one in told["resets"])


def test_the_demand_that_meets_a_number_of_vehicles() -> None:
    asked: list[float] = []

    def vehicles_at(scale: float) -> float:
        asked.append(scale)
        return 12.0 * scale

    assert 12.0 * speed.scale_to_meet(vehicles_at, 9.0) == pytest.approx(9.0, rel=speed.CLOSE)
    assert len(asked) < speed.HALVINGS + len(speed.NEARBY), "it stops when it is near enough"
    assert speed.scale_to_meet(vehicles_at, 1000.0) == 6.0, "as near as it gets"


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0, 3.0])
def test_a_demand_is_found_among_numbers_that_rise_and_fall(phase: float) -> None:
    def vehicles_at(scale: float) -> float:
        return 12.0 * scale * (1.0 + 0.12 * math.sin(150.0 * scale + phase))

    met = vehicles_at(speed.scale_to_meet(vehicles_at, 9.0))
    assert met == pytest.approx(9.0, rel=speed.CLOSE)


def test_the_scaling_table_has_a_row_for_all_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "--scaling", "--scene", "tjunction", "--steps", "1", "--json"]
    assert cli.main(words) == 0
    rows = json.loads(capsys.readouterr().out)
    vehicles = [row["vehicles"] for row in rows]
    assert vehicles[-1] == vehicles[0] > 0 and vehicles[-2] == pytest.approx(100 * vehicles[0])
    assert rows[-1]["lane_km"] == pytest.approx(100 * rows[0]["lane_km"])
    assert all(row["perceive_ms"] > 0.0 and row["graphs_ms"] > 0.0 for row in rows)
