"""Frames from a simulator, several at a time where it gives them so."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, Command, Frame, Simulator
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


def driven(
    simulator: Simulator, ego_id: str, before: Frame, plan: Plan, frames: int
) -> Callable[[], Iterable[Frame]]:
    """Has the ego driven for so many frames after `before`; what is given back waits for them.

    Who takes fewer of them than there are cannot know how far the simulator has come.
    """
    if not isinstance(simulator, SumoSimulator):
        return partial(_one_by_one, simulator, ego_id, before, plan, frames)
    # It drives on by itself: what it is told is obeyed, so the speeds to come are known.
    speed_mps = _speed_mps(before, ego_id)
    commands: list[tuple[Command, ...]] = []
    for k in range(frames):
        command = plan(k, speed_mps)
        commands.append(() if command is None else (command,))
        if command is not None:
            speed_mps = max(speed_mps + command.acceleration_mps2 * DT_S, 0.0)
    return simulator.drive_on(commands)


def _one_by_one(
    simulator: Simulator, ego_id: str, before: Frame, plan: Plan, frames: int
) -> Iterator[Frame]:
    frame = before
    for k in range(frames):
        command = plan(k, _speed_mps(frame, ego_id))
        frame = simulator.step(() if command is None else (command,))
        yield frame


def _speed_mps(frame: Frame, ego_id: str) -> float:
    return float(frame.scene.speed_mps[frame.scene.ids.index(ego_id)])
