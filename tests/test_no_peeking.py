"""The future is shuffled, and what was advised until then is what was advised before."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hatn_sim import cli
from hatn_sim.assist.settings import ORDERED, AssistSettings
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Advice, Branch, Change, Command, Frame, Plan, Scene, Truth
from hatn_sim.log import read_run
from hatn_sim.log.schema import ALERTS_FILE, SUGGESTIONS_FILE
from hatn_sim.loop import Adviser, run, warm_up
from hatn_sim.predictors.find import load_predictor
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

SCENE = "do_warn_crossing"
WARM_UP_S = 7.0
NOW = 40
"""Frames until the future is another; an alert is on by then."""
FRAMES = 60
TRACKS_FILE = "vehicle_tracks_000.csv"
QUIET = ["--no-picture", "--quiet", "--json", "--assist"]
RUN = ["run", SCENE, "--seed", "301", "--warm-up", str(WARM_UP_S), *QUIET]
END, ONSET = ORDERED[0]
WORRIED: dict[str, Any] = {ONSET: 0.1, END: 0.05}
"""Settings, so that there are alerts."""


@dataclass
class Played:
    """A simulator that plays frames; the first has been taken out already."""

    road: Road
    rest: list[Frame]
    name: str = "played"
    notices: Sequence[str] = ()
    dt_s: float = 0.1
    cannot_branch: str | None = "frames are played"

    def reset(self, seed: int) -> Frame:
        raise NotImplementedError

    def step(self, commands: Sequence[Command] = ()) -> Frame:
        return self.rest.pop(0)

    def branch(self, futures: Sequence[Sequence[Change]], horizon_s: float) -> Sequence[Any]:
        raise NotImplementedError

    def close(self) -> None: ...


def frames_of(branch: Branch, like: Scene) -> list[Frame]:
    """From the frame after now on; all are cars without blinkers."""
    frames: list[Frame] = []
    for when in range(1, len(branch.time_s)):
        there = np.flatnonzero(branch.valid[when])
        scene = Scene(
            time_s=float(branch.time_s[when]),
            ids=tuple(branch.ids[v] for v in there.tolist()),
            xy_m=branch.xy_m[when, there],
            yaw_rad=branch.yaw_rad[when, there],
            speed_mps=branch.speed_mps[when, there],
            size_m=branch.size_m[there],
            kind=np.zeros(len(there), np.int64),
            colour=np.zeros((len(there), 3), np.int64),
            blinker=np.zeros(len(there), np.int64),
            signal_closed=like.signal_closed,
        )
        frames.append(Frame(scene, Truth((None,) * len(there)), done=False))
    return frames


def advised(road: Road, frames: Sequence[Frame]) -> list[tuple[Any, ...]]:
    """Suggestions and alerts of every frame, as they are once the last of them has been seen."""
    told: list[Advice] = []
    adviser = Adviser(load_predictor("hatn", None, "none"), settings=AssistSettings(**WORRIED))
    run(
        Played(road, list(frames[1:])),
        [adviser],
        frames[0],
        len(frames),
        lambda _, __, advice: told.append(advice["hatn"]),
    )
    return [(one.suggestions, one.alerts) for one in told]


Frames = list[Frame]
SHUFFLED: dict[str, Callable[[Frames, Frames, Frames], Frames]] = {
    "a branch": lambda past, _, branched: [*past, *branched],
    "backwards": lambda past, future, _: [*past, *future[::-1]],
    "nobody": lambda past, future, _: [
        *past,
        *(replace(one, scene=past[0].scene, truth=past[0].truth) for one in future),
    ],
    "none at all": lambda past, _, __: past,
}


def test_advice_until_now_is_the_same_whatever_comes() -> None:
    with SumoSimulator(load_scenario(SCENE)) as simulator:
        frames = [warm_up(simulator, simulator.reset(301), round(WARM_UP_S / 0.1))]
        frames += [simulator.step() for _ in range(NOW - 1)]
        now = frames[-1].scene
        # Everybody drives on at 12 m/s, come what may.
        plans = [Plan(name, 0.0, np.full(FRAMES - NOW, 12.0)) for name in now.ids]
        (future,) = simulator.branch([plans], 0.1 * (FRAMES - NOW))
        frames += [simulator.step() for _ in range(FRAMES - NOW)]
        branch = future.result()
        assert branch is not None
        road = simulator.road
        past, rest, branched = frames[:NOW], frames[NOW:], frames_of(branch, now)
        expected = advised(road, frames)
        assert any(suggestions for suggestions, _ in expected[:NOW])
        assert any(alerts for _, alerts in expected[:NOW])
        for name, shuffle in SHUFFLED.items():
            found = advised(road, shuffle(past, rest, branched))
            assert found[:NOW] == expected[:NOW], name
            assert found[NOW:] != expected[NOW:], name


def test_advice_does_not_know_what_only_the_simulator_does() -> None:
    with SumoSimulator(load_scenario("roundabout8", None, "inattentive")) as simulator:
        frames = [warm_up(simulator, simulator.reset(301), 600)]
        frames += [simulator.step() for _ in range(NOW)]
        blind = [replace(one, truth=Truth((None,) * len(one.scene.ids))) for one in frames]
        assert advised(simulator.road, blind) == advised(simulator.road, frames)


def lines_before(folder: Path, frame: int) -> tuple[list[str], list[str]]:
    """Of suggestions and alerts, as they were written."""
    kept: list[list[str]] = []
    for name in (SUGGESTIONS_FILE, ALERTS_FILE):
        lines = (folder / name).read_text(encoding="utf-8").splitlines()
        kept.append([line for line in lines if json.loads(line)["frame"] < frame])
    return kept[0], kept[1]


def test_the_log_until_somebody_is_driven_otherwise_is_the_same(tmp_path: Path) -> None:
    own, driven, shorter = (tmp_path / name for name in ("own", "driven", "shorter"))
    settings = tmp_path / "assist.toml"
    settings.write_text("".join(f"{key} = {value}\n" for key, value in WORRIED.items()))
    words = [*RUN, "--assist-settings", str(settings), "--duration"]
    assert cli.main([*words, f"{0.1 * FRAMES:g}", "--out", str(own)]) == 0
    scenes = list(read_run(own).scenes())
    now = scenes[NOW]
    drive = ",".join(f"{name}@{now.time_s:g}" for name in now.ids)
    driving = ["--out", str(driven), "--drive", drive, "--agent", "constant_speed"]
    assert cli.main([*words, f"{0.1 * FRAMES:g}", *driving]) == 0
    after = list(read_run(driven).scenes())
    assert after[NOW].xy_m.tobytes() == now.xy_m.tobytes()
    assert after[FRAMES - 1].xy_m.tobytes() != scenes[FRAMES - 1].xy_m.tobytes()
    before = lines_before(own, NOW + 1)
    assert all(before)
    assert lines_before(driven, NOW + 1) == before
    assert lines_before(driven, FRAMES) != lines_before(own, FRAMES)
    assert cli.main([*words, f"{0.1 * NOW:g}", "--out", str(shorter)]) == 0
    assert lines_before(shorter, FRAMES) == lines_before(own, NOW)


def test_advice_on_recorded_tracks_does_not_know_where_they_lead(tmp_path: Path) -> None:
    scene = load_scenario("recorded_sample").config_path.parent
    cut = tmp_path / "cut"
    shutil.copytree(scene, cut)
    head, *rows = (cut / TRACKS_FILE).read_text(encoding="utf-8").splitlines()
    frames = [int(row.split(",")[1]) for row in rows]
    past = [row for row, frame in zip(rows, frames, strict=True) if frame < min(frames) + NOW]
    (cut / TRACKS_FILE).write_text("\n".join([head, *past]) + "\n", encoding="utf-8")
    logs: list[tuple[list[str], list[str]]] = []
    for folder in (scene, cut):
        out = tmp_path / f"run-{len(logs)}"
        words = ["--tracks", str(folder / TRACKS_FILE), "--map", str(folder / "map.osm")]
        words += ["--lines-from", "lanes", "--duration", f"{0.1 * FRAMES:g}", "--out", str(out)]
        assert cli.main(["run", *words, *QUIET]) == 0
        logs.append(lines_before(out, NOW))
    assert logs[0][0] and logs[0] == logs[1]
