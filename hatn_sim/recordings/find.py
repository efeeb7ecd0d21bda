"""Recorded tracks in any of the formats that are known -> a recording."""

from __future__ import annotations

from hatn_sim.config import RecordedSource
from hatn_sim.datatypes import Recording
from hatn_sim.errors import InputError

_FCD = (".xml", ".xml.gz", ".parquet")


def open_recording(name: str, source: RecordedSource) -> Recording:
    """The recording of a scene called `name`.

    A folder with a run.json is the log of a run, *.csv are tracks in INTERACTION format, *.xml,
    *.xml.gz and *.parquet are SUMO's floating car data.

    Raises InputError for anything else, and where the files are at fault.
    """
    first = source.tracks[0]
    if (first / "run.json").is_file():
        from hatn_sim.recordings.run_log import RunRecording

        return RunRecording(first)
    names = [path.name.lower() for path in source.tracks]
    if all(other.endswith(".csv") for other in names):
        from hatn_sim.recordings.interaction.recording import InteractionRecording

        return InteractionRecording(name, source)
    if all(other.endswith(_FCD) for other in names):
        from hatn_sim.recordings.fcd.recording import FcdRecording

        return FcdRecording(name, source)
    what = "a folder that is not of a run" if first.is_dir() else "files of other or mixed names"
    raise InputError(
        f"{first}: expected tracks as *.csv (INTERACTION format), as *.xml, *.xml.gz or *.parquet "
        f"(SUMO's FCD output), or the folder of a run, found {what}; give files of one format"
    )
