"""What is asked of an agent, each point on real traffic."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hatn_sim.conformance.points import BrokenError, Point, Told, check_methods
from hatn_sim.conformance.scenes import (
    Footage,
    alone,
    copy_of,
    differs_in,
    fresh,
    nobody,
    turned_round,
)
from hatn_sim.datatypes import Advice, Agent, Command, Frame, Guided, Predictor, Scene
from hatn_sim.loop import Adviser, begin, check_command, guided, tick
from hatn_sim.road import Road

METHODS: Final = {"init": ("road",), "step": ("state", "ego_id", "scene", "advice")}
SAME_MPS2: Final = 1e-3


def check_agent(
    make: Callable[[], Agent], footage: Footage, advisers: Sequence[Predictor]
) -> Iterator[Point]:
    """Every point in turn, of an agent that `make` makes, advised by each of `advisers`."""
    agent, frames, told = make(), footage.frames, Told()
    point, plain = told.point, advisers[0]
    yield told.first("methods", lambda: check_methods(agent, METHODS))
    for adviser in advisers:
        yield point(
            f"commands, advised by {adviser.name}",
            lambda adviser=adviser: _check_commands(agent, footage, adviser),
        )
    # From here on what the advice is does not matter.
    run = _runner(agent, footage, plain)
    yield point("its vehicle is not there", lambda: _check_absent(agent, footage, plain))
    single = _framed(frames, alone(footage.scenes, footage.longest))
    yield point("its vehicle alone", lambda: _ran(run(single)))
    yield point("the same again", lambda: _same(run(frames), run(frames), "the same agent"))
    yield point(
        "the same of a new one",
        lambda: _same(run(frames), _runner(make(), footage, plain)(frames), "a new instance"),
    )
    yield point("memory is handed out", lambda: _check_memory(agent, footage, plain))
    yield point("input is left as it is", lambda: _check_input(agent, footage, plain))
    turned = _framed(frames, turned_round(footage.scenes))
    yield point(
        "the order of vehicles is without effect",
        lambda: _same(run(frames), run(turned), "an agent that sees them in the opposite order"),
    )
    yield point("time", lambda: _time(agent, footage, plain))


Commands = list[Command | None]


@dataclass(frozen=True, eq=False)
class _Advised:
    """Frames with their advice; whoever drives them is on the same road, as in a run."""

    road: Road
    frames: Sequence[Frame]
    advice: Sequence[Advice]


def _advise(footage: Footage, frames: Sequence[Frame], predictor: Predictor) -> _Advised:
    road = fresh(footage.road)
    adviser = Adviser(predictor)
    state, out = begin(adviser, road), list[Advice]()
    for frame in frames:
        state, advice = tick(adviser, state, frame)
        out.append(advice)
    return _Advised(road, frames, out)


def _framed(frames: Sequence[Frame], scenes: Sequence[Scene]) -> list[Frame]:
    """Frames of other scenes; nobody's route is known in them but the ego's, which asks by id."""
    out = list[Frame]()
    for frame, scene in zip(frames, scenes, strict=False):
        routes = dict(zip(frame.scene.ids, frame.truth.routes, strict=True))
        truth = type(frame.truth)(tuple(routes[name] for name in scene.ids))
        out.append(Frame(scene, truth, frame.done))
    return out


def _copied(frames: Sequence[Frame]) -> list[Frame]:
    """What is written into these is another point's affair."""
    return _framed(frames, [copy_of(frame.scene) for frame in frames])


def _drive(
    agent: Agent, footage: Footage, advised: _Advised
) -> Iterator[tuple[Any, Any, Command | None]]:
    """The memory as it was given, as it came out, and the command, of every frame."""
    ego_id, state = footage.longest, agent.init(advised.road)
    for frame, shown in zip(advised.frames, advised.advice, strict=True):
        told = guided(agent, state, ego_id, frame)
        answer: Any = agent.step(told, ego_id, frame.scene, shown)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise BrokenError(
                "step to return (state, command)", type(answer).__name__, "return both"
            )
        state, command = answer
        if command is not None:
            check_command(command, ego_id, frame.scene)
        yield told, state, command


def _runner(
    agent: Agent, footage: Footage, predictor: Predictor
) -> Callable[[Sequence[Frame]], Commands]:
    def run(frames: Sequence[Frame]) -> Commands:
        frames = _copied(frames)
        advised = _advise(footage, frames, predictor)
        return [command for _, _, command in _drive(agent, footage, advised)]

    return run


def _check_commands(agent: Agent, footage: Footage, predictor: Predictor) -> str:
    commands = _runner(agent, footage, predictor)(footage.frames)
    given = [command.acceleration_mps2 for command in commands if command is not None]
    if not given:
        return "leaves its vehicle to the simulator"
    return f"{len(given)} of {len(commands)} frames, {min(given):.1f} to {max(given):.1f} m/s2"


def _ran(commands: Commands) -> str:
    return f"{len(commands)} frames"


def _check_absent(agent: Agent, footage: Footage, predictor: Predictor) -> None:
    frames = _framed(footage.frames, nobody(footage.scenes))
    for frame, command in zip(frames, _runner(agent, footage, predictor)(frames), strict=True):
        if command is not None and not frame.scene.ids:
            raise BrokenError(
                "no command while the vehicle is not there", "one", "return (state, None) then"
            )


def _same(one: Commands, two: Commands, who: str) -> None:
    for frame, (first, second) in enumerate(zip(one, two, strict=True)):
        values = [np.nan if c is None else c.acceleration_mps2 for c in (first, second)]
        if not np.allclose(*values, rtol=0.0, atol=SAME_MPS2, equal_nan=True):
            raise BrokenError(
                f"{who} to command the same of the same scenes",
                f"{values[1]:.3f} after {values[0]:.3f} m/s2 at frame {frame}",
                "seed what is random in init, keep memory in the state, look vehicles up by id",
            )


def _check_memory(agent: Agent, footage: Footage, predictor: Predictor) -> None:
    ego_id = footage.longest
    frames = _copied(footage.frames)
    advised = _advise(footage, frames, predictor)
    done = list(_drive(agent, footage, advised))
    for frame in (1, len(frames) // 2):
        told, _, command = done[frame]
        _, again = agent.step(told, ego_id, frames[frame].scene, advised.advice[frame])
        _same([command], [again], f"the memory of frame {frame}, asked later,")


def _check_input(agent: Agent, footage: Footage, predictor: Predictor) -> None:
    given = _copied(footage.frames)
    for _ in _drive(agent, footage, _advise(footage, given, predictor)):
        pass
    for frame, scene in zip(given, footage.scenes, strict=True):
        part = differs_in(frame.scene, scene)
        if part is not None:
            raise BrokenError("scenes left as they were", f"another {part}", "copy before writing")


def _time(agent: Agent, footage: Footage, predictor: Predictor) -> str:
    frames = _copied(footage.frames)
    advised = _advise(footage, frames, predictor)
    taken_s, began = list[float](), time.perf_counter()
    for _ in _drive(agent, footage, advised):
        taken_s.append(time.perf_counter() - began)
        began = time.perf_counter()
    asks = "is told its way" if isinstance(agent, Guided) else "is not told its way"
    return f"{1e3 * float(np.median(taken_s)):.1f} ms a step; {asks}"
