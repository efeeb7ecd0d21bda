"""Agents by name and by module:Class."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import scene_of

from hatn_sim.datatypes import Advice, Command
from hatn_sim.errors import InputError
from hatn_sim.plugins import load_agent
from hatn_sim.predictors.constant_velocity import ConstantVelocity
from hatn_sim.resources import find_agents
from hatn_sim.road import Road


def test_every_agent_that_ships_can_be_made_and_asked() -> None:
    road = Road([])
    scene = scene_of(0.0, {"a": (0.0, 0.0, 0.0, 8.0)})
    predictor = ConstantVelocity()
    prediction = predictor.predict(predictor.observe(predictor.init(road), scene))
    for name in find_agents():
        agent = load_agent(name)
        _, command = agent.step(agent.init(road), "a", scene, Advice(prediction, (), ()))
        assert command is None or command == Command("a", 0.0), name
    agent = load_agent("constant_speed")
    state, _ = agent.step(agent.init(road), "a", scene, Advice(prediction, (), ()))
    slower = scene_of(0.1, {"a": (0.8, 0.0, 0.0, 7.5)})
    _, command = agent.step(state, "a", slower, Advice(prediction, (), ()))
    assert command == Command("a", pytest.approx(5.0))  # half a metre per second in a tenth of one


def test_an_agent_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text(
        "class Calm:\n    def init(self, road): pass\n"
        "    def step(self, state, ego_id, scene, advice): return state, None\n"
        "class Half:\n    def init(self, road): pass\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert type(load_agent("mine:Calm")).__name__ == "Calm"
    with pytest.raises(InputError, match=r"agent 'mine:Half': has no 'step', see datatypes.Agent"):
        load_agent("mine:Half")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("constant_sped", r"unknown agent 'constant_sped'; did you mean 'constant_speed'\?"),
        ("nowhere_at_all:Agent", r"agent 'nowhere_at_all:Agent': No module named"),
    ],
)
def test_what_is_no_agent(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_agent(name)
