"""`hatn-sim run --drive`: agents in simulated traffic and in recordings replayed inside SUMO."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

from hatn_sim import cli
from hatn_sim.commands.run_names import check_routes
from hatn_sim.config import load_scenario
from hatn_sim.errors import InputError, nearest, nearest_vehicle
from hatn_sim.log import Run, read_run
from hatn_sim.resources import find_scenarios

QUICK = ("--predictor", "constant_velocity", "--quiet", "--no-picture", "--json")
NET = find_scenarios()["tjunction"].with_name("tjunction.net.xml")
NETS = Path(__file__).parent / "nets"
AGENTS = """
from hatn_sim.datatypes import Command

class _Agent:
    def init(self, road): return None

class Raises(_Agent):
    def step(self, state, ego_id, scene, advice): raise KeyError("boom")

class Endless(_Agent):
    def step(self, state, ego_id, scene, advice): return state, Command(ego_id, float("inf"))

class Meddling(_Agent):
    def step(self, state, ego_id, scene, advice): return state, Command("another", 1.0)

class Wordy(_Agent):
    def step(self, state, ego_id, scene, advice): return state, "faster"
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def run(*words: object) -> int:
    return cli.main(["run", *map(str, words), *QUICK])


def speeds(logged: Run, name: str) -> dict[float, float]:
    """Of a vehicle, by time."""
    return {
        scene.time_s: float(scene.speed_mps[scene.ids.index(name)])
        for scene in logged.scenes()
        if name in scene.ids
    }


def test_the_ego_of_highway_env_is_driven_from_the_beginning_or_from_a_time_on() -> None:
    words = ("highway_intersection", "--duration", 3, "--agent", "constant_speed")
    assert run(*words, "--drive", "ego", "--out", "begin") == 0
    assert run(*words, "--drive", "ego@1", "--out", "later") == 0
    assert run("highway_intersection", "--duration", 3, "--warm-up", 0, "--out", "own") == 0
    begin, later, own = (speeds(read_run(Path(name)), "ego") for name in ("begin", "later", "own"))
    assert len(begin) == len(later) == len(own) == 30 and min(begin) == 0.0
    np.testing.assert_allclose(list(begin.values()), begin[0.0], atol=1e-9)
    times = list(own)
    assert [later[t] for t in times[:11]] == [own[t] for t in times[:11]]
    assert abs(own[times[10]] - own[times[0]]) > 0.1
    np.testing.assert_allclose([later[t] for t in times[10:]], own[times[10]], atol=1e-9)


def test_nobody_of_that_name_or_nobody_at_all(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("tjunction", "--duration", 1, "--warm-up", 0, "--agent", "constant_speed")
    # Whom no route file knows is refused at once; which of a flow comes is seen in the run.
    for option in ("--drive", "--egos"):
        agent = words if option == "--drive" else words[:-2]
        assert run(*agent, option, "nobody", "--out", "out") == 2
        said = f"{option}: no vehicle called 'nobody' is in the route files of tjunction; "
        assert said in capsys.readouterr().err and not Path("out").exists()
        name = "east_west.999"
        assert run(*agent, option, name, "--out", option.strip("-")) == 2  # not what was asked for
        printed = capsys.readouterr()
        assert f"never seen in this run: {option} {name}" in printed.err
        json.loads(printed.out)
    assert run(*words[:-2], "--drive", ",") == 2
    assert "--drive ',': expected ID or ID@SECONDS" in capsys.readouterr().err
    assert run(*words[:-2], "--egos", ",") == 2
    assert "--egos: expected names, found none" in capsys.readouterr().err
    assert run(*words) == 2
    assert "--agent constant_speed drives nobody; add --drive" in capsys.readouterr().err
    for drive, said in (("a@nan", "ID or ID@SECONDS, found 'nan'"), ("a@1,a", "named twice")):
        assert run(*words, "--drive", drive) == 2
        assert said in capsys.readouterr().err


def test_names_are_refused_only_where_all_are_known(here: Path) -> None:
    def checked(scene: Path, egos: str | None, watched: str | None) -> None:
        names = None if egos is None else (egos,)
        given = Namespace(egos=names, drive=None, ego=watched)
        check_routes(given, load_scenario(str(scene)))

    # Its flow of persons is `g`; SUMO calls the first of them g.0, and a scene person:g.0.
    street = NETS / "street.sumocfg"
    checked(street, None, "person:g.0")
    for egos, watched in ((None, "g.0"), ("person:g.0", None), ("nobody", "person:g.0")):
        with pytest.raises(InputError, match="no vehicle called"):
            checked(street, egos, watched)
    # A state brings vehicles that no route file has.
    loaded = here / "loaded.sumocfg"
    words = street.read_text().replace('"street.', f'"{NETS}/street.')
    loaded.write_text(words.replace("</input>", '<load-state value="state.xml"/></input>'))
    checked(loaded, "nobody", "nobody")


@pytest.mark.parametrize(
    ("agent", "said"),
    [
        ("Raises", "the agent of 'ego' failed at 0.0 s: KeyError: 'boom' (drivers.py:8)"),
        ("Endless", "the agent of 'ego' at 0.0 s: its acceleration is not finite"),
        ("Meddling", "the agent of 'ego' at 0.0 s: it commands 'another'; expected its own"),
        ("Wordy", "the agent of 'ego' at 0.0 s: step returned str as its command"),
    ],
)
def test_a_fault_of_somebodys_agent_is_one_line(
    here: Path, agent: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "drivers.py").write_text(AGENTS)
    drive = ("--drive", "ego", "--agent", f"drivers:{agent}")
    assert run("highway_merge", *drive, "--out", "out") == 2
    assert capsys.readouterr().err.startswith(f"hatn-sim: {said}")


def test_a_run_replayed_inside_sumo(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--warm-up", 15, "--duration", 16, "--predictor", "hatn", "--lines", "route")
    assert cli.main(["run", "tjunction", *map(str, words), *QUICK[2:], "--out", "run"]) == 0
    replay = ["run", "run", "--net", str(NET), *QUICK[2:]]
    # Nobody is taken over: the same scenes and so the same advice.
    assert cli.main([*replay, "--lines", "route", "--out", "again"]) == 0
    for name in ("suggestions.jsonl", "alerts.jsonl"):
        assert Path("again", name).read_bytes() == Path("run", name).read_bytes()
    recorded = read_run(Path("run"))
    assert recorded.suggestions
    # Taken over in the middle, one vehicle keeps the speed that it was recorded with just then.
    by_time = {name: speeds(recorded, name) for name in recorded.ids}
    name, own = next(
        (n, v) for n, v in by_time.items() if len(v) > 80 and np.ptp(list(v.values())[:41]) > 0.2
    )
    at_s = list(own)[40]
    drive = ("--drive", f"{name}@{at_s:.1f}", "--agent", "constant_speed")
    assert cli.main([*replay, *drive, "--out", "taken"]) == 0
    driven = speeds(read_run(Path("taken")), name)
    after = [t for t in driven if at_s < t <= at_s + 3.0]
    np.testing.assert_allclose([driven[t] for t in after], own[at_s], atol=1e-6)
    assert all(driven[t] == own[t] for t in driven if t <= at_s)


def test_of_thousands_of_names_some_are_told() -> None:
    known = [f"{k:04}" for k in range(3000)]
    assert nearest("x", known[:20]) == "; known: " + ", ".join(known[:20])
    assert nearest("x", known) == "; known: " + ", ".join(known[:40]) + " and 2,960 more"


def test_of_vehicles_the_few_nearest_are_told() -> None:
    ids = [f"car{k}" for k in range(40)]
    assert nearest_vehicle("car77", ids) == nearest("car77", ids) != ""
    assert nearest_vehicle("x", ["b", "a"]) == "; known: a, b"
    # "ody" is shared with one, nothing with all others, of whom the last come first.
    told = nearest_vehicle("nobody", [*ids, "ody.......x"])
    assert told == "; known: ody.......x, car9, car8, car7, car6 and 36 more"
