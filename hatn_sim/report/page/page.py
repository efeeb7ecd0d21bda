"""The log of a run -> `report.html`, which opens from disk without a network."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray
from hatn_sim.log import Run
from hatn_sim.log.road_file import ROAD_FILE
from hatn_sim.report.page.head import (
    advice_of,
    alerts_of,
    events_of,
    notices_of,
    scores_of,
    settings_of,
    vehicles_of,
)
from hatn_sim.report.page.lines import line_shapes, lines_driven, no_lines
from hatn_sim.report.page.motion import CHUNK_FRAMES, chunks
from hatn_sim.report.page.pack import packed, packed_json
from hatn_sim.report.page.road import near_lanes, road_content
from hatn_sim.whole_file import save_whole

PAGE_FILE: Final = "report.html"
SCRIPTS: Final = (
    *("inflate", "data", "map", "vehicles", "advice", "framing", "labels", "scene"),
    *("timeline", "chart", "panel", "moments", "tables", "input", "hook", "player"),
)
"""Of `assets/`, in the order in which they make one script."""


def write_page(run: Run, out: Path, start: tuple[int, str] | None = None) -> Path:
    """Write the page of a run into a folder; the same log gives the same bytes.

    Args:
        run: finished or not.
        out: a folder.
        start: frame and vehicle that it opens with; None: the first of both.

    Raises:
        InputError: the log is damaged, or the page cannot be written.
    """
    path = out / PAGE_FILE
    save_whole(path, page(run, start))
    return path


def page(run: Run, start: tuple[int, str] | None = None) -> str:
    """The page as one text of ASCII."""
    origin_m = _origin_m(run)
    has_road = (run.path / ROAD_FILE).is_file()
    rows = len(run.tracks.frame)
    with_lines = has_road and run.has_lines and run.predictors
    driven = lines_driven(run) if with_lines else no_lines(rows)
    lanes = near_lanes(run.lanes, run.tracks.xy_m) if has_road else []
    frame, ego = start or (0, "")
    head: dict[str, Any] = {
        "title": str(run.header.get("title") or run.header.get("scene") or "run"),
        "finished": run.finished,
        "notices": notices_of(run),
        "command": str(run.header.get("command", "")),
        "predictor": run.predictors[0] if run.predictors else None,
        "by_route": run.by_route,
        "signals_known": run.signals_known,
        "frames": run.frame_count,
        "chunk_frames": CHUNK_FRAMES,
        "start_s": round(float(run.times_s[0]), 3) if run.frame_count else 0.0,
        "dt_s": DT_S,
        "opens_at": frame,
        "opens_with": run.ids.index(ego) if ego in run.ids else -1,
        "vehicles": vehicles_of(run),
        "road": road_content(lanes, origin_m),
        "lines": line_shapes(driven, origin_m),
        "advice": advice_of(run),
        "alerts": alerts_of(run),
        "events": events_of(run, origin_m),
        "scores": scores_of(run),
        "settings": settings_of(run),
        "origin_m": origin_m.tolist(),
    }
    parts = [
        f'<script type="text/plain" id="chunk-{number}">{packed(data)}</script>'
        for number, data in enumerate(chunks(run, origin_m, driven))
    ]
    return assembled(packed_json(head), parts, frame // CHUNK_FRAMES)


def assembled(head: str, chunks_html: Sequence[str], opens_at: int) -> str:
    """The page around packed data; the chunk that it opens with stands before the script, so that
    the first picture is drawn at once."""
    assets = files("hatn_sim.report.page") / "assets"
    style = (assets / "player.css").read_text(encoding="ascii")
    scripts = [(assets / f"{name}.js").read_text(encoding="ascii") for name in SCRIPTS]
    script = "'use strict';\n(() => {\n" + "\n".join(scripts) + "})();\n"
    policy = (
        f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    html = (assets / "page.html").read_text(encoding="ascii")
    for mark, content in (
        ("POLICY", policy),
        ("STYLE", style),
        ("HEAD", head),
        ("FIRST", "".join(chunks_html[opens_at : opens_at + 1])),
        ("SCRIPT", script),
        ("CHUNKS", "\n".join((*chunks_html[:opens_at], *chunks_html[opens_at + 1 :]))),
    ):
        html = html.replace(f"@@{mark}@@", content, 1)
    return html


def _digest(text: str) -> str:
    digest = hashlib.sha256(text.encode("ascii")).digest()
    return "sha256-" + base64.b64encode(digest).decode("ascii")


def _origin_m(run: Run) -> FloatArray:
    """The middle of where anybody was, on whole metres."""
    xy_m = run.tracks.xy_m
    if not len(xy_m):
        return np.zeros(2)
    return np.rint(0.5 * (xy_m.min(axis=0) + xy_m.max(axis=0)))
