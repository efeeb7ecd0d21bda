"""Frames and advice -> the folder of a run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from hatn_sim.datatypes import DT_S, Advice, Frame, Route, Truth
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.log import rows, schema
from hatn_sim.log.lines_file import LineWriter
from hatn_sim.log.parts import PartBuffer
from hatn_sim.whole_file import write_whole

RESERVED_KEYS = ("schema_version", "finished", "frames", "predictors", schema.LINE_COUNTS)


class RunWriter:
    """Writes the log of a run; a context manager, which closes it as unfinished on an exception.

    Args:
        out: the folder to make; it must not exist.
        header: what `run.json` says of the run (scenario, seed, settings ...), ready for JSON.
            Scores read its keys `scene` and `adapt`.

    Raises:
        InputError: `out` exists or cannot be made; nothing is left behind then.
    """

    def __init__(self, out: Path, header: Mapping[str, Any]) -> None:
        if reserved := [key for key in RESERVED_KEYS if key in header]:
            raise ValueError(f"the header of a run may not have the key {reserved[0]!r}")
        json.dumps(dict(header))  # refused before anything is made
        self._out = out
        self._header = dict(header)
        self._predictions: dict[str, PartBuffer] = {}
        self._index: dict[str, int] = {}  # of every vehicle so far, in order of appearance
        self._routes: dict[Route, int] = {}
        self._advised: dict[str, tuple[str, str | None, bool]] = {}
        self._next_frame = 0
        self._written_frames = 0
        self._closed = False
        self._lines: dict[str, LineWriter] = {}  # by name
        self._tracks = PartBuffer(out / schema.TRACKS_FOLDER, schema.TRACKS)
        self._truth = PartBuffer(out / schema.TRUTH_FOLDER, schema.TRUTH)
        self._frames = PartBuffer(out / schema.FRAMES_FOLDER, schema.FRAMES)
        _make_folder(out)
        try:
            self._begin()
        except BaseException:
            shutil.rmtree(out, ignore_errors=True)
            raise

    def _begin(self) -> None:
        """Fill the folder with what is there from the beginning."""
        with _errors_of_the_disk(self._out):
            self._write_run_file(finished=False)
            (self._out / schema.TRUTH_FOLDER).mkdir()
            self._suggestions = self._open_lines(schema.SUGGESTIONS_FILE)
            self._alerts = self._open_lines(schema.ALERTS_FILE)
            self._events = self._open_lines(schema.EVENTS_FILE)
            self._routes_file = self._open_lines(schema.ROUTES_FILE)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave no folder behind where an error came before the first frame."""
        self.close(finished=kind is None)
        if kind is not None and not self._written_frames:
            shutil.rmtree(self._out, ignore_errors=True)

    def write(self, frame_index: int, frame: Frame, advice: Mapping[str, Advice]) -> None:
        """Add a frame; `advice` by predictor, the main one first, whose suggestions are logged.

        Frames are numbered 0, 1, 2 ... Any predictor may be absent from a frame; the others of
        `--compare` are needed only at frames that are sampled for scores.

        Raises:
            ValueError: a frame out of order, or a prediction of other vehicles than the frame's.
            HatnSimError: the disk is full or the like.
        """
        if frame_index != self._next_frame:
            raise ValueError(f"frame {self._next_frame} has to follow, got {frame_index}")
        scene = frame.scene
        for name, of_predictor in advice.items():
            if of_predictor.prediction.ids != scene.ids:
                raise ValueError(f"{name} predicts other vehicles than those of the frame")
        index = self._index
        vehicles = np.array([index.setdefault(name, len(index)) for name in scene.ids], np.int64)
        with _errors_of_the_disk(self._out):
            self._tracks.append(rows.track_rows(frame_index, scene, vehicles))
            routes = self._route_lines(frame.truth)
            self._truth.append(rows.truth_rows(frame_index, vehicles, routes))
            self._write_events(frame_index, scene.time_s, frame.truth)
            for order, (name, of_predictor) in enumerate(advice.items()):
                self._buffer(name).append(
                    rows.prediction_rows(frame_index, scene, of_predictor.prediction, vehicles)
                )
                if order == 0:
                    self._write_suggestions(frame_index, scene.time_s, of_predictor)
                    for alert in of_predictor.alerts:
                        ago = max(round((scene.time_s - alert.time_s) / DT_S), 0)
                        at = max(frame_index - ago, 0)  # a peak or an end is known only later
                        self._alerts.write({"frame": at, **asdict(alert)})
            # Last: a frame counts for readers from here on, whatever interrupts the run.
            self._frames.append(rows.frame_rows(frame_index, frame))
            self._next_frame += 1
            if self._next_frame % schema.PART_FRAMES == 0:
                self._write_part()

    def write_counterfactuals(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Add lines of what branches of the run said; there is a file from the first call on."""
        with _errors_of_the_disk(self._out):
            if schema.COUNTERFACTUALS_FILE not in self._lines:
                self._open_lines(schema.COUNTERFACTUALS_FILE)
            for line in lines:
                self._lines[schema.COUNTERFACTUALS_FILE].write(dict(line))

    def close(self, *, finished: bool = True, timing: Mapping[str, Any] | None = None) -> None:
        """Write what is left; a second call does nothing. `timing` goes to `timing.json`."""
        if self._closed:
            return
        with _errors_of_the_disk(self._out):
            if self._written_frames < self._next_frame:
                self._write_part()
            for file in self._lines.values():
                file.close()
            if timing is not None:
                self._write_whole(schema.TIMING_FILE, json.dumps(dict(timing), indent=2))
            counts = {name: file.count for name, file in self._lines.items()}
            self._write_run_file(finished=finished, line_counts=counts)
        # Last: who is interrupted in here closes once more.
        self._closed = True

    def _buffer(self, predictor: str) -> PartBuffer:
        if predictor not in self._predictions:
            folder = self._out / schema.predictor_folder(predictor)
            self._predictions[predictor] = PartBuffer(folder, schema.PREDICTIONS)
        return self._predictions[predictor]

    def _route_lines(self, truth: Truth) -> list[int]:
        """The line of `routes.jsonl` with each vehicle's route, appended when it is new."""
        for route in truth.routes:
            if route is not None and route not in self._routes:
                self._routes[route] = len(self._routes)
                self._routes_file.write(list(route))
        return [-1 if route is None else self._routes[route] for route in truth.routes]

    def _write_events(self, frame_index: int, time_s: float, truth: Truth) -> None:
        for kind, name in schema.EVENTS.items():
            for who in getattr(truth, name):
                ids = [who] if isinstance(who, str) else list(who)
                event = {"frame": frame_index, "time_s": time_s, "type": kind, "ids": ids}
                self._events.write(event)

    def _write_suggestions(self, frame_index: int, time_s: float, advice: Advice) -> None:
        """A line when action, slot, feasibility or the reason change, or whether a time is told:
        advice may be held against what has become likely meanwhile. Of what is not advised,
        feasibility and time are nobody's concern.

        Not when a probability stirs.
        """
        advised = {}
        for suggestion in advice.suggestions:
            is_silent = suggestion.action == "abstain"
            key = (
                suggestion.action,
                suggestion.slot_id,
                is_silent or suggestion.feasible,
                suggestion.reason,
                is_silent or suggestion.target_time_s is None,
            )
            advised[suggestion.ego_id] = key
            if self._advised.get(suggestion.ego_id) != key:
                line = {"frame": frame_index, **asdict(suggestion)}
                if suggestion.action == "abstain":
                    # Nothing is advised: what would have been is nobody's to act on.
                    line |= {"target_time_s": None, "advised_speed_mps": None}
                self._suggestions.write(line)
        for ego_id in self._advised:
            if ego_id not in advised:
                gone = {"frame": frame_index, "time_s": time_s, "ego_id": ego_id, "action": None}
                self._suggestions.write(gone)
        self._advised = advised

    def _write_part(self) -> None:
        part = (self._next_frame - 1) // schema.PART_FRAMES
        ids = list(self._index)
        # The part of `frames` comes last: readers count a part from then on.
        for buffer in (self._tracks, self._truth, *self._predictions.values(), self._frames):
            buffer.write(part, ids)
        self._written_frames = self._next_frame
        self._write_run_file(finished=False)

    def _write_run_file(
        self, *, finished: bool, line_counts: Mapping[str, int] | None = None
    ) -> None:
        content = {
            "schema_version": schema.SCHEMA_VERSION,
            **self._header,
            "predictors": list(self._predictions),
            "frames": self._written_frames,
            "finished": finished,
        }
        if line_counts is not None:  # a killed run has none
            content[schema.LINE_COUNTS] = dict(line_counts)
        self._write_whole(schema.RUN_FILE, json.dumps(content, indent=2))

    def _write_whole(self, name: str, text: str) -> None:
        data = f"{text}\n".encode()
        write_whole(self._out / name, lambda file: file.write_bytes(data))

    def _open_lines(self, name: str) -> LineWriter:
        self._lines[name] = LineWriter(self._out / name)
        return self._lines[name]


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True)
    except FileExistsError as error:
        raise InputError(
            f"{out}: expected an output folder that does not exist yet, found one that does; "
            "name another or remove it"
        ) from error
    except OSError as error:
        raise InputError(
            f"{out}: the output folder cannot be made ({error.strerror}); "
            "name one in a place that can be written"
        ) from error


@contextmanager
def _errors_of_the_disk(out: Path) -> Generator[None, None, None]:
    try:
        yield
    except OSError as error:
        raise HatnSimError(
            f"{out}: the log cannot be written on ({error.strerror or error}); "
            "make room or name another folder, and make the run again"
        ) from error
