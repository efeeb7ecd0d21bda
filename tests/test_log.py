"""The log of a run: what is written is read again, whatever happened to the run."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from hatn_sim.datatypes import (
    HORIZON_FRAMES,
    Advice,
    Alert,
    Frame,
    Lines,
    Prediction,
    Scene,
    SemanticGraphs,
    Suggestion,
    Truth,
)
from hatn_sim.errors import InputError
from hatn_sim.log import PART_FRAMES, Run, RunWriter, read_run

HEADER = {"scene": "made_up", "seed": 3}
MODES, NODES = 2, 3


def make_frame(rng: np.random.Generator, index: int) -> Frame:
    count = int(rng.integers(0, 6))
    ids = tuple(f"vehicle {n}" for n in sorted(rng.choice(12, count, replace=False)))
    scene = Scene(
        time_s=0.1 * index,
        ids=ids,
        xy_m=rng.normal(size=(count, 2)) * 1e5,
        yaw_rad=rng.normal(size=count),
        speed_mps=rng.random(count),
        size_m=rng.random((count, 2)),
        kind=rng.integers(0, 9, count),
        colour=rng.integers(0, 256, (count, 3)),
        blinker=rng.integers(-1, 2, count),
        signal_closed=rng.random(index % 3) < 0.5,
    )
    routes = tuple(
        None if rng.random() < 0.2 else ("in", f"out {rng.integers(3)}") for _ in range(count)
    )
    truth = Truth(routes, arrived=("gone",) if index % 7 == 0 else ())
    if count >= 2:
        truth = Truth(
            routes,
            collisions=((ids[0], ids[1]),),
            emergency_braking=ids[:1],
            departed=ids[:2],
            teleported=ids[1:2],
        )
    return Frame(scene, truth, done=index % 5 == 0)


def make_prediction(rng: np.random.Generator, frame: Frame) -> Prediction:
    """Predictions of all, with graphs (in reverse order) of all but the last vehicle."""
    ids, xy_m = frame.scene.ids, frame.scene.xy_m
    count, egos = len(ids), max(len(ids) - 1, 0)
    node_mask = rng.random((egos, NODES)) < 0.6
    node_mask[:, 0] = True
    rear = rng.integers(0, max(count, 1), (egos, NODES))
    ego = np.arange(egos)[::-1].copy()
    rear[:, 0] = ego
    unused = np.zeros((egos, NODES), dtype=np.int64)
    graphs = SemanticGraphs(
        ids=ids,
        ego=ego,
        rear=np.where(node_mask, rear, -1),
        front=unused,
        front_type=unused,
        x=np.zeros((egos, NODES, 1, 7)),
        context=np.zeros((egos, NODES, 1)),
        node_mask=node_mask,
        focus_mask=node_mask & (rng.random((egos, NODES)) < 0.8),
        history_mask=np.ones((egos, NODES, 1), dtype=bool),
        has_conflict=node_mask.sum(axis=1) > 1,
        ego_at_red=np.zeros(egos, dtype=np.bool_),
        ego_to_conflict_m=rng.random((egos, NODES)),
        rear_to_conflict_m=rng.random((egos, NODES)),
        conflict_xy_m=rng.normal(size=(egos, NODES, 2)) * 1e5,
        conflict_type=rng.integers(0, 2, (egos, NODES)),
        leader=np.full(egos, -1),
        leader_gap_m=np.zeros(egos),
    )
    return Prediction(
        ids=ids,
        xy_m=xy_m[:, None, None] + rng.normal(size=(count, MODES, HORIZON_FRAMES, 2)) * 10.0,
        mode_probability=rng.random((count, MODES)),
        fallback=rng.random(count) < 0.5,
        adapted=rng.random(count) < 0.5,
        lines=Lines(
            rng.integers(-1, 3, count), *(rng.random(count) for _ in range(3)), rng.random(count)
        ),
        graphs=graphs,
        slot_probability=rng.random((egos, NODES)),
        goal_weight=np.full((count, 2), 0.5),
        goal_mean_m=rng.random((count, 2)),
        goal_std_m=rng.random((count, 2)),
    )


def plain_prediction(frame: Frame) -> Prediction:
    count = len(frame.scene.ids)
    return Prediction(
        ids=frame.scene.ids,
        xy_m=np.repeat(frame.scene.xy_m[:, None, None], HORIZON_FRAMES, axis=2),
        mode_probability=np.ones((count, 1)),
        fallback=np.zeros(count, dtype=bool),
        adapted=np.zeros(count, dtype=bool),
    )


def make_run(count: int, seed: int = 0) -> list[tuple[Frame, dict[str, Advice]]]:
    rng = np.random.default_rng(seed)
    run = []
    for index in range(count):
        frame = make_frame(rng, index)
        advice = {"hatn": Advice(make_prediction(rng, frame), (), ())}
        if index % 5 == 0:
            advice["module:Plain/1"] = Advice(plain_prediction(frame), (), ())
        run.append((frame, advice))
    return run


def write_run(out: Path, run: list[tuple[Frame, dict[str, Advice]]]) -> Run:
    with RunWriter(out, HEADER) as writer:
        for index, (frame, advice) in enumerate(run):
            writer.write(index, frame, advice)
    return read_run(out)


def assert_same_frame(read: Frame, written: Frame) -> None:
    assert read.done == written.done
    assert vars(read.truth) == vars(written.truth)
    for name, value in vars(written.scene).items():
        again = getattr(read.scene, name)
        if isinstance(value, np.ndarray):
            assert again.dtype == value.dtype and again.shape == value.shape, name
            assert again.tobytes() == value.tobytes(), name
        else:
            assert again == value, name


def test_frames_are_read_bit_for_bit(tmp_path: Path) -> None:
    written = make_run(2 * PART_FRAMES + 20)
    run = write_run(tmp_path / "run", written)
    assert run.finished and run.frame_count == len(written)
    assert run.header["scene"] == "made_up" and run.header["frames"] == len(written)
    frames = list(run.frames())
    assert len(frames) == len(written)
    for read, (frame, _) in zip(frames, written, strict=True):
        assert_same_frame(read, frame)
    assert [scene.ids for scene in run.scenes()] == [frame.scene.ids for frame, _ in written]
    assert run.times_s.tolist() == [frame.scene.time_s for frame, _ in written]


def test_predictions_are_read_again(tmp_path: Path) -> None:
    written = make_run(PART_FRAMES + 10)
    run = write_run(tmp_path / "run", written)
    assert run.predictors == ("hatn", "module:Plain/1")
    table = run.predictions("hatn")
    row = 0
    for index, (frame, advice) in enumerate(written):
        prediction = advice["hatn"].prediction
        graphs = prediction.graphs
        assert graphs is not None and prediction.lines is not None
        for n, name in enumerate(frame.scene.ids):
            assert table.frame[row] == index and run.ids[table.vehicle[row]] == name
            # Offsets are float32: 10 m or so away that is a few microns, 100 km from the origin.
            np.testing.assert_allclose(table.xy_m[row], prediction.xy_m[n], atol=1e-5, rtol=0)
            single = np.float32(prediction.mode_probability[n])
            assert table.mode_probability[row].tolist() == single.tolist()
            assert table.fallback[row] == prediction.fallback[n]
            assert table.adapted[row] == prediction.adapted[n]
            assert table.on_line[row] == (prediction.lines.line[n] >= 0)
            assert table.goal_mask[row].all()
            assert prediction.goal_mean_m is not None
            np.testing.assert_allclose(table.goal_mean_m[row], prediction.goal_mean_m[n], rtol=1e-6)
            own = np.flatnonzero(graphs.ego == n)
            mask = table.slot_mask[row]
            if not len(own):
                assert not mask.any() and not table.has_conflict[row]
                assert not table.has_slot_probability[row]
            else:
                e, nodes = own[0], graphs.node_mask[own[0]]
                assert mask.sum() == nodes.sum() and mask[: nodes.sum()].all()
                slots = [run.ids[v] for v in table.slot_vehicle[row][mask]]
                assert slots == [frame.scene.ids[v] for v in graphs.rear[e][nodes]]
                assert slots[0] == name
                assert (table.slot_vehicle[row][~mask] == -1).all()
                for field in (
                    "ego_to_conflict_m",
                    "rear_to_conflict_m",
                    "conflict_xy_m",
                    "conflict_type",
                ):
                    read, said = getattr(table, field)[row][mask], getattr(graphs, field)[e][nodes]
                    assert read.tolist() == said.tolist(), field
                assert (
                    table.slot_in_focus[row][mask].tolist() == graphs.focus_mask[e][nodes].tolist()
                )
                assert table.has_conflict[row] == graphs.has_conflict[e]
                assert prediction.slot_probability is not None
                np.testing.assert_allclose(
                    table.slot_probability[row][mask],
                    prediction.slot_probability[e][nodes],
                    rtol=1e-6,
                )
            row += 1
    assert row == len(table.frame)


def test_a_compared_predictor_has_only_the_frames_it_was_asked_for(tmp_path: Path) -> None:
    written = make_run(23)
    run = write_run(tmp_path / "run", written)
    table = run.predictions("module:Plain/1")
    assert set(table.frame.tolist()) <= {0, 5, 10, 15, 20}
    assert len(table.frame) == sum(len(written[i][0].scene.ids) for i in (0, 5, 10, 15, 20))
    assert table.slot_mask.shape[1] == 0 and not table.goal_mask.any()
    every = run.predictions("hatn", every_frames=5)
    assert every.frame.tolist() == table.frame.tolist()
    vehicle, frame = run.predicted("hatn", every_frames=5)
    assert vehicle.tolist() == every.vehicle.tolist() and frame.tolist() == every.frame.tolist()
    with pytest.raises(InputError, match="no predictions of 'idm'; there are: hatn, module:Plain"):
        run.predictions("idm")


def folder_bytes(folder: Path) -> dict[str, bytes]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_equal_runs_are_equal_byte_for_byte_but_for_timing(tmp_path: Path) -> None:
    contents = []
    for name, wall_s in (("a", 1.0), ("b", 2.0)):
        with RunWriter(tmp_path / name, HEADER) as writer:
            for index, (frame, advice) in enumerate(make_run(PART_FRAMES + 30)):
                writer.write(index, frame, advice)
            writer.close(timing={"wall_s": wall_s})
        contents.append(folder_bytes(tmp_path / name))
        timing = json.loads(contents[-1].pop("timing.json"))
        assert timing == {"wall_s": wall_s}
    assert contents[0] == contents[1]
    write_run(tmp_path / "c", make_run(PART_FRAMES + 30, seed=1))
    assert (
        folder_bytes(tmp_path / "c")["tracks/part-00000.parquet"]
        != contents[0]["tracks/part-00000.parquet"]
    )


def test_a_killed_run_is_readable_up_to_its_last_part(tmp_path: Path) -> None:
    written = make_run(2 * PART_FRAMES + 50)
    writer = RunWriter(tmp_path / "run", HEADER)
    for index, (frame, advice) in enumerate(written):
        writer.write(index, frame, advice)
    # Killed while it wrote its third part: one table is whole, the next is half there; and while
    # it wrote a line.
    tracks = tmp_path / "run" / "tracks"
    whole = (tracks / "part-00001.parquet").read_bytes()
    (tracks / "part-00002.parquet").write_bytes(whole)
    (tracks.parent / "truth" / "part-00002.tmp").write_bytes(whole[:100])
    with (tracks.parent / "truth" / "events.jsonl").open("a") as file:
        file.write('{"frame": 650, "time_s": 65.0, "ty')

    run = read_run(tmp_path / "run")
    assert not run.finished
    assert run.frame_count == 2 * PART_FRAMES
    for read, (frame, _) in zip(run.frames(), written, strict=False):
        assert_same_frame(read, frame)
    assert run.trajectories.frame_count == 2 * PART_FRAMES
    assert run.predictions("hatn").frame.max() < 2 * PART_FRAMES
    assert run.events[-1].frame > 2 * PART_FRAMES, "events are on disk as they happen"


def test_a_run_that_fails_keeps_all_its_frames(tmp_path: Path) -> None:
    written = make_run(12)

    def interrupted() -> None:
        with RunWriter(tmp_path / "run", HEADER) as writer:
            for index, (frame, advice) in enumerate(written):
                writer.write(index, frame, advice)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    run = read_run(tmp_path / "run")
    assert not run.finished and run.frame_count == 12
    assert [scene.ids for scene in run.scenes()] == [frame.scene.ids for frame, _ in written]


def interrupting(at: int) -> tuple[Callable[..., Any], list[int]]:
    """A tracer that interrupts at a line of this package's log, and how many lines it has seen."""
    seen = [0]

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        if not frame.f_code.co_filename.endswith(
            ("log/writer.py", "log/lines_file.py", "log/parts.py", "whole_file.py")
        ):
            return None
        if event == "line":
            seen[0] += 1
            if seen[0] == at:
                raise KeyboardInterrupt
        return trace

    return trace, seen


@pytest.mark.parametrize("every", [29, pytest.param(1, marks=pytest.mark.slow)])
def test_wherever_a_run_is_interrupted_what_counts_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, every: int
) -> None:
    """Also where it is being closed, so that nothing that was held is lost, and nothing empty
    stays."""
    monkeypatch.setattr("hatn_sim.log.schema.PART_FRAMES", 2)
    written = make_run(3)

    def make(out: Path, at: int) -> int:
        trace, seen = interrupting(at)
        before = sys.gettrace()
        sys.settrace(trace)
        try:
            with RunWriter(out, HEADER) as writer:
                for index, (frame, advice) in enumerate(written):
                    writer.write(index, frame, advice)
                writer.close(timing={})
        finally:
            sys.settrace(before)
        return seen[0]

    lines = make(tmp_path / "whole", 0)
    assert lines > 400
    counts: list[int] = []
    for at in range(1, lines, every):
        out = tmp_path / str(at)
        with pytest.raises(KeyboardInterrupt):
            make(out, at)
        run = read_run(out) if out.exists() and any(out.iterdir()) else None
        counts.append(0 if run is None else run.frame_count)
        if run is not None:
            assert run.frame_count > 0 and not run.finished
            ids = [frame.scene.ids for frame, _ in written[: run.frame_count]]
            assert [scene.ids for scene in run.scenes()] == ids
    assert counts == sorted(counts) and set(counts) == {0, 1, 2, 3}


def test_a_frame_half_written_does_not_count(tmp_path: Path) -> None:
    written = make_run(12)

    def stopped_in_the_middle() -> None:
        with RunWriter(tmp_path / "run", HEADER) as writer:
            for index, (frame, advice) in enumerate(written):
                writer.write(index, frame, advice)
            frame = next(frame for frame, _ in written if frame.scene.ids)
            broken = replace(plain_prediction(frame), xy_m=np.zeros(3))
            writer.write(12, frame, {"hatn": Advice(broken, (), ())})

    with pytest.raises(ValueError):
        stopped_in_the_middle()
    run = read_run(tmp_path / "run")
    assert run.frame_count == 12 and run.trajectories.frame_count == 12
    assert [scene.ids for scene in run.scenes()] == [frame.scene.ids for frame, _ in written]


def test_a_run_killed_at_once_is_readable(tmp_path: Path) -> None:
    RunWriter(tmp_path / "run", HEADER)
    run = read_run(tmp_path / "run")
    assert (run.finished, run.frame_count, run.predictors, run.ids) == (False, 0, (), ())
    assert list(run.frames()) == [] and run.suggestions == () and run.events == ()


def suggestion(action: str, probability: float, target_time_s: float = 2.0) -> Suggestion:
    return Suggestion(
        ego_id="a",
        time_s=0.0,
        action=action,
        slot_id="b",
        probability=probability,
        margin=0.2,
        target_time_s=target_time_s,
        advised_speed_mps=5.0,
        feasible=True,
        text="yield to b",
    )


def test_suggestions_are_logged_when_they_change(tmp_path: Path) -> None:
    scene = make_frame(np.random.default_rng(0), 0)
    prediction = plain_prediction(scene)
    said = [
        (suggestion("yield", 0.8),),
        (suggestion("yield", 0.801),),
        (suggestion("pass", 0.6, target_time_s=math.inf),),
        (),
        (),
        (suggestion("pass", 0.6),),
    ]
    alert = Alert("1", "onset", "CONFLICT", 0.1, "a", "b", 0.7, "too close")
    with RunWriter(tmp_path / "run", HEADER) as writer:
        for index, suggestions in enumerate(said):
            alerts = (alert,) if index == 1 else ()
            main, other = Advice(prediction, suggestions, alerts), Advice(prediction, (), (alert,))
            writer.write(index, scene, {"main": main, "other": other})
    run = read_run(tmp_path / "run")
    assert [change.frame for change in run.suggestions] == [0, 2, 3, 5]
    assert run.suggestions[0].suggestion == said[0][0]
    later = run.suggestions[1].suggestion
    assert later is not None and later.action == "pass" and later.target_time_s is None
    assert run.suggestions[2].ego_id == "a" and run.suggestions[2].suggestion is None
    assert run.alerts == ((1, alert),)


def test_silence_is_logged_again_where_its_reason_changes(tmp_path: Path) -> None:
    scene = make_frame(np.random.default_rng(0), 0)
    prediction = plain_prediction(scene)
    silent = replace(suggestion("abstain", 0.5), reason="unsure")
    said = [silent, replace(silent, feasible=not silent.feasible), replace(silent, reason="far")]
    with RunWriter(tmp_path / "run", HEADER) as writer:
        for index, one in enumerate(said):
            writer.write(index, scene, {"main": Advice(prediction, (one,), ())})
    assert [change.frame for change in read_run(tmp_path / "run").suggestions] == [0, 2]


def test_a_line_of_an_alert_has_the_frame_of_its_time(tmp_path: Path) -> None:
    """Onset at frame 3; known to be over at frame 9 that it peaked at 5 and ended at 7."""
    onset = Alert("1", "onset", "CONFLICT", 0.3, "a", "b", 0.7, "too close")
    peak = replace(onset, edge="peak", time_s=0.5)
    end = replace(onset, edge="end", time_s=0.7)
    before = replace(end, alert_id="0", time_s=-1.0)  # the log begins at 0 s
    told = {3: (onset,), 9: (peak, end, before)}
    with RunWriter(tmp_path / "run", HEADER) as writer:
        for index in range(10):
            frame = make_frame(np.random.default_rng(0), index)
            advice = Advice(plain_prediction(frame), (), told.get(index, ()))
            writer.write(index, frame, {"main": advice})
    assert read_run(tmp_path / "run").alerts == ((3, onset), (5, peak), (7, end), (0, before))


def test_an_output_folder_that_exists_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(InputError, match="expected an output folder that does not exist yet"):
        RunWriter(tmp_path, HEADER)
    with pytest.raises(InputError, match="expected an output folder that does not exist yet"):
        RunWriter(tmp_path / "mine", HEADER)
    with pytest.raises(InputError, match=r"cannot be made \(Not a directory\)"):
        RunWriter(tmp_path / "mine" / "run", HEADER)
    assert folder_bytes(tmp_path) == {"mine": b"precious"}


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_an_output_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match=r"cannot be made \(Permission denied\)"):
        RunWriter(tmp_path / "run", HEADER)
    tmp_path.chmod(0o700)


def test_a_header_that_is_no_json_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(TypeError):
        RunWriter(tmp_path / "run", {"seed": object()})
    with pytest.raises(ValueError, match="'finished'"):
        RunWriter(tmp_path / "run", {"finished": True})
    assert not (tmp_path / "run").exists()


def test_frames_come_in_order_and_predictions_are_of_their_vehicles(tmp_path: Path) -> None:
    frame, _ = make_run(2)[1]
    with RunWriter(tmp_path / "run", HEADER) as writer:
        with pytest.raises(ValueError, match="frame 0 has to follow, got 4"):
            writer.write(4, frame, {})
        other = Frame(Scene(**{**vars(frame.scene), "ids": ("x",)}), frame.truth, False)
        with pytest.raises(ValueError, match="hatn predicts other vehicles"):
            writer.write(0, frame, {"hatn": Advice(plain_prediction(other), (), ())})
        writer.write(0, frame, {})
    assert read_run(tmp_path / "run").frame_count == 1


def damage_version(run: Path) -> None:
    head = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**head, "schema_version": 99}))


def damage_head(run: Path) -> None:
    (run / "run.json").write_text("{")


def head_with(**content: object) -> Callable[[Path], None]:
    def damage(run: Path) -> None:
        head = json.loads((run / "run.json").read_text())
        (run / "run.json").write_text(json.dumps({**head, **content}))

    return damage


def damage_part(run: Path) -> None:
    part = run / "tracks" / "part-00000.parquet"
    part.write_bytes(part.read_bytes()[:200])


def lose_last_part(run: Path) -> None:
    (run / "frames" / "part-00001.parquet").unlink()


def lose_first_part(run: Path) -> None:
    (run / "frames" / "part-00000.parquet").unlink()


def damage_events(run: Path) -> None:
    (run / "truth" / "events.jsonl").write_text("not JSON\n")


def cut_events(run: Path) -> None:
    (run / "truth" / "events.jsonl").write_text('{"frame": 1')


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (damage_version, "run.json: expected schema version 3, found 99; make the run again"),
        (damage_head, "run.json: expected the head of a run's log, found damage"),
        (head_with(predictors=None), "predictors: expected list, found None"),
        (head_with(predictors=[1]), "predictors: expected names, found [1]"),
        (head_with(finished="yes"), "finished: expected bool, found 'yes'"),
        (head_with(frames=None), "frames: expected int, found None"),
        (head_with(settings=[]), "settings: expected dict, found []"),
        (head_with(weights_sha256="abc"), "weights_sha256: expected dict, found 'abc'"),
        (damage_part, "part-00000.parquet: expected a Parquet part of a run's log"),
        (lose_last_part, "expected 310 frames, found 300; a part was lost"),
        (lose_first_part, "part-00000.parquet is missing although part-00001.parquet is there"),
        (damage_events, "events.jsonl: a line is not JSON"),
        (cut_events, "events.jsonl: the last line is cut off"),
    ],
)
def test_damage_is_one_clear_error(tmp_path: Path, damage, message: str) -> None:
    write_run(tmp_path / "run", make_run(PART_FRAMES + 10))
    damage(tmp_path / "run")
    with pytest.raises(InputError) as caught:
        list(read_run(tmp_path / "run").frames())
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputError, match=r"expected the folder of a run, found no run\.json"):
            read_run(path)
