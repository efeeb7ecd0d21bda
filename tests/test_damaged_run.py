"""Runs whose files are hurt: every command shows what is there, says what is not, and no more."""

from __future__ import annotations

import base64
import gzip
import json
import re
import shutil
import zlib
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import pytest
from conftest import lane
from page_runs import made_up_run
from test_export import driving, log

from hatn_sim.cli import main
from hatn_sim.errors import InputError
from hatn_sim.log import PART_FRAMES, Part, read_run
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.recordings.fcd.export import export_fcd

PART = "part-00000.parquet"
FRAMES = 90
"""As many as it takes to judge the alert: 5 s after its beginning."""
VITAL = {"run.json", f"tracks/{PART}", f"frames/{PART}"}
"""Without these there is no run."""
LOST = {
    "suggestions.jsonl": "advice is left out",
    "alerts.jsonl": "alerts are left out",
    "truth/events.jsonl": "collisions, emergency braking and teleports are left out",
    "truth/routes.jsonl": "the routes that were driven are left out",
    f"truth/{PART}": "the routes that were driven are left out",
    f"predictions/made_up/{PART}": "predictions are left out",
    ROAD_FILE: "the road and slots are left out",
    "scores.json": "scores are left out",
}
"""What `report` says of every other file, at the console and on the page."""
CUT = {"suggestions.jsonl", "alerts.jsonl", "truth/events.jsonl"}
"""Files of lines: what stands before the cut is shown."""


def half(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


HURT: dict[str, Callable[[Path], None]] = {"lost": Path.unlink, "half": half, "empty": empty}
COMMANDS = {
    "report": ("report", "--no-animation"),
    "figures": ("figures", "--only", "moment", "--formats", "svg"),
    "animate": ("animate", "--from", "102.5", "--to", "102.7", "--quiet"),
    "fcd": ("export", "--format", "fcd"),
    "interaction": ("export", "--format", "interaction"),
    "score": ("score",),
}
DRAWN = {"figures", "animate"}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = made_up_run(tmp_path_factory.mktemp("sound") / "run", FRAMES)
    (run / "scores.json").write_text("[]\n")
    return run


def hurt(sound: Path, folder: Path, file: str, how: str) -> Path:
    run = folder / "run"
    shutil.rmtree(run, ignore_errors=True)
    shutil.copytree(sound, run)
    HURT[how](run / file)
    return run


def notices(page: Path) -> list[str]:
    """Those that the page was given to show."""
    packed = re.search(r'id="head">([^<]+)<', page.read_text())
    assert packed is not None
    head = json.loads(zlib.decompress(base64.b64decode(packed[1]), -zlib.MAX_WBITS))
    return head["notices"]


def test_no_file_is_forgotten(sound: Path) -> None:
    files = {str(one.relative_to(sound)) for one in sound.rglob("*") if one.is_file()}
    assert files == VITAL | LOST.keys()


@pytest.mark.parametrize(
    ("how", "commands"),
    [
        ("lost", COMMANDS.keys()),
        ("half", COMMANDS.keys() - DRAWN),  # all pictures are drawn of what `report` reads, too
        pytest.param("half", DRAWN, marks=pytest.mark.slow),
        pytest.param("empty", COMMANDS.keys(), marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("file", sorted(VITAL | LOST.keys()))
def test_whatever_is_hurt_is_one_plain_line(
    sound: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    file: str,
    how: str,
    commands: Collection[str],
) -> None:
    run = hurt(sound, tmp_path, file, how)
    for name in sorted(commands):
        command, *words = COMMANDS[name]
        out = tmp_path / name
        target = {"animate": ("--out", str(out / "film.gif")), "score": ()}
        status = main([command, str(run), *words, *target.get(name, ("--out", str(out)))])
        told = capsys.readouterr().err.splitlines()
        made = [one for one in out.rglob("*") if one.is_file()] if out.exists() else []
        if file in VITAL:
            assert status == 2
        assert status in (0, 2), (name, told)
        if status == 2:
            assert told and not made
        elif name != "score":
            assert made
        assert not [one for one in made if one.name.startswith(".")], "half a file"
        # Without predictions the picture has a line of its own: why there is none.
        assert len(told) <= 1 + file.startswith("predictions"), told
        assert all(one.startswith("hatn-sim: ") and one.count(str(run)) == 1 for one in told), told
        if name == "report" and how == "lost" and file in LOST:
            where = f"{Path(file).parent}/" if file.startswith("predictions") else file
            assert told[0] == f"hatn-sim: {run}: {where} is missing: {LOST[file]}"
            assert notices(out / "report.html") == [f"{where} is missing: {LOST[file]}."]


@pytest.mark.parametrize("finished", [True, False])
def test_half_a_line_at_the_end_is_dropped_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], finished: bool
) -> None:
    run = made_up_run(tmp_path / "run", finished=finished)
    whole = read_run(run).alerts
    with (run / "alerts.jsonl").open("a") as file:
        file.write('{"frame": 40, "alert_id": "a2", "ed')
    assert read_run(run, whole=False).alerts == whole
    assert main(["report", str(run), "--no-animation"]) == 0
    lines = f"is cut off after {len(whole)} lines" if finished else "ends in half a line"
    expected = f"alerts.jsonl {lines}: the rest is left out"
    assert f"hatn-sim: {run}: {expected}" in capsys.readouterr().err.splitlines()
    assert f"{expected}." in notices(run / "report.html")
    if finished:  # no kill did that: a replay, which needs all, is refused
        with pytest.raises(InputError, match=r"alerts\.jsonl: the last line is cut off"):
            _ = read_run(run).alerts


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "a line is not JSON (line 2: "),
        ("{}", "line 2 is not as a run leaves it (KeyError('frame'))"),
        ("5", "line 2 is not as a run leaves it (TypeError("),
    ],
)
def test_a_bad_line_elsewhere_is_an_error_with_its_number(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, words: str
) -> None:
    shutil.copytree(sound, tmp_path / "run")
    path = tmp_path / "run" / "alerts.jsonl"
    first, *others = path.read_text().splitlines()
    path.write_text("\n".join((first, line, *others, "")))
    assert main(["report", str(tmp_path / "run"), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told[-1].startswith(f"hatn-sim: {path}: {words}")
    assert not (tmp_path / "out").exists()


def test_lines_of_frames_that_a_kill_took_back_do_not_count(tmp_path: Path) -> None:
    run = made_up_run(tmp_path / "run", finished=False)
    line = json.loads((run / "alerts.jsonl").read_text().splitlines()[0])
    with (run / "alerts.jsonl").open("a") as file:
        file.write(json.dumps({**line, "frame": 9999, "ego_id": "nobody"}) + "\n")
    assert len(read_run(run, whole=False).alerts) == len(read_run(run).alerts) - 1
    assert main(["report", str(run), "--no-animation"]) == 0


@pytest.mark.parametrize("finished", [True, False])
def test_without_frames_there_is_no_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], finished: bool
) -> None:
    run = made_up_run(tmp_path / "run", finished=finished)
    shutil.rmtree(run / "frames")
    for command in ("report", "figures", "animate", "score"):
        assert main([command, str(run)]) == 2
        told = capsys.readouterr().err
        assert told.startswith(f"hatn-sim: {run}: expected 150 frames, found 0; "), told


def killed(run: Path) -> Path:
    """As it is left where nobody could close it: the head is that of the last part."""
    head = json.loads((run / "run.json").read_text())
    del head["line_counts"]
    (run / "run.json").write_text(json.dumps(head))
    return run


def without_last_line(path: Path) -> int:
    """How many are left."""
    *lines, _ = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines))
    return len(lines)


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("file", ["suggestions.jsonl", "alerts.jsonl", "truth/events.jsonl"])
def test_whole_lines_lost_at_the_end_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], file: str, finished: bool
) -> None:
    run = made_up_run(tmp_path / "run", finished=finished)
    assert not [gap for gap in read_run(run, whole=False).gaps if gap.file != "scores.json"]
    left = without_last_line(run / file)
    found = f"{file} has {left} of {left + 1} lines"
    told = [str(gap) for gap in read_run(run, whole=False).gaps]
    assert f"{found}: the rest is left out" in told
    assert main(["score", str(run)]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said[-1] == f"hatn-sim: {run}: {found}: alerts and suggestions are not scored"
    read = {"suggestions.jsonl": "suggestions", "alerts.jsonl": "alerts"}.get(file, "events")
    assert len(getattr(read_run(run, whole=False), read)) == left
    with pytest.raises(InputError, match=rf"{file}: expected {left + 1} lines, found {left}; "):
        getattr(read_run(run), read)


def test_a_run_that_was_not_closed_has_no_counts(tmp_path: Path) -> None:
    run = made_up_run(tmp_path / "run", finished=False)
    head = json.loads((run / "run.json").read_text())
    # Two cars, of whom one is advised once; an onset, a peak and an end; a collision; no routes.
    assert head["line_counts"] == {
        "suggestions.jsonl": 1,
        "alerts.jsonl": 3,
        "truth/events.jsonl": 1,
        "truth/routes.jsonl": 0,
    }
    without_last_line(killed(run) / "alerts.jsonl")
    assert {gap.file for gap in read_run(run, whole=False).gaps} == {"scores.json"}
    assert len(read_run(run).alerts) == 2


@pytest.mark.parametrize("counts", [[], {"alerts.jsonl": "3"}, {"alerts.jsonl": True}])
def test_counts_that_are_none_are_damage(tmp_path: Path, counts: object) -> None:
    run = made_up_run(tmp_path / "run")
    head = json.loads((run / "run.json").read_text()) | {"line_counts": counts}
    (run / "run.json").write_text(json.dumps(head))
    with pytest.raises(InputError, match="expected the head of a run's log, found damage"):
        read_run(run)


def test_of_predictions_in_parts_the_others_are_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = made_up_run(tmp_path / "run", frames=PART_FRAMES + 50)
    (run / "scores.json").write_text("[]\n")
    every = read_run(run).predictions("made_up").frame
    assert set(every.tolist()) == set(range(PART_FRAMES + 50))
    for part, lost in ((0, PART_FRAMES), (1, 50)):
        hurt_run = tmp_path / f"without-{part}"
        shutil.copytree(run, hurt_run)
        name = f"predictions/made_up/part-{part:05d}.parquet"
        (hurt_run / name).unlink()
        expected = f"{name} is missing: predictions of {lost} of 350 frames are left out"
        found = read_run(hurt_run, whole=False)
        assert [str(gap) for gap in found.gaps] == [expected]
        left = found.predictions("made_up").frame
        assert np.array_equal(left, every[every // PART_FRAMES != part])
        assert main(["score", "--json", str(hurt_run)]) == 0
        said = capsys.readouterr()
        # Alerts are told by the crossings that were seen: of the whole run, or not at all.
        not_scored = f"{name} is missing: alerts and suggestions are not scored"
        lines = [f"{hurt_run}: {expected}", f"{hurt_run}: {not_scored}"]
        assert said.err.splitlines() == [f"hatn-sim: {line}" for line in lines]
        scores = json.loads(said.out)
        assert all(one["left_out"] == lines for one in scores)
        assert {one["n"] for one in scores if one["measure"] == "ade_3s"} != {0}
        assert not {one["measure"] for one in scores} & {"event_recall", "suggestion_agreement"}


def test_what_a_scene_lacks_is_said_of_its_scores_alone(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = hurt(sound, tmp_path, "alerts.jsonl", "lost")
    head = json.loads((other / "run.json").read_text()) | {"scene": "elsewhere"}
    (other / "run.json").write_text(json.dumps(head))
    assert main(["score", "--json", str(sound), str(other)]) == 0
    scores = json.loads(capsys.readouterr().out)
    lacking = {one["scene"] for one in scores if "left_out" in one}
    assert lacking == {"elsewhere"} < {one["scene"] for one in scores}


@pytest.mark.parametrize("lines", ["inferred", "route"])
def test_lost_routes_are_told_where_scores_need_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], lines: str
) -> None:
    run = made_up_run(tmp_path / "run")
    head = json.loads((run / "run.json").read_text())
    head["settings"]["lines"] = lines
    (run / "run.json").write_text(json.dumps(head))
    (run / "truth" / "routes.jsonl").unlink()
    assert main(["score", str(run)]) == 0
    told = capsys.readouterr().err
    assert ("routes that lines followed, and with them slots, are left out" in told) == (
        lines == "route"
    )


def test_lost_counterfactuals_are_none_that_nobody_asked_for(tmp_path: Path) -> None:
    run = made_up_run(tmp_path / "run")
    assert read_run(run).counterfactuals is None
    head = json.loads((run / "run.json").read_text())
    head["line_counts"]["counterfactuals.jsonl"] = 4
    (run / "run.json").write_text(json.dumps(head))
    assert read_run(run, whole=False).counterfactuals is None
    with pytest.raises(InputError, match=r"counterfactuals\.jsonl"):
        _ = read_run(run).counterfactuals


def test_half_a_line_that_a_kill_left_is_told_by_score_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = killed(made_up_run(tmp_path / "run", finished=False))
    with (run / "suggestions.jsonl").open("a") as file:
        file.write('{"frame": 40, "ego')
    assert main(["score", "--json", str(run)]) == 0
    said = capsys.readouterr()
    lines = [
        f"{run} is of an unfinished run: its first 15.0 s were written",
        f"{run}: suggestions.jsonl ends in half a line: the rest is left out",
    ]
    assert said.err.splitlines() == [f"hatn-sim: {line}" for line in lines]
    scores = json.loads(said.out)
    assert all(one["left_out"] == lines for one in scores)
    assert "event_recall" in {one["measure"] for one in scores}


def test_lines_along_lost_routes_are_not_guessed(tmp_path: Path) -> None:
    run = made_up_run(tmp_path / "run")
    head = json.loads((run / "run.json").read_text())
    head["settings"]["lines"] = "route"
    (run / "run.json").write_text(json.dumps(head))
    assert read_run(run, whole=False).has_lines
    (run / "truth" / PART).unlink()
    found = read_run(run, whole=False)
    assert not found.has_lines and Part.ROUTES in found.parts_left_out


def test_scores_of_a_run_without_alerts_leave_assistance_out(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", "--json", str(sound)]) == 0
    everything = {one["measure"] for one in json.loads(capsys.readouterr().out)}
    run = hurt(sound, tmp_path, "alerts.jsonl", "lost")
    assert main(["score", "--json", str(run)]) == 0
    said = capsys.readouterr()
    left = {one["measure"] for one in json.loads(said.out)}
    assert said.err == (
        f"hatn-sim: {run}: alerts.jsonl is missing: alerts and suggestions are not scored\n"
    )
    assert "ade_3s" in left and left < everything


def test_a_recording_without_its_signals_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    straight = lane("in", [(-80.0, 0.0), (0.0, 0.0)], signals={"out": 0})
    lanes = [straight, lane("out", [(0.0, 0.0), (90.0, 0.0)])]
    frames = driving(60)
    log(tmp_path / "run", frames)
    write_road(tmp_path / "run" / ROAD_FILE, lanes)
    tracks, road = export_fcd(read_run(tmp_path / "run"), tmp_path)
    known, unknown = tmp_path / "known", tmp_path / "unknown"
    words = ["--map", str(road), "--predictor", "constant_velocity", "--no-picture"]
    assert main(["run", "--tracks", str(tracks), *words, "--out", str(known)]) == 0
    text = gzip.decompress(tracks.read_bytes()).decode()
    plain = tmp_path / "plain.xml"
    plain.write_text(re.sub(' closed="[01]*"', "", text))
    assert main(["run", "--tracks", str(plain), *words, "--out", str(unknown)]) == 0
    assert "signals" not in json.loads((known / "run.json").read_text())["settings"]
    assert json.loads((unknown / "run.json").read_text())["settings"]["signals"] == "unknown"
    again = tmp_path / "again"
    played = ["run", str(unknown), "--predictor", "constant_velocity", "--no-picture"]
    assert main([*played, "--out", str(again)]) == 0
    for run, is_known in ((known, True), (unknown, False), (again, False)):
        assert read_run(run).signals_known == is_known
        assert main(["report", str(run), "--no-animation"]) == 0
        said = [one for one in notices(run / "report.html") if "signals" in one]
        assert bool(said) != is_known
    capsys.readouterr()
    assert np.all([len(one.scene.signal_closed) == 0 for one in read_run(unknown).frames()])
