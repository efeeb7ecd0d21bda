"""Whether somebody's own class is found out where it does not keep the protocols."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import slow_but

from hatn_sim import cli
from hatn_sim.conformance.agents import check_agent
from hatn_sim.conformance.points import Point
from hatn_sim.conformance.predictors import check_predictor
from hatn_sim.conformance.scenes import GONE, Footage, film
from hatn_sim.errors import InputError
from hatn_sim.plugins import load_agent
from hatn_sim.predictors.constant_velocity import ConstantVelocity
from hatn_sim.predictors.find import load_predictor

EXAMPLES = Path(__file__).parents[1] / "examples"
WRONG = '''
import numpy as np
from dataclasses import replace
from hatn_sim.datatypes import Command
from hatn_sim.predictors.constant_velocity import ConstantVelocity

class Sums(ConstantVelocity):
    def predict(self, state):
        said = super().predict(state)
        return replace(said, mode_probability=0.5 * said.mode_probability)

class Single(ConstantVelocity):
    def predict(self, state):
        said = super().predict(state)
        return replace(said, xy_m=said.xy_m.astype(np.float32))

class Dice(ConstantVelocity):
    def predict(self, state):
        said = super().predict(state)
        return replace(said, xy_m=said.xy_m + np.random.normal())

class Writes(ConstantVelocity):
    def observe(self, state, scene, routes=None):
        scene.speed_mps[:] = 1.0
        return scene

class Hoards(ConstantVelocity):
    """Predicts of the newest scene, whatever memory it is handed."""
    def observe(self, state, scene, routes=None):
        self.newest = scene
        return scene
    def predict(self, state):
        return super().predict(self.newest)

class Rows(ConstantVelocity):
    def predict(self, state):
        said = super().predict(state)
        return replace(said, xy_m=said.xy_m + np.arange(len(state.ids))[:, None, None, None])

class Never(ConstantVelocity):
    def predict(self, state):
        state.speed_mps.max()
        return super().predict(state)

class Deaf(ConstantVelocity):
    def observe(self, state, scene, routes=None):
        assert routes is None, "no routes, please"
        return scene

class Looks(ConstantVelocity):
    """Peeks: whatever it was shown in an earlier run tells it what comes."""
    known = {}
    def observe(self, state, scene, routes=None):
        before, self.before = getattr(self, "before", None), scene
        if before is not None and before.time_s < scene.time_s:
            self.known[before.time_s] = scene
        return scene
    def predict(self, state):
        return replace(super().predict(state), xy_m=super().predict(state).xy_m
            + float(self.known.get(state.time_s, state).speed_mps.sum() - state.speed_mps.sum()))

class Turned(ConstantVelocity):
    """Another order, no number for somebody, and too little probability: three faults."""
    def predict(self, state):
        said = super().predict(state)
        odd = said.xy_m[::-1].copy()
        first = min(state.ids, default="")
        odd[[len(odd) > 1 and name == first for name in state.ids[::-1]]] = np.nan
        return replace(said, ids=said.ids[::-1], xy_m=odd,
            mode_probability=0.7 * said.mode_probability[::-1])

class Short(ConstantVelocity):
    def predict(self, state):
        said = super().predict(state)
        return replace(said, xy_m=said.xy_m[:, :, :5])

class Hasty:
    def init(self, road): return None
    def step(self, state, ego_id, scene, advice): return state, Command(ego_id, 100.0)

class Boundless(Hasty):
    def step(self, state, ego_id, scene, advice): return state, Command(ego_id, float("inf"))

class Moody:
    def __init__(self): self.asked = 0
    def init(self, road): return None
    def step(self, state, ego_id, scene, advice):
        self.asked += 1
        return state, Command(ego_id, float(self.asked % 7)) if ego_id in scene.ids else None

class Three:
    def init(self, road): return None
    def step(self, state, scene, advice): return state, None

class Alone:
    def init(self, road): return None
    def step(self, state, ego_id, scene, advice): return state
'''


def test_a_scene_that_ends_too_soon_is_not_waited_for(tmp_path: Path) -> None:
    nets = Path(__file__).parent / "nets"
    text = (nets / "street.sumocfg").read_text(encoding="utf-8").replace('"600"', '"20"')
    for named in ("street.net.xml", "street.rou.xml"):
        text = text.replace(named, str(nets / named))
    short = tmp_path / "short.sumocfg"
    short.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"found its end at 20\.0 s; name another scene"):
        film(str(short))


@pytest.fixture(scope="module")
def footage() -> Footage:
    """As much as it takes for a vehicle to be out of sight and back; `film` takes 4 s."""
    whole = film("tjunction")
    return replace(whole, frames=whole.frames[: GONE[1] + 6])


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "wrong_ones.py").write_text(WRONG)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


def failed(points: list[Point]) -> dict[str, str]:
    return {point.name: point.said for point in points if not point.ok and point.reached}


def hidden(points: list[Point]) -> set[str]:
    return {point.name for point in points if not point.reached}


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(
    ("name", "point", "said"),
    [
        ("Sums", "probabilities sum to 1", "found a sum of 0.5; normalise it"),
        ("Single", "shapes, dtypes and finite numbers", "expected xy_m of float64; found float32"),
        ("Dice", "the same again", "found another xy_m at frame 0; seed what is random"),
        ("Writes", "input is left as it is", "found another speed_mps; copy before writing"),
        ("Hoards", "memory is handed out", "observe must return a new state"),
        ("Rows", "the order of vehicles is without effect", "look vehicles up by id"),
        ("Never", "an empty scene", "found ValueError: zero-size array"),
        ("Deaf", "routes are taken where they are given", "AssertionError: no routes, please"),
        ("Looks", "no peeking at what comes", "use nothing but the scenes observed in"),
    ],
)
def test_a_predictor_that_does_not_keep_a_point(
    footage: Footage, name: str, point: str, said: str
) -> None:
    points = list(
        check_predictor(lambda: load_predictor(f"wrong_ones:{name}"), footage, ConstantVelocity())
    )
    assert said in failed(points)[point]
    assert "\n" not in failed(points)[point]


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(
    ("name", "point", "said"),
    [
        ("Boundless", "commands, advised by constant_velocity", "its acceleration is not finite"),
        ("Hasty", "its vehicle is not there", "expected no command while the vehicle is not there"),
        ("Moody", "the same again", "keep memory in the state"),
        ("Moody", "memory is handed out", "asked later,"),
        ("Alone", "commands, advised by constant_velocity", "found NoneType; return both"),
    ],
)
def test_an_agent_that_does_not_keep_a_point(
    footage: Footage, name: str, point: str, said: str
) -> None:
    advisers = (ConstantVelocity(),)
    points = list(check_agent(lambda: load_agent(f"wrong_ones:{name}"), footage, advisers))
    assert said in failed(points)[point]


@pytest.mark.usefixtures("mine")
def test_a_fault_is_told_once_and_hides_no_other(footage: Footage) -> None:
    def points_of(name: str) -> list[Point]:
        made = lambda: load_predictor(f"wrong_ones:{name}")  # noqa: E731
        return list(check_predictor(made, footage, ConstantVelocity()))

    several = points_of("Turned")
    said = failed(several)
    assert "found another order (put right for the points below)" in said.pop(
        "everybody in the scene, in its order"
    )
    assert "is not finite" in said.pop("shapes, dtypes and finite numbers")
    assert "found a sum of 0.7" in said.pop("probabilities sum to 1")
    assert said == {} and hidden(several) == {"one vehicle"}
    short = points_of("Short")
    first = next(iter(failed(short).values()))
    assert len(failed(short)) == 1 and "xy_m has shape" in first
    assert "probabilities sum to 1" in hidden(short)


@pytest.mark.usefixtures("mine")
def test_a_step_of_other_arguments_is_told_by_its_name(footage: Footage) -> None:
    made = lambda: load_agent("wrong_ones:Three")  # noqa: E731
    points = list(check_agent(made, footage, (ConstantVelocity(),)))
    said = failed(points)
    assert said == {
        "methods": "expected step(state, ego_id, scene, advice); found step(state, scene, advice); "
        "give it these arguments, in this order"
    }
    assert len(hidden(points)) == len(points) - 1


@pytest.mark.parametrize(
    "name",
    slow_but(
        ["sumo_driver", "constant_speed", "idm", "heed", "hatn_planner", "mpc", "ppo"],
        *("idm", "heed", "mpc", "ppo"),
    ),
)
def test_agents_that_ship_keep_every_point(footage: Footage, name: str) -> None:
    points = list(check_agent(lambda: load_agent(name), footage, (ConstantVelocity(),)))
    assert failed(points) == {} and len(points) == 10


def test_predictors_that_ship_keep_every_point(footage: Footage) -> None:
    for name in ("fsm_t", "hatn"):
        points = list(
            check_predictor(lambda name=name: load_predictor(name), footage, ConstantVelocity())
        )
        assert failed(points) == {}, name


def test_the_example_passes_and_the_command_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(EXAMPLES)
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.delitem(sys.modules, "my_predictor", raising=False)  # somebody else's
    words = ["check-predictor", "my_predictor:Slowing", "--scenes", "tjunction"]
    assert cli.main(words) == 0
    printed = capsys.readouterr().out
    assert printed.endswith("my_predictor:Slowing: all points kept\n")
    assert "ms a step of" in printed and "FAILED" not in printed
    body = (EXAMPLES / "my_predictor.py").read_text().partition("class Slowing:")[2]
    assert len([line for line in body.splitlines() if line.strip()]) <= 24
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "wrong_ones.py").write_text(WRONG)
    words[1] = "wrong_ones:Sums"
    assert cli.main([*words, "--json"]) == 2
    said = json.loads(capsys.readouterr().out)
    wrong = [point for point in said["points"] if not point["ok"]]
    assert said["failed"] == sum(point["reached"] for point in wrong) == 1
    assert [point["name"] for point in wrong if not point["reached"]] == ["one vehicle"]
    assert cli.main(["check-predictor", "hatm"]) == 2
    assert "did you mean 'hatn'" in capsys.readouterr().err
