"""To begin in the midst of traffic: frames before as history, beside perceiving each of them."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from hatn_sim.commands.chosen_predictors import load_predictors
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame, Predictor, Route, Scene
from hatn_sim.loop import Adviser, AdviserState, begin, foresee, observe, recall, warm_up
from hatn_sim.predictors.constant_velocity import ConstantVelocity
from hatn_sim.road import Road
from hatn_sim.traffic import open_traffic

Traffic = tuple[Road, list[Frame]]


@pytest.fixture(scope="module", params=["intersection5", "roundabout8"])
def traffic(request: pytest.FixtureRequest) -> Traffic:
    """Eleven frames after 40 s."""
    scenario = load_scenario(request.param, None, "courteous")
    with closing(open_traffic(scenario)) as simulator:
        frames = [warm_up(simulator, simulator.reset(311), 400)]
        frames += [simulator.step() for _ in range(10)]
        return simulator.road, frames


def recalled(adviser: Adviser, road: Road, frames: list[Frame]) -> AdviserState:
    return observe(adviser, recall(adviser, begin(adviser, road), frames[:-1]), frames[-1])


def observed(adviser: Adviser, road: Road, frames: list[Frame]) -> AdviserState:
    state = begin(adviser, road)
    for frame in frames:
        state = observe(adviser, state, frame)
    return state


def lanes_ahead(state: AdviserState) -> list[Route]:
    """The lane of every vehicle and the next two of its line."""
    lines, road = state.perception.seen.lines, state.perception.road
    ahead: list[Route] = []
    for line, s_m in zip(lines.line.tolist(), lines.s_m.tolist(), strict=True):
        reference = road.lines[line]
        now = int(np.searchsorted(reference.lane_start_s_m, s_m, side="right")) - 1
        ahead.append(reference.route[now : now + 3])
    return ahead


def as_driven(state: AdviserState, frame: Frame) -> int:
    """How many lines lead where the simulator's vehicles are going."""
    pairs = zip(lanes_ahead(state), frame.truth.routes, strict=True)
    return sum(ahead[-1] in (route or ()) for ahead, route in pairs)


@pytest.mark.parametrize("name", ["hatn", "constant_velocity", "idm"])
def test_what_was_before_is_known_without_having_been_looked_at(
    name: str, traffic: Traffic
) -> None:
    (predictor,) = load_predictors((name,), None, "none", True, frozenset())
    adviser, newest = Adviser(predictor), traffic[1][-1]
    one, other = recalled(adviser, *traffic), observed(adviser, *traffic)
    seen, whole = one.perception.seen, other.perception.seen
    for part in ("xy_m", "yaw_rad", "speed_mps", "valid"):
        assert np.array_equal(getattr(seen.tracks, part), getattr(whole.tracks, part))
    assert as_driven(one, newest) >= as_driven(other, newest) - 1
    assert as_driven(one, newest) > 0.6 * len(newest.scene.ids)
    same_line = seen.lines.line == whole.lines.line
    assert same_line.sum() > 4
    assert seen.lines.s_m[same_line] == pytest.approx(whole.lines.s_m[same_line], abs=0.05)
    assert seen.lines.d_m[same_line] == pytest.approx(whole.lines.d_m[same_line], abs=0.01)


class Counting(ConstantVelocity):
    """A predictor of somebody's own that counts what it is shown."""

    def init(self, road: Road) -> tuple[int, Scene | None]:  # type: ignore[override]
        return 0, None

    def observe(  # type: ignore[override]
        self,
        state: tuple[int, Scene | None],
        scene: Scene,
        routes: tuple[Route | None, ...] | None = None,
    ) -> tuple[int, Scene | None]:
        assert (routes is not None) == (self.name == "told")
        return state[0] + 1, scene


@pytest.mark.parametrize("name", ["told", "untold"])
def test_a_predictor_with_a_memory_of_its_own_observes_every_frame(
    name: str, traffic: Traffic
) -> None:
    predictor: Predictor = Counting()  # type: ignore[assignment]
    predictor.name = name  # type: ignore[misc]
    state = recalled(Adviser(predictor, "route" if name == "told" else "inferred"), *traffic)
    assert state.memory[0] == 11


def test_one_that_adapts_learns_from_every_frame(traffic: Traffic) -> None:
    (predictor,) = load_predictors(("hatn",), None, "mekf", True, frozenset())
    adviser = Adviser(predictor)
    road, frames = traffic
    one, whole = recalled(adviser, road, frames), observed(adviser, road, frames)
    said, meant = (foresee(adviser, state, frames[-1].scene).xy_m for state in (one, whole))
    assert np.array_equal(said, meant)
