"""`run.json`, the head of a run's log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hatn_sim.errors import InputError
from hatn_sim.log import schema
from hatn_sim.log.lines_file import read_text

HEAD = {"predictors": list, "finished": bool, "frames": int}
"""Keys of run.json that are read, and the types of their values."""
OPTIONAL_HEAD = {
    "settings": dict,
    "weights_sha256": dict,
    "trained_on": list,
    schema.LINE_COUNTS: dict,
}
"""The same of keys that a log may lack."""


def read_head(path: Path) -> dict[str, Any]:
    """The head in a run's folder.

    Raises:
        InputError: not the folder of a run, of another schema version, or damaged.
    """
    file = path / schema.RUN_FILE
    if not file.is_file():
        raise InputError(
            f"{path}: expected the folder of a run, found no {schema.RUN_FILE} in it; "
            "name a folder that `hatn-sim run --out` made"
        )
    try:
        header = json.loads(read_text(file))
        version = header["schema_version"]
        if version == schema.SCHEMA_VERSION:
            _check_head(header)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{file}: expected the head of a run's log, found damage ({error!r}); "
            "make the run again"
        ) from error
    if version != schema.SCHEMA_VERSION:
        raise InputError(
            f"{file}: expected schema version {schema.SCHEMA_VERSION}, found {version}; "
            "make the run again with this version of hatn-sim, or read it with that one"
        )
    return header


def _check_head(header: dict[str, Any]) -> None:
    """Raises KeyError or TypeError where a key that is read is missing or of another type."""
    given = HEAD | {key: kind for key, kind in OPTIONAL_HEAD.items() if key in header}
    for key, kind in given.items():
        if type(header[key]) is not kind:
            raise TypeError(f"{key}: expected {kind.__name__}, found {header[key]!r}")
    if not all(type(name) is str for name in header["predictors"]):
        raise TypeError(f"predictors: expected names, found {header['predictors']!r}")
    counts = header.get(schema.LINE_COUNTS, {})
    if not all(type(count) is int for count in counts.values()):
        raise TypeError(f"{schema.LINE_COUNTS}: expected numbers, found {counts!r}")
