"""A scene's settings -> the simulator that yields its frames. The one way in."""

from __future__ import annotations

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


def ids_by(simulator: Simulator) -> str:
    """What ids name before their first colon; see `Recording`."""
    from hatn_sim.simulators.recorded import RecordedSimulator
    from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

    recorded = isinstance(simulator, RecordedSimulator | SumoReplay)
    return simulator.recording.ids_by if recorded else ""
