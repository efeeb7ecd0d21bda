"""The folder of a run -> its frames, predictions and changes; a killed run is read as well."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hatn_sim.datatypes import (
    CASE_HISTORY_FRAMES,
    HISTORY_FRAMES,
    HORIZON_FRAMES,
    Alert,
    BoolArray,
    FloatArray,
    Frame,
    IntArray,
    Lane,
    Route,
    Scene,
    Truth,
)
from hatn_sim.errors import InputError
from hatn_sim.labels import Trajectories, trajectories_from_rows
from hatn_sim.log import schema
from hatn_sim.log.gaps import NO_LINES, Gap, Part, find_gaps, noted_lines
from hatn_sim.log.head_file import read_head
from hatn_sim.log.lines_file import (
    change_of,
    each_as,
    edge_of,
    event_of,
    read_lines,
    route_of,
)
from hatn_sim.log.parts import check_part, padded, part_count, read_parts
from hatn_sim.log.road_file import ROAD_FILE, read_road
from hatn_sim.log.tables import Event, PredictionTable, SuggestionChange, TrackTable

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Run:
    """The log of a run, read when asked for. Every property may raise `InputError` (damage)."""

    path: Path
    header: Mapping[str, Any]  # run.json
    finished: bool  # False: the run was stopped or killed, and is there up to frame_count
    frame_count: int
    parts: int
    predictors: tuple[str, ...]  # the main one first
    whole: bool = True  # False: what does not count or is damaged is left out; see `read_run`
    gaps: tuple[Gap, ...] = ()  # what is left out

    @property
    def parts_left_out(self) -> frozenset[Part]:
        """Of what there is no more than a part."""
        return frozenset(gap.part for gap in self.gaps)

    @property
    def has_lines(self) -> bool:
        """The lines of vehicles can be worked out again."""
        return not self.parts_left_out & NO_LINES

    @cached_property
    def lanes(self) -> list[Lane]:
        """The road; nothing where it is left out."""
        return [] if self._is_gone(ROAD_FILE) else read_road(self.path / ROAD_FILE)

    @property
    def by_route(self) -> bool:
        """Lines came from the simulator's routes, which no camera can see: an upper bound."""
        return self.header.get("settings", {}).get("lines") == "route"

    @property
    def signals_known(self) -> bool:
        """False: the road has signals, and the recording does not say when they were closed."""
        return self.header.get("settings", {}).get("signals") != "unknown"

    @property
    def trained_on(self) -> tuple[str, ...]:
        """Scenes that the main predictor learnt from, as far as its weights tell."""
        return tuple(str(scene) for scene in self.header.get("trained_on", ()))

    @property
    def ids_by(self) -> str:
        """What ids name before their first colon: "recordings", "cases", or "" for nothing."""
        return str(self.header.get("settings", {}).get("ids_by") or "")

    @property
    def history_frames(self) -> int:
        """Frames behind a sample, now included: cases have one less than other traffic."""
        return CASE_HISTORY_FRAMES if self.ids_by == "cases" else HISTORY_FRAMES

    @cached_property
    def recording_of(self) -> IntArray:
        """[V] number of the recording or case that every vehicle of `ids` was in; else all 0."""
        numbers: dict[str, int] = {}
        names = (name.partition(":")[0] if self.ids_by else "" for name in self.ids)
        return np.array([numbers.setdefault(name, len(numbers)) for name in names], dtype=np.int64)

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Every vehicle of the run, in order of appearance."""
        ids: dict[str, None] = {}
        for part in range(self.parts):
            rows = self._part(schema.TRACKS_FOLDER, part, (schema.Column("id", schema.ID),))
            ids |= dict.fromkeys(rows["id"].tolist())
        return tuple(ids)

    @cached_property
    def tracks(self) -> TrackTable:
        rows = self._rows(schema.TRACKS_FOLDER, schema.TRACKS)
        return TrackTable(rows["frame"].astype(np.int64), rows["id"], **_scene_columns(rows))

    @cached_property
    def trajectories(self) -> Trajectories:
        tracks = self.tracks
        return trajectories_from_rows(
            self.ids, tracks.vehicle, tracks.frame, tracks.xy_m, self.frame_count
        )

    @cached_property
    def kinds(self) -> IntArray:
        """[V] Kind of every vehicle of `ids`."""
        kinds = np.zeros(len(self.ids), dtype=np.int64)
        kinds[self.tracks.vehicle] = self.tracks.kind
        return kinds

    def scenes(self) -> Iterator[Scene]:
        """The scenes exactly as they were written."""
        return (frame.scene for frame in self.frames())

    def frames(self) -> Iterator[Frame]:
        """The frames exactly as they were written, with what only the simulator knew.

        Tables are read part by part: memory is bounded, however long the run.
        """
        routes = self._each(schema.ROUTES_FILE, route_of) if self._has_routes else []
        routes.append(None)  # found by -1
        events: dict[int, list[Event]] = {}
        for event in self.events:
            events.setdefault(event.frame, []).append(event)
        for part in range(self.parts):
            yield from self._frames_of(part, routes, events)

    def _frames_of(
        self, part: int, routes: list[Route | None], events: Mapping[int, list[Event]]
    ) -> Iterator[Frame]:
        index = self._part(schema.FRAMES_FOLDER, part, schema.FRAMES)
        rows = self._part(schema.TRACKS_FOLDER, part, schema.TRACKS)
        columns, names = _scene_columns(rows), rows["id"].tolist()
        first = np.searchsorted(rows["frame"], index["frame"])
        last = np.searchsorted(rows["frame"], index["frame"], side="right")
        route_of_row = self._routes_of(part, int(last.max(initial=0)), len(routes))
        closed, closed_counts = index["signal_closed"]
        closed_ends = np.cumsum(closed_counts)
        for place, frame in enumerate(index["frame"].tolist()):
            here = slice(first[place], last[place])
            end = closed_ends[place]
            scene = Scene(
                time_s=float(index["time_s"][place]),
                ids=tuple(names[here]),
                **{name: values[here] for name, values in columns.items()},
                signal_closed=closed[end - closed_counts[place] : end],
            )
            truth = _truth(
                tuple(routes[route] for route in route_of_row[here]), events.get(frame, [])
            )
            yield Frame(scene, truth, bool(index["done"][place]))

    @property
    def _has_routes(self) -> bool:
        """Where not all has to be there, routes are read only if anything hangs on them."""
        return self.whole or (self.by_route and Part.ROUTES not in self.parts_left_out)

    def _routes_of(self, part: int, rows: int, routes: int) -> list[int]:
        """The route of the first rows of a part of `tracks`, -1: none."""
        if not self._has_routes:
            return [-1] * rows
        found = self._part(schema.TRUTH_FOLDER, part, schema.TRUTH)["route"]
        if len(found) < rows or found.max(initial=-1) >= routes - 1:
            file = f"{self.path / schema.TRUTH_FOLDER}/{schema.part_name(part)}"
            raise InputError(f"{file}: does not fit tracks/ and routes; make the run again")
        of_rows: list[int] = found.tolist()
        return of_rows

    def predicted(self, predictor: str, every_frames: int = 1) -> tuple[IntArray, IntArray]:
        """Which (vehicle, frame) a predictor has rows of; cheaper than its whole table."""
        folder = schema.predictor_folder(predictor)
        rows = self._rows(folder, schema.PREDICTIONS[:2], every_frames)
        return rows["id"], rows["frame"].astype(np.int64)

    def predictions(self, predictor: str, every_frames: int = 1) -> PredictionTable:
        """What a predictor said, at every frame or only at multiples of `every_frames`."""
        return self._predictions(predictor, range(self.parts), every_frames)

    def prediction_parts(self, predictor: str) -> Iterator[PredictionTable]:
        """The same, `PART_FRAMES` frames at a time: memory is bounded, however long the run."""
        for part in range(self.parts):
            yield self._predictions(predictor, range(part, part + 1), 1)

    def _predictions(self, predictor: str, parts: range, every_frames: int) -> PredictionTable:
        if predictor not in self.predictors:
            known = ", ".join(self.predictors) or "none"
            raise InputError(f"{self.path}: no predictions of {predictor!r}; there are: {known}")
        folder = schema.predictor_folder(predictor)
        rows = self._rows(folder, schema.PREDICTIONS, every_frames, parts)
        frame, vehicle = rows["frame"].astype(np.int64), rows["id"]
        mode_probability, _ = padded(rows["mode_probability"])
        offset, _ = padded(rows["offset_xy_m"])
        offset_xy_m = offset.reshape(len(frame), mode_probability.shape[1], HORIZON_FRAMES, 2)
        now_xy_m, _ = self.trajectories.xy_at(vehicle, frame)
        goals = {n: padded(rows[n]) for n in ("goal_weight", "goal_mean_m", "goal_std_m")}
        slot_vehicle, slot_mask = padded(rows["slot_id"], fill=-1)
        slots = {n: _as_wide(padded(rows[n])[0], slot_mask) for n in schema.SLOT_COLUMNS[1:]}
        return PredictionTable(
            predictor=predictor,
            frame=frame,
            vehicle=vehicle,
            fallback=rows["fallback"],
            adapted=rows["adapted"],
            on_line=rows["on_line"],
            line_probability=rows["line_probability"].astype(np.float64),
            mode_probability=mode_probability.astype(np.float64),
            xy_m=offset_xy_m + now_xy_m[:, None, None],
            goal_mask=goals["goal_weight"][1],
            **{name: values.astype(np.float64) for name, (values, _) in goals.items()},
            has_conflict=rows["has_conflict"],
            slot_mask=slot_mask,
            slot_vehicle=slot_vehicle,
            slot_in_focus=slots["slot_in_focus"],
            has_slot_probability=rows["slot_probability"][1] > 0,
            slot_probability=slots["slot_probability"].astype(np.float64),
            ego_to_conflict_m=slots["ego_to_conflict_m"],
            rear_to_conflict_m=slots["rear_to_conflict_m"],
            conflict_xy_m=np.stack([slots["conflict_x_m"], slots["conflict_y_m"]], axis=2),
            conflict_type=slots["conflict_type"].astype(np.int64),
            slot_length_m=slots["slot_length_m"].astype(np.float64),
        )

    @cached_property
    def suggestions(self) -> tuple[SuggestionChange, ...]:
        changes = self._each(schema.SUGGESTIONS_FILE, change_of)
        return tuple(change for change in changes if self._counts(change.frame))

    @cached_property
    def alerts(self) -> tuple[tuple[int, Alert], ...]:
        """(frame, edge of an alert) as they happened."""
        edges = self._each(schema.ALERTS_FILE, edge_of)
        return tuple(edge for edge in edges if self._counts(edge[0]))

    @cached_property
    def events(self) -> tuple[Event, ...]:
        events = self._each(schema.EVENTS_FILE, event_of)
        return tuple(event for event in events if self._counts(event.frame))

    @cached_property
    def times_s(self) -> FloatArray:
        """[frame_count]"""
        times: FloatArray = self._index_of_frames["time_s"]
        return times

    @cached_property
    def _index_of_frames(self) -> dict[str, Any]:
        return read_parts(self.path / schema.FRAMES_FOLDER, range(self.parts), schema.FRAMES)

    def _part(self, folder: str, part: int, columns: tuple[schema.Column, ...]) -> dict[str, Any]:
        """One part of a table, ids as strings."""
        return read_parts(self.path / folder, self._there(folder, [part]), columns)

    def _rows(
        self,
        folder: str,
        columns: tuple[schema.Column, ...],
        every_frames: int = 1,
        parts: range | None = None,
    ) -> dict[str, Any]:
        index = {name: number for number, name in enumerate(self.ids)}
        # A run stopped while it wrote a frame may have rows of it that do not count.
        frames = range(0, self.frame_count, every_frames)
        wanted = self._there(folder, range(self.parts) if parts is None else parts)
        return read_parts(self.path / folder, wanted, columns, index, frames)

    def _there(self, folder: str, parts: Iterable[int]) -> list[int]:
        """Those parts of a table that are not left out."""
        return [one for one in parts if not self._is_gone(f"{folder}/{schema.part_name(one)}")]

    @cached_property
    def counterfactuals(self) -> list[Mapping[str, Any]] | None:
        """What branches of the run said of its advice; None where none were asked for."""
        name = schema.COUNTERFACTUALS_FILE
        is_noted = noted_lines(self.header, name) is not None
        if self._is_gone(name) or not (is_noted or (self.path / name).exists()):
            return None
        return self._lines(name)

    def _lines(self, name: str) -> list[Any]:
        if self._is_gone(name):
            return []
        cut = any(gap.file == name for gap in self.gaps)
        lines, is_cut = read_lines(self.path / name, forgive_last=cut)
        if is_cut and self.finished and not cut:
            raise InputError(f"{self.path / name}: the last line is cut off; make the run again")
        noted = noted_lines(self.header, name)
        if not cut and noted is not None and len(lines) < noted:
            raise InputError(
                f"{self.path / name}: expected {noted} lines, found {len(lines)}; "
                "make the run again"
            )
        return lines

    def _each(self, name: str, read: Callable[[Any], T]) -> list[T]:
        return each_as(self.path / name, self._lines(name), read)

    def _counts(self, frame: int) -> bool:
        """A kill takes frames back of which lines are on disk."""
        return self.whole or frame < self.frame_count

    def _is_gone(self, file: str) -> bool:
        """Nothing of a file can be read, and the run is looked at without it."""
        gone = [gap.file for gap in self.gaps if gap.is_gone]
        return any(file == one or (one.endswith("/") and file.startswith(one)) for one in gone)


def read_run(path: Path, *, whole: bool = True) -> Run:
    """Open the log of a run, finished or not.

    Args:
        path: the folder of the run.
        whole: damage is an error wherever it is met. Else what is missing or cut off and can be
            done without is left out, and said in `Run.gaps`.

    Raises:
        InputError: not the folder of a run, of another schema version, or damaged.
    """
    header = read_head(path)
    named, finished, frames = header["predictors"], header["finished"], header["frames"]
    parts = part_count(path / schema.FRAMES_FOLDER)
    columns = (schema.Column("frame", "int32"),)
    frame_count = len(read_parts(path / schema.FRAMES_FOLDER, range(parts), columns)["frame"])
    # Tables are written before it is told how many frames there are.
    if frame_count < frames or (finished and frame_count != frames):
        raise InputError(
            f"{path}: expected {frames} frames, found {frame_count}; a part was lost, "
            "make the run again"
        )
    folders = sorted((path / schema.PREDICTIONS_FOLDER).glob("*"))
    found = [schema.predictor_name(folder.name) for folder in folders]
    predictors = tuple(dict.fromkeys([*named, *found]))
    for part in map(schema.part_name, range(parts)):
        check_part(path / schema.TRACKS_FOLDER / part)
    run = Run(path, header, finished, frame_count, parts, predictors)
    if whole:
        return run
    gaps = find_gaps(path, header, frame_count, parts, predictors, by_route=run.by_route)
    return replace(run, whole=False, gaps=gaps)


def _scene_columns(rows: Mapping[str, Any]) -> dict[str, Any]:
    """Rows of `tracks/` as arrays of a scene."""
    return {
        "xy_m": np.stack([rows["x_m"], rows["y_m"]], axis=1),
        "yaw_rad": rows["yaw_rad"],
        "speed_mps": rows["speed_mps"],
        "size_m": np.stack([rows["length_m"], rows["width_m"]], axis=1),
        "kind": rows["kind"].astype(np.int64),
        "colour": np.stack([rows["red"], rows["green"], rows["blue"]], axis=1).astype(np.int64),
        "blinker": rows["blinker"].astype(np.int64),
    }


def _truth(routes: tuple[Route | None, ...], events: list[Event]) -> Truth:
    happened: dict[str, tuple[Any, ...]] = {}
    for kind, name in schema.EVENTS.items():
        who = [event.ids for event in events if event.type == kind]
        happened[name] = tuple(who if kind == "collision" else [ids[0] for ids in who])
    return Truth(routes, **happened)


def _as_wide(values: Any, mask: BoolArray) -> Any:
    """Padded lists in the mask's shape: lists may be empty where the mask is not (no answer)."""
    wide = np.zeros(mask.shape, dtype=values.dtype)
    wide[:, : values.shape[1]] = values
    return wide
