"""What is read from the log of a run: its tables as arrays, and what happened at a frame."""

from __future__ import annotations

from dataclasses import dataclass

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Suggestion


@dataclass(frozen=True, eq=False)
class TrackTable:
    """All of the run's scenes, one row per vehicle and frame, by frame."""

    frame: IntArray  # [R]
    vehicle: IntArray  # [R] index into Run.ids
    xy_m: FloatArray  # [R, 2]
    yaw_rad: FloatArray  # [R]
    speed_mps: FloatArray  # [R]
    size_m: FloatArray  # [R, 2]
    kind: IntArray  # [R]
    colour: IntArray  # [R, 3]
    blinker: IntArray  # [R]


@dataclass(frozen=True, eq=False)
class PredictionTable:
    """What one predictor said, one row per vehicle and frame, by frame; letters as in datatypes.

    Shorter lists are padded: modes with probability 0, components and slots as their masks say.
    """

    predictor: str
    frame: IntArray  # [R]
    vehicle: IntArray  # [R] index into Run.ids
    fallback: BoolArray  # [R]
    adapted: BoolArray  # [R]
    on_line: BoolArray  # [R]
    line_probability: FloatArray  # [R] 0 where not on a line
    mode_probability: FloatArray  # [R, K]
    xy_m: FloatArray  # [R, K, F, 2]
    goal_mask: BoolArray  # [R, C]
    goal_weight: FloatArray  # [R, C]
    goal_mean_m: FloatArray  # [R, C]
    goal_std_m: FloatArray  # [R, C]
    has_conflict: BoolArray  # [R] the vehicle's own graph has an active conflict
    slot_mask: BoolArray  # [R, M] all False: no graph
    slot_vehicle: IntArray  # [R, M] vehicle behind each slot, the ego's own first; -1 where masked
    slot_in_focus: BoolArray  # [R, M]
    has_slot_probability: BoolArray  # [R]
    slot_probability: FloatArray  # [R, M]
    ego_to_conflict_m: FloatArray  # [R, M]
    rear_to_conflict_m: FloatArray  # [R, M]
    conflict_xy_m: FloatArray  # [R, M, 2]
    conflict_type: IntArray  # [R, M]
    slot_length_m: FloatArray  # [R, M] from the vehicle behind the slot to its front boundary


@dataclass(frozen=True)
class Event:
    """Something that only the simulator knows: a key of `schema.EVENTS`, and whom it befell."""

    frame: int
    time_s: float
    type: str
    ids: tuple[str, ...]


@dataclass(frozen=True)
class SuggestionChange:
    """From this frame on the ego is advised so; None: no longer advised."""

    frame: int
    ego_id: str
    suggestion: Suggestion | None
