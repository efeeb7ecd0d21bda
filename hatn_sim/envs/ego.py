"""How the ego comes on the road: one more vehicle, or one of those that come anyhow."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, Frame, Kind, Simulator
from hatn_sim.envs.driving import warmed_up
from hatn_sim.envs.errors import EgoError, OptionError
from hatn_sim.errors import nearest
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

SPAWNED: Final = "ego"
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
    if ego == "spawned":
        ego_id = SPAWNED
        _spawn(simulator, frame, last, random)
    # Those who are there already have missed their approach.
    before = frozenset(frame.scene.ids)
    known = set(before)
    most = None if isinstance(simulator, SumoReplay) else round(LONGEST_WAIT_S / DT_S)
    waited = 0
    while True:
        ids = last[-1].scene.ids
        here = _newcomers(last[-1], before) if ego_id is None else (ego_id,) * (ego_id in ids)
        if here:
            return here[0], list(last)
        if last[-1].done or waited == most:
            raise _never(simulator, ego_id, last[-1].scene.time_s, known)
        last.append(simulator.step())
        known.update(last[-1].scene.ids)
        waited += 1


def _newcomers(frame: Frame, seen: frozenset[str]) -> tuple[str, ...]:
    """Vehicles that were not there when the warm-up was over, in the order of the scene."""
    kinds = frame.scene.kind.tolist()
    return tuple(
        name
        for name, kind in zip(frame.scene.ids, kinds, strict=True)
        if name not in seen and kind in DRIVEN_KINDS
    )


def _spawn(
    simulator: Simulator, frame: Frame, last: deque[Frame], random: np.random.Generator
) -> None:
    if not isinstance(simulator, SumoSimulator):
        if SPAWNED not in frame.scene.ids:
            raise OptionError(
                f"ego: {simulator.name} begins without a vehicle of its own; choose 'taken_over'"
            )
        return
    if SPAWNED in frame.scene.ids:
        raise OptionError(
            f"ego: {simulator.name} has a vehicle {SPAWNED!r} of its own; choose ego='taken_over', "
            f"ego_id={SPAWNED!r}"
        )
    # It takes the way of somebody who is there: the scene's own demand says who goes where.
    while not (models := _newcomers(last[-1], frozenset())):
        if last[-1].done:
            raise EgoError(f"{simulator.name}: nobody is on the road whose way the ego could take")
        last.append(simulator.step())
    simulator.spawn(SPAWNED, models[int(random.integers(len(models)))])


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


def _never(simulator: Simulator, ego_id: str | None, time_s: float, known: set[str]) -> EgoError:
    who, hint = "anybody new", ""
    if ego_id is not None:
        who, hint = repr(ego_id), nearest(ego_id, known)
    return EgoError(f"{simulator.name}: until {time_s:.1f} s, {who} did not come on the road{hint}")
