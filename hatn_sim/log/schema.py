"""The one schema of a run's log: names of files, columns of tables."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import quote, unquote

SCHEMA_VERSION = 3
PART_FRAMES = 300
"""A Parquet part holds this many frames: a killed run loses at most 30 s of its tables."""

RUN_FILE = "run.json"
LINE_COUNTS = "line_counts"
"""Key of `run.json` from a run's end on: how many lines each of its files of lines has."""
TIMING_FILE = "timing.json"
SUGGESTIONS_FILE = "suggestions.jsonl"
ALERTS_FILE = "alerts.jsonl"
COUNTERFACTUALS_FILE = "counterfactuals.jsonl"
ASSISTANCE_SCHEMA_FILE = "assistance.schema.json"
"""Beside this module: the JSON Schema of the lines of suggestions and alerts ..."""
COUNTERFACTUALS_SCHEMA_FILE = "counterfactuals.schema.json"
"""... and that of counterfactuals."""
EVENTS_FILE = "truth/events.jsonl"
ROUTES_FILE = "truth/routes.jsonl"
TRACKS_FOLDER = "tracks"
FRAMES_FOLDER = "frames"
TRUTH_FOLDER = "truth"
PREDICTIONS_FOLDER = "predictions"
SCORES_FILE = "scores.json"

EVENTS = {
    "collision": "collisions",
    "emergency_braking": "emergency_braking",
    "departed": "departed",
    "arrived": "arrived",
    "teleported": "teleported",
}
"""Type of an event in `events.jsonl` -> the field of `Truth` that it comes from."""

ID = "id"
"""The type of a column of vehicle ids: stored as strings in a dictionary."""


@dataclass(frozen=True)
class Column:
    """A column of a table; `dtype` is NumPy's name or `ID`, `ragged` means a list in each row."""

    name: str
    dtype: str
    ragged: bool = False


FRAMES = (
    Column("frame", "int32"),
    Column("time_s", "float64"),
    Column("done", "bool"),
    Column("signal_closed", "bool", ragged=True),
)
"""One row per frame."""

TRACKS = (
    Column("frame", "int32"),
    Column("time_s", "float64"),
    Column("id", ID),
    Column("x_m", "float64"),
    Column("y_m", "float64"),
    Column("yaw_rad", "float64"),
    Column("speed_mps", "float64"),
    Column("length_m", "float64"),
    Column("width_m", "float64"),
    Column("kind", "int8"),
    Column("red", "uint8"),
    Column("green", "uint8"),
    Column("blue", "uint8"),
    Column("blinker", "int8"),
)
"""One row per vehicle and frame, in the order of `Scene.ids`."""

TRUTH = (
    Column("frame", "int32"),
    Column("id", ID),
    Column("route", "int32"),  # line of routes.jsonl, counted from 0; -1: not on a lane
)
"""One row per vehicle and frame, in the order of `Scene.ids`."""

SLOTS = (
    Column("slot_id", ID, ragged=True),  # M, the vehicle behind each slot; the first is the ego
    Column("slot_probability", "float32", ragged=True),
    Column("slot_in_focus", "bool", ragged=True),
    Column("ego_to_conflict_m", "float64", ragged=True),
    Column("rear_to_conflict_m", "float64", ragged=True),
    Column("conflict_x_m", "float64", ragged=True),
    Column("conflict_y_m", "float64", ragged=True),
    Column("conflict_type", "int8", ragged=True),
    Column("slot_length_m", "float32", ragged=True),  # between its two boundaries, now
)
"""The slots of the vehicle's own semantic graph, one list entry per node; probabilities only
where the predictor gives them."""

PREDICTIONS = (
    Column("frame", "int32"),
    Column("id", ID),
    Column("fallback", "bool"),
    Column("adapted", "bool"),
    Column("on_line", "bool"),
    Column("line_probability", "float32"),  # 0 where not on a line
    Column("mode_probability", "float32", ragged=True),  # K
    # K * F * 2, relative to the vehicle's centre in this frame: float32 is then exact to microns
    # however far from the origin the scene is.
    Column("offset_xy_m", "float32", ragged=True),
    Column("goal_weight", "float32", ragged=True),  # C
    Column("goal_mean_m", "float32", ragged=True),
    Column("goal_std_m", "float32", ragged=True),
    Column("has_conflict", "bool"),
    *SLOTS,
)
"""One row per vehicle and predicted frame, in the order of `Scene.ids`."""

SLOT_COLUMNS = tuple(column.name for column in SLOTS)


def part_name(part: int) -> str:
    return f"part-{part:05d}.parquet"


def predictor_folder(predictor: str) -> str:
    """Folder of a predictor's table; names such as `module:Class` are made safe, reversibly."""
    return f"{PREDICTIONS_FOLDER}/{quote(predictor, safe='')}"


def predictor_name(folder: str) -> str:
    """The inverse of `predictor_folder`, from the folder's own name."""
    return unquote(folder)
