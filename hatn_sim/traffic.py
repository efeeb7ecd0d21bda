"""A scene's settings -> the simulator that yields its frames. The one way in."""

from __future__ import annotations

from typing import Any

from hatn_sim.config import Scenario
from hatn_sim.datatypes import Frame, Simulator
from hatn_sim.errors import InputError
from hatn_sim.resources import scenarios_dir


def open_traffic(scenario: Scenario, window_delay_ms: float | None = None) -> Simulator:
    """The simulator of a scene, not yet reset; to be closed after use.

    With `window_delay_ms` in SUMO's window, at so many milliseconds for each second of the scene.
    Raises InputError where the scene's files are at fault, or where what it needs is missing.
    """
    if window_delay_ms is not None and (scenario.highway or scenario.recorded) is not None:
        raise InputError(
            f"{scenario.name}: --gui opens SUMO's window, which shows scenes of SUMO alone; "
            "leave it out"
        )
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

    if window_delay_ms is None:
        return SumoSimulator(scenario)
    from hatn_sim.simulators.sumo_config import VIEW_FILE, read_sumocfg
    from hatn_sim.simulators.sumo_window import window_options

    words = window_options(window_delay_ms)
    if "gui-settings-file" not in read_sumocfg(scenario.config_path):
        words += "--gui-settings-file", str(scenarios_dir() / VIEW_FILE)
    return SumoSimulator(scenario, words)


def found_out(simulator: Simulator, first: Frame | None = None) -> dict[str, Any]:
    """What recorded traffic, once its first frame is there, says of itself in `run.json`.

    That is what ids name before their first colon, and doubts about its map, see `Recording`; and
    of the first frame, that the road has signals of which nothing is known.
    """
    from hatn_sim.simulators.recorded import RecordedSimulator
    from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

    if not isinstance(simulator, RecordedSimulator | SumoReplay):
        return {"ids_by": ""}
    doubts = list(simulator.recording.doubts)
    said: dict[str, Any] = {"ids_by": simulator.recording.ids_by}
    said |= {"doubts": doubts} if doubts else {}
    if first is not None and not len(first.scene.signal_closed):
        has_signals = any(lane.signals for lane in simulator.road.lanes.values())
        said |= {"signals": "unknown"} if has_signals else {}
    return said
