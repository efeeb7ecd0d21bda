"""How the ego comes on the road: one more vehicle, or one of those that come anyhow."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, Frame, Kind, Route, Simulator
from hatn_sim.envs.driving import warmed_up
from hatn_sim.envs.errors import EgoError, OptionError
from hatn_sim.errors import nearest
from hatn_sim.simulators.highway_scene import EGO, ego_name
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

SPAWNED: Final = EGO
"""What a spawned ego is called; highway-env's own is, too."""
LONGEST_WAIT_S: Final = 600.0
"""An ego of simulated traffic that has not come by then never comes."""
LEAST_STAY_S: Final = 3.0
"""Recorded vehicles seen for less are not drawn as the ego."""
DRIVEN_KINDS: Final = (Kind.CAR, Kind.VAN, Kind.LORRY, Kind.BUS, Kind.MOTORCYCLE)


def begin_episode(
    simulator: Simulator,
    seed: int,
    ego: str,
    ego_id: str | None,
    warm_up_frames: int,
    random: np.random.Generator,
) -> tuple[str, list[Frame]]:
    """The id of the ego, and the last frames up to the first that it is in: what history there is.

    `ego` is "spawned" or "taken_over". Raises EgoError where it never comes, OptionError where no
    ego can come in that way; else as `simulator.reset`.
    """
    if isinstance(simulator, SumoReplay):
        ego_id = _cast(simulator, seed, ego_id, random)
    last = deque(warmed_up(simulator, simulator.reset(seed), warm_up_frames), HISTORY_FRAMES)
    frame = last[-1]
    if frame.done and warm_up_frames:
        raise EgoError(
            f"{simulator.name}: it was over at {frame.scene.time_s:.1f} s, within the warm-up of "
            f"{warm_up_frames * DT_S:g} s; choose a shorter warm_up_s"
        )
    if ego == "spawned":
        ego_id = SPAWNED
        _spawn(simulator, (SPAWNED,), last, random)
    # Those who are there already have missed their approach.
    before = frozenset(frame.scene.ids)

    def come(now: Frame) -> Sequence[str]:
        if ego_id is None:
            return _newcomers(now, before)
        return (ego_id,) * (ego_id in now.scene.ids)

    return _wait(simulator, last, before, come, ego_id)[0], list(last)


def begin_together(
    simulator: Simulator, seed: int, egos: int, warm_up_frames: int, random: np.random.Generator
) -> tuple[tuple[str, ...], list[Frame]]:
    """The ids of several spawned egos, and the last frames up to the first that all are in.

    They come in by different ways as far as there are such. Until all are there, those who are
    drive as the simulator has them. Raises as `begin_episode`.
    """
    last = deque(warmed_up(simulator, simulator.reset(seed), warm_up_frames), HISTORY_FRAMES)
    names = tuple(map(ego_name, range(egos)))
    before = frozenset(last[-1].scene.ids)
    _spawn(simulator, names, last, random)
    came: set[str] = set()

    def come(now: Frame) -> Sequence[str]:
        here = set(names) & set(now.scene.ids)
        if gone := sorted(came - here):
            raise EgoError(
                f"{simulator.name}: {gone[0]!r} had left before all {egos} egos were there; "
                "expected a scene with room for them, choose fewer egos or less traffic"
            )
        came.update(here)
        return names if len(here) == egos else ()

    _wait(simulator, last, before, come, names[-1])
    return names, list(last)


def _wait(
    simulator: Simulator,
    last: deque[Frame],
    before: frozenset[str],
    come: Callable[[Frame], Sequence[str]],
    ego_id: str | None,
) -> Sequence[str]:
    """Goes on until somebody has `come`, which frames are added to `last`; who that is."""
    known = set(before)
    most = None if isinstance(simulator, SumoReplay) else round(LONGEST_WAIT_S / DT_S)
    waited = 0
    while not (here := come(last[-1])):
        if last[-1].done or waited == most:
            raise _never(simulator, ego_id, last[-1], waited * DT_S, known)
        last.append(simulator.step())
        known.update(last[-1].scene.ids)
        waited += 1
    return here


def _newcomers(frame: Frame, seen: frozenset[str]) -> tuple[str, ...]:
    """Vehicles that were not there when the warm-up was over, in the order of the scene."""
    kinds = frame.scene.kind.tolist()
    return tuple(
        name
        for name, kind in zip(frame.scene.ids, kinds, strict=True)
        if name not in seen and kind in DRIVEN_KINDS
    )


def _spawn(
    simulator: Simulator, names: Sequence[str], last: deque[Frame], random: np.random.Generator
) -> None:
    ids = last[-1].scene.ids
    if not isinstance(simulator, SumoSimulator):
        if missing := [name for name in names if name not in ids]:
            raise OptionError(
                f"ego: {simulator.name} begins without a vehicle {missing[0]!r} of its own; choose "
                "'taken_over', or set how many its controlled_vehicles are"
            )
        return
    if taken := [name for name in names if name in ids]:
        raise OptionError(
            f"ego: {simulator.name} has a vehicle {taken[0]!r} of its own; choose "
            f"ego='taken_over', ego_id={taken[0]!r}"
        )
    # They take the ways of those who are there: the scene's own demand says who goes where.
    while not (models := _newcomers(last[-1], frozenset())):
        if last[-1].done:
            raise EgoError(f"{simulator.name}: nobody is on the road whose way the ego could take")
        last.append(simulator.step())
    routes = dict(zip(last[-1].scene.ids, last[-1].truth.routes, strict=True))
    left = models
    for name in names:
        model = left[int(random.integers(len(left)))]
        simulator.spawn(name, model)
        left = tuple(one for one in left if _entry(routes[one]) != _entry(routes[model])) or models


def _entry(route: Route | None) -> str:
    return route[0] if route else ""


def _cast(simulator: SumoReplay, seed: int, ego_id: str | None, random: np.random.Generator) -> str:
    """Tells the replay whom to take over: whoever is named, or one by lot."""
    if ego_id is None:
        if not simulator.drivable(0.0):
            simulator.take_over({})
            simulator.reset(seed)  # reads the recording
        among = simulator.drivable(LEAST_STAY_S)
        if not among:
            raise EgoError(
                f"{simulator.name}: nobody was recorded who could be taken over: expected a "
                f"vehicle seen for {LEAST_STAY_S:g} s, with a way in the net"
            )
        ego_id = among[int(random.integers(len(among)))]
    simulator.take_over({ego_id: None})
    return ego_id


def _never(
    simulator: Simulator, ego_id: str | None, last: Frame, waited_s: float, known: set[str]
) -> EgoError:
    who, hint = "anybody new", ""
    if ego_id is not None:
        who = repr(ego_id)
        hint = "" if ego_id == SPAWNED else nearest(ego_id, known)
    why = "where the scene is over" if last.done else "where waiting ends"
    return EgoError(
        f"{simulator.name}: {who} did not come on the road in the {waited_s:g} s from the end of "
        f"the warm-up to {last.scene.time_s:.1f} s, {why}{hint or '; choose a shorter warm_up_s'}"
    )
