"""The log of a run: a folder that the run loop writes and everything else reads.

| file | holds |
|---|---|
| `run.json` | schema version, what the run was made of, whether it finished, counts of lines |
| `timing.json` | the wall clock; all else is byte for byte the same between two equal runs |
| `suggestions.jsonl`, `alerts.jsonl` | one line per change, written as it happens |
| `counterfactuals.jsonl` | what branches of the run said of a sample of these; if asked for |
| `tracks/`, `frames/` | all that a camera saw: `Scene`, in float64 |
| `truth/` | what only the simulator knows; closed to predictors |
| `predictions/NAME/` | what each predictor said of every vehicle |
| `road.json.gz`, `line_choice.json` | the lanes; how lines were chosen, if not as everywhere |
| `scores.json` | the scores, once they have been computed |

Tables are Parquet parts of `PART_FRAMES` frames each, so a killed run loses at most the last part.
"""

from hatn_sim.log.gaps import Gap, Part
from hatn_sim.log.reader import Run, read_run
from hatn_sim.log.schema import PART_FRAMES, SCHEMA_VERSION
from hatn_sim.log.tables import Event, PredictionTable, SuggestionChange, TrackTable
from hatn_sim.log.writer import RunWriter

__all__ = [
    "PART_FRAMES",
    "SCHEMA_VERSION",
    "Event",
    "Gap",
    "Part",
    "PredictionTable",
    "Run",
    "RunWriter",
    "SuggestionChange",
    "TrackTable",
    "read_run",
]
