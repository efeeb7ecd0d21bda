"""Actions, driven: frames from a simulator, several at a time where it gives them so."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from gymnasium.spaces import Box

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, Command, Frame, Simulator
from hatn_sim.envs.action import (
    Slots,
    acceleration_command,
    chosen_slot,
    highway_command,
    numbers_of,
    tracking_command,
)
from hatn_sim.envs.episode import Episode
from hatn_sim.envs.mind import slot_profile
from hatn_sim.envs.options import EnvOptions
from hatn_sim.simulators.sumo import SumoSimulator

Plan = Callable[[int, float], Command | None]
"""Number of a frame, speed of the ego before it in m/s -> its command; None: none."""


def warmed_up(simulator: Simulator, frame: Frame, frames: int) -> list[Frame]:
    """Lets so many frames pass after `frame`, or until the scene is done: the last of them all."""
    if not frames or frame.done:
        return [frame]
    if isinstance(simulator, SumoSimulator):
        later = simulator.drive_on([()] * frames, kept=HISTORY_FRAMES)()
        return [frame, *later][-HISTORY_FRAMES:]
    seen = [frame]
    for _ in range(frames):
        if seen[-1].done:
            break
        seen = [*seen[1 - HISTORY_FRAMES :], simulator.step()]
    return seen


def plan_of(episode: Episode, action: Any, space: Any, options: EnvOptions) -> Plan:
    """How an action of this space is driven. Raises ActionError where it is none of it."""
    ego_id = episode.ego_id
    if isinstance(space, Slots):
        slot = chosen_slot(action, space.admissible, options.masked_action)
        mind, thought, row = episode.mind, episode.thought, episode.row
        assert mind is not None and thought is not None and row is not None
        speeds = slot_profile(mind, thought.sight, episode.frame.scene, row, slot)
        if not speeds:  # on no line nobody knows the way: the simulator's driver does
            return lambda _k, _speed_mps: None
        return lambda k, speed_mps: tracking_command(ego_id, speed_mps, speeds, k)
    assert isinstance(space, Box)
    numbers = numbers_of(action, space)
    is_highway = options.action_form == "highway"
    command = (highway_command if is_highway else acceleration_command)(ego_id, numbers)
    return lambda _k, _speed_mps: command


def driven(
    simulator: Simulator, before: Frame, plans: Mapping[str, Plan], frames: int
) -> Callable[[], Iterable[Frame]]:
    """Has egos, by their ids, driven for so many frames after `before`; the result waits for them.

    Who takes fewer of them than there are cannot know how far the simulator has come.
    """
    if not isinstance(simulator, SumoSimulator):
        return partial(_one_by_one, simulator, before, plans, frames)
    # It drives on by itself: what it is told is obeyed, so the speeds to come are known.
    speeds_mps = _speeds_mps(before, plans)
    commands: list[tuple[Command, ...]] = []
    for k in range(frames):
        commands.append(_commands(plans, k, speeds_mps))
        for command in commands[-1]:
            faster_mps = speeds_mps[command.ego_id] + command.acceleration_mps2 * DT_S
            speeds_mps[command.ego_id] = max(faster_mps, 0.0)
    return simulator.drive_on(commands)


def _one_by_one(
    simulator: Simulator, before: Frame, plans: Mapping[str, Plan], frames: int
) -> Iterator[Frame]:
    frame = before
    for k in range(frames):
        frame = simulator.step(_commands(plans, k, _speeds_mps(frame, plans)))
        yield frame


def _commands(
    plans: Mapping[str, Plan], k: int, speeds_mps: Mapping[str, float]
) -> tuple[Command, ...]:
    found = [plans[ego_id](k, speed_mps) for ego_id, speed_mps in speeds_mps.items()]
    return tuple(command for command in found if command is not None)


def _speeds_mps(frame: Frame, ids: Iterable[str]) -> dict[str, float]:
    """Of those that are still there."""
    scene = frame.scene
    return {
        name: float(scene.speed_mps[scene.ids.index(name)]) for name in ids if name in scene.ids
    }
