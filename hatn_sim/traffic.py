"""A scene's settings -> the simulator that yields its frames. The one way in."""

from __future__ import annotations

from typing import Any

from hatn_sim.config import Scenario
from hatn_sim.datatypes import Simulator


def open_traffic(scenario: Scenario) -> Simulator:
    """The simulator of a scene, not yet reset; to be closed after use.

    Raises InputError where the scene's files are at fault, or where what it needs is missing.
    """
    if scenario.highway is not None:
        from hatn_sim.simulators.highway import HighwaySimulator

        return HighwaySimulator(scenario)
    if scenario.recorded is not None:
        from hatn_sim.recordings.find import open_recording
        from hatn_sim.simulators.recorded import RecordedSimulator

        recording = open_recording(scenario.name, scenario.recorded)
        if scenario.recorded.replay is None:
            return RecordedSimulator(recording)
        from hatn_sim.simulators.sumo_replay.simulator import open_replay

        replay = scenario.recorded.replay
        return open_replay(recording, replay.net_path, replay.take_over, replay.react_from_s)
    from hatn_sim.simulators.sumo import SumoSimulator

    return SumoSimulator(scenario)


def found_out(simulator: Simulator) -> dict[str, Any]:
    """What recorded traffic, once its first frame is there, says of itself in `run.json`: what ids
    name before their first colon, and doubts about its map; see `Recording`."""
    from hatn_sim.simulators.recorded import RecordedSimulator
    from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

    if not isinstance(simulator, RecordedSimulator | SumoReplay):
        return {"ids_by": ""}
    doubts = list(simulator.recording.doubts)
    return {"ids_by": simulator.recording.ids_by} | ({"doubts": doubts} if doubts else {})
