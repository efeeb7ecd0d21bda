"""Files of one JSON value a line, as runs leave them: a kill may leave half a line at the end."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from hatn_sim.datatypes import Alert, Route, Suggestion
from hatn_sim.errors import InputError
from hatn_sim.log.tables import Event, SuggestionChange

T = TypeVar("T")


class LineWriter:
    """A new file of lines, each out of our hands at once; it counts them."""

    def __init__(self, path: Path) -> None:
        self.count = 0
        self._file = path.open("w", encoding="utf-8", newline="\n")

    def write(self, content: Any) -> None:
        """Add a line; what of a dict is not finite becomes null."""
        if isinstance(content, dict):
            content = {
                key: None if isinstance(value, float) and not math.isfinite(value) else value
                for key, value in content.items()
            }
        self._file.write(json.dumps(content, allow_nan=False) + "\n")
        self._file.flush()
        self.count += 1

    def close(self) -> None:
        """No more lines; a second call does nothing."""
        self._file.close()


def read_text(path: Path) -> str:
    """The text of a file. Raises InputError where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); make the run again") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read ({error}); make the run again") from error


def read_lines(path: Path, forgive_last: bool = False) -> tuple[list[Any], bool]:
    """The values of all lines, and whether the last one was cut off and is left out.

    Args:
        path: of the file.
        forgive_last: also leave out a last line that is ended but no JSON.

    Raises:
        InputError: the file cannot be read, or another line is no JSON.
    """
    lines = read_text(path).split("\n")
    is_cut = bool(lines.pop())
    values: list[Any] = []
    for number, line in enumerate(lines, start=1):
        try:
            values.append(json.loads(line))
        except ValueError as error:
            if forgive_last and number == len(lines) and not is_cut:
                return values, True
            raise InputError(
                f"{path}: a line is not JSON (line {number}: {error}); make the run again"
            ) from error
    return values, is_cut


def each_as(path: Path, values: list[Any], read: Callable[[Any], T]) -> list[T]:
    """What `read` makes of every line. Raises InputError where one lacks what it takes."""
    out: list[T] = []
    for number, value in enumerate(values, start=1):
        try:
            out.append(read(value))
        except (KeyError, TypeError) as error:
            raise InputError(
                f"{path}: line {number} is not as a run leaves it ({error!r}); make the run again"
            ) from error
    return out


def route_of(line: Any) -> Route | None:
    """A line of routes."""
    return tuple(line)


def event_of(line: Any) -> Event:
    """A line of events."""
    return Event(line["frame"], line["time_s"], line["type"], tuple(line["ids"]))


def change_of(line: Any) -> SuggestionChange:
    """A line of suggestions."""
    said = None if line["action"] is None else _read_as(Suggestion, line)
    return SuggestionChange(line["frame"], line["ego_id"], said)


def edge_of(line: Any) -> tuple[int, Alert]:
    """A line of alerts: its frame, and the edge of an alert."""
    return line["frame"], _read_as(Alert, line)


def _read_as(kind: type, line: Mapping[str, Any]) -> Any:
    """A line of JSON as a flat dataclass; null in a field of floats stands for "not finite"."""
    values = {field.name: line[field.name] for field in fields(kind) if field.name in line}
    values |= {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
    for field in fields(kind):
        if field.type in ("float", float) and values.get(field.name, 0.0) is None:
            values[field.name] = math.nan
    return kind(**values)
