"""The log of a run as a file of Rerun's (.rrd), which its viewer opens without a network.

The only importer of rerun. What is in the file, on the timelines `frame` and `time`:

| entity | what |
|---|---|
| `/road/lanes` | edges of lanes; always there |
| `/vehicles` | boxes with their ids |
| `/predictions` | of the main predictor: modes of 5 % and more, way points 0.5 s apart |
| `/happened` | where each really went in the next 3 s, as far as it was seen, 0.5 s apart |
| `/slots` | those that egos choose from, along lines; colour and label are the probability |
| `/conflicts` | where egos meet those whose slots they choose from |
| `/signals` | stop lines in the colour of their signal, sent whenever one changes |
| `/advice`, `/alerts` | texts: what egos are told |
| `/events` | texts: what really happened: T1 collisions, T2 evasive braking, T3 close passes |
| `/plots/...` | vehicles in view, their mean speed, open alerts |

Rerun keeps places in single precision, so they are relative to a whole metre of the map that
`/road` tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import (
    HORIZON_FRAMES,
    FloatArray,
    Gate,
    IntArray,
    Kind,
    Lane,
    SafetyEvent,
)
from hatn_sim.errors import InputError
from hatn_sim.log import Run
from hatn_sim.report.moment import SLOT_REACH_M
from hatn_sim.report.page.lines import LinesDriven, lines_driven
from hatn_sim.report.road_shapes import stop_line
from hatn_sim.road import LINE_STEP_M
from hatn_sim.score.close_passes import shown_passes
from hatn_sim.score.driven import driven_in
from hatn_sim.score.events import severe_events
from hatn_sim.whole_file import write_whole

RRD_FILE: Final = "run.rrd"
WAY_POINT_FRAMES: Final = 5
LEAST_CHANCE: Final = 0.05
HEIGHTS_M: Final = {Kind.LORRY: 3.2, Kind.BUS: 3.0, Kind.TRAM: 3.4, Kind.PEDESTRIAN: 1.8}
CAR_M: Final = 1.5
EYE_M: Final = 75.0
"""How high the viewer's eye is over the road at first."""
EDGE: Final = (150, 155, 160)
PREDICTED: Final = (213, 94, 0)
CONFLICT: Final = (0, 114, 178)
HAPPENED: Final = (255, 255, 255)
CLOSED: Final = (229, 72, 77)
OPEN: Final = (70, 167, 88)
SLOT_POINTS_M: Final = 2.0


def rerun_or_error() -> Any:
    """The package. InputError where it is not installed."""
    try:
        import rerun
    except ImportError as error:
        raise InputError(
            f"--format rrd takes rerun-sdk, which cannot be imported ({error}); "
            "pip install 'hatn-sim[viz]'"
        ) from None
    return rerun


def write_rrd(run: Run, path: Path) -> None:
    """Write a run, all of it at once. Raises OSError where it cannot, InputError for damage."""
    rr = rerun_or_error()
    lanes = run.lanes
    points = [lane.xy_m for lane in lanes] or [run.tracks.xy_m]
    origin = np.floor(np.concatenate(points).mean(axis=0))

    def fill(file: Path) -> None:
        stream = rr.RecordingStream("hatn-sim", recording_id=f"hatn-sim {run.path.name}")
        stream.save(file, default_blueprint=_blueprint(np.median(run.tracks.xy_m, axis=0) - origin))
        _send_road(rr, stream, lanes, origin)
        _send_vehicles(rr, stream, run, origin)
        _send_happened(rr, stream, run, origin)
        _send_signals(rr, stream, run, origin)
        if run.predictors:
            _send_predictions(rr, stream, run, origin)
            if run.has_lines:
                _send_slots(rr, stream, run, origin)
        _send_texts(rr, stream, run)
        _send_plots(rr, stream, run)
        stream.flush()
        stream.disconnect()

    write_whole(path, fill)


def _blueprint(middle_xy_m: FloatArray) -> Any:
    """Views side by side; the scene from above where most vehicles are, north at the top."""
    import rerun.blueprint as rrb

    x_m, y_m = middle_xy_m.tolist()
    eye = rrb.EyeControls3D(
        position=(x_m, y_m - 0.3 * EYE_M, EYE_M), look_target=(x_m, y_m, 0.0), eye_up=(0, 0, 1)
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="/", name="scene", eye_controls=eye),
            rrb.Vertical(
                rrb.TextLogView(origin="/", name="advice, alerts, events"),
                rrb.TimeSeriesView(origin="/plots", name="plots"),
            ),
            column_shares=[2, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _times(rr: Any, run: Run, frames: Any) -> list[Any]:
    """Both timelines at these frames [N]."""
    at = np.asarray(frames, dtype=np.int64)
    times_s = run.times_s[np.minimum(at, run.frame_count - 1)]
    return [rr.TimeColumn("frame", sequence=at), rr.TimeColumn("time", duration=times_s)]


def _flat(xy_m: FloatArray, origin: FloatArray, up_m: float = 0.0) -> FloatArray:
    """[..., 3] relative to the origin."""
    up = np.full((*xy_m.shape[:-1], 1), up_m)
    placed: FloatArray = np.concatenate((xy_m - origin, up), axis=-1)
    return placed


def _send_road(rr: Any, stream: Any, lanes: Sequence[Lane], origin: FloatArray) -> None:
    strips: list[FloatArray] = []
    for lane in lanes:
        along = np.gradient(lane.xy_m, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        left = 0.5 * lane.width_m * np.stack((-along[:, 1], along[:, 0]), axis=1)
        strips += [_flat(lane.xy_m + left, origin), _flat(lane.xy_m - left, origin)]
    edges = rr.LineStrips3D(strips, colors=EDGE, radii=0.06)
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("/road/lanes", edges, static=True)
    told = rr.AnyValues(origin_east_m=float(origin[0]), origin_north_m=float(origin[1]))
    stream.log("/road", told, static=True)


def _send_vehicles(rr: Any, stream: Any, run: Run, origin: FloatArray) -> None:
    tracks = run.tracks
    heights = np.array([HEIGHTS_M.get(kind, CAR_M) for kind in Kind])[tracks.kind]
    half = 0.5 * np.column_stack([tracks.size_m, heights])
    centres = _flat(tracks.xy_m, origin)
    centres[:, 2] = half[:, 2]
    turn = 0.5 * tracks.yaw_rad
    zero = np.zeros(len(turn))
    boxes = rr.Boxes3D.columns(
        centers=centres,
        half_sizes=half,
        quaternions=np.column_stack([zero, zero, np.sin(turn), np.cos(turn)]),
        colors=tracks.colour.astype(np.uint8),
        labels=[run.ids[v] for v in tracks.vehicle.tolist()],
        fill_mode=[rr.components.FillMode.Solid] * len(turn),
    )
    _send(rr, stream, run, "/vehicles", boxes, tracks.frame)


def _send_happened(rr: Any, stream: Any, run: Run, origin: FloatArray) -> None:
    tracks = run.tracks
    until = run.trajectories.seen_until(tracks.vehicle, tracks.frame)
    ahead = np.arange(0, HORIZON_FRAMES + 1, WAY_POINT_FRAMES)
    # Whose track ends stays there: a path is then shorter.
    at = np.minimum(tracks.frame[:, None] + ahead, until[:, None])
    xy_m, _ = run.trajectories.xy_at(np.broadcast_to(tracks.vehicle[:, None], at.shape), at)
    paths = rr.LineStrips3D.columns(
        strips=list(_flat(xy_m, origin, 0.15).astype(np.float32)),
        colors=np.tile(HAPPENED, (len(xy_m), 1)).astype(np.uint8),
        radii=np.full(len(xy_m), 0.06),
    )
    _send(rr, stream, run, "/happened", paths, tracks.frame)


def _send_signals(rr: Any, stream: Any, run: Run, origin: FloatArray) -> None:
    lines = [stop_line(lane) for lane in run.lanes if lane.gate is Gate.SIGNAL and lane.signals]
    closed = [frame.scene.signal_closed for frame in run.frames()]
    known = min((len(one) for one in closed), default=0)
    lines = [line for line in lines if max(line.signals) < known]
    if not lines:
        return
    shut = np.array([[one[list(line.signals)].all() for line in lines] for one in closed])
    changed = np.ones(len(shut), dtype=np.bool_)
    changed[1:] = (shut[1:] != shut[:-1]).any(axis=1)
    frames = np.flatnonzero(changed)
    bars = [_flat(line.corners_xy_m[:2], origin, 0.1).astype(np.float32) for line in lines]
    columns = rr.LineStrips3D.columns(
        strips=bars * len(frames),
        colors=np.where(shut[frames].reshape(-1, 1), CLOSED, OPEN).astype(np.uint8),
        radii=np.full(len(frames) * len(lines), 0.25),
        labels=["closed" if one else "open" for one in shut[frames].ravel()],
    )
    lengths = np.full(len(frames), len(lines))
    stream.send_columns("/signals", _times(rr, run, frames), columns.partition(lengths))


def _send(rr: Any, stream: Any, run: Run, entity: str, columns: Any, frame: IntArray) -> None:
    """Rows by frame; a frame without any is sent, too, so that nothing stays that is gone."""
    lengths = np.bincount(frame, minlength=run.frame_count)
    times = _times(rr, run, np.arange(run.frame_count))
    stream.send_columns(entity, times, columns.partition(lengths))


def _send_predictions(rr: Any, stream: Any, run: Run, origin: FloatArray) -> None:
    table = run.predictions(run.predictors[0])
    row, mode = np.nonzero(table.mode_probability >= LEAST_CHANCE)
    now_xy_m, _ = run.trajectories.xy_at(table.vehicle[row], table.frame[row])
    ahead = table.xy_m[row, mode, WAY_POINT_FRAMES - 1 :: WAY_POINT_FRAMES]
    paths = _flat(np.concatenate((now_xy_m[:, None], ahead), axis=1), origin, 0.1)
    alpha = np.round(255.0 * table.mode_probability[row, mode])
    colours = np.column_stack([np.tile(PREDICTED, (len(row), 1)), alpha]).astype(np.uint8)
    strips = rr.LineStrips3D.columns(
        strips=list(paths.astype(np.float32)), colors=colours, radii=np.full(len(row), 0.12)
    )
    _send(rr, stream, run, "/predictions", strips, table.frame[row])
    met = table.slot_in_focus & table.slot_mask & table.has_conflict[:, None]
    met[:, :1] = False
    row, node = np.nonzero(met)
    places = rr.Points3D.columns(
        positions=_flat(table.conflict_xy_m[row, node], origin, 0.2),
        colors=np.tile(CONFLICT, (len(row), 1)).astype(np.uint8),
        radii=np.full(len(row), 0.45),
    )
    _send(rr, stream, run, "/conflicts", places, table.frame[row])


def _send_slots(rr: Any, stream: Any, run: Run, origin: FloatArray) -> None:
    from hatn_sim.report.canvas import PROBABILITY

    table, tracks, driven = run.predictions(run.predictors[0]), run.tracks, lines_driven(run)
    told = table.slot_mask & table.slot_in_focus
    told &= (table.has_slot_probability & table.has_conflict)[:, None]
    row, node = np.nonzero(told)
    rear = table.slot_vehicle[row, node]
    key = tracks.frame * len(run.ids) + tracks.vehicle
    order = np.argsort(key)
    wanted = table.frame[row] * len(run.ids) + rear
    behind = order[np.searchsorted(key, wanted, sorter=order)]
    on_line = driven.line[behind] >= 0
    row, node, rear, behind = row[on_line], node[on_line], rear[on_line], behind[on_line]
    start_m = driven.s_m[behind] + 0.5 * tracks.size_m[behind, 0]
    length_m = np.clip(table.slot_length_m[row, node], 0.0, SLOT_REACH_M)
    places = zip(driven.line[behind].tolist(), start_m.tolist(), length_m.tolist(), strict=True)
    strips = [_along(driven, line, start, length) for line, start, length in places]
    chance = table.slot_probability[row, node]
    named = zip(table.vehicle[row].tolist(), rear.tolist(), chance.tolist(), strict=True)
    columns = rr.LineStrips3D.columns(
        strips=[_flat(strip, origin, 0.05).astype(np.float32) for strip in strips],
        colors=np.round(255.0 * PROBABILITY(chance)).astype(np.uint8).reshape(-1, 4),
        radii=np.full(len(strips), 0.5),
        labels=[_slot_words(run.ids[ego], run.ids[other], p) for ego, other, p in named],
    )
    _send(rr, stream, run, "/slots", columns, table.frame[row])


def _along(driven: LinesDriven, line: int, start_m: float, length_m: float) -> FloatArray:
    """A stretch [P, 2] of a reference line."""
    xy_m = driven.lines[line].xy_m
    s_m = start_m + np.linspace(0.0, length_m, max(int(length_m / SLOT_POINTS_M), 1) + 1)
    own_m = LINE_STEP_M * np.arange(len(xy_m))
    return np.stack([np.interp(s_m, own_m, xy_m[:, k]) for k in (0, 1)], axis=1)


def _slot_words(ego: str, rear: str, chance: float) -> str:
    what = "yield" if ego == rear else f"pass before {rear}"
    return f"{ego}: {what} {100.0 * chance:.0f} %"


def _send_texts(rr: Any, stream: Any, run: Run) -> None:
    advice = [
        (change.frame, f"{change.ego_id}: {_said(change.suggestion)}") for change in run.suggestions
    ]
    alerts = [
        (frame, f"{alert.ego_id} and {alert.other_id}, {alert.edge}: {alert.text or alert.reason}")
        for frame, alert in run.alerts
    ]
    driven = driven_in(run)
    found = sorted((*severe_events(driven), *shown_passes(driven)), key=lambda one: one.start_s)
    events = [
        (int(np.abs(run.times_s - event.start_s).argmin()), _happened(event))
        for event in found
        if event.tier in ("T1", "T2", "T3")
    ]
    for entity, told, level in (
        ("/advice", advice, "INFO"),
        ("/alerts", alerts, "WARN"),
        ("/events", events, "ERROR"),
    ):
        if told:
            texts = [words for _, words in told]
            columns = rr.TextLog.columns(text=texts, level=[level] * len(texts))
            stream.send_columns(entity, _times(rr, run, [frame for frame, _ in told]), columns)


def _happened(event: SafetyEvent) -> str:
    who = event.first_id if event.second_id is None else f"{event.first_id} and {event.second_id}"
    return f"{event.tier}, {event.cause}: {who}"


def _said(suggestion: Any) -> str:
    return "no longer advised" if suggestion is None else suggestion.text


def _send_plots(rr: Any, stream: Any, run: Run) -> None:
    tracks, frames = run.tracks, run.frame_count
    count = np.bincount(tracks.frame, minlength=frames)
    total = np.bincount(tracks.frame, weights=tracks.speed_mps, minlength=frames)
    change = np.zeros(frames + 1)
    for frame, alert in run.alerts:
        change[min(frame, frames)] += {"onset": 1.0, "end": -1.0}.get(alert.edge, 0.0)
    for name, values in (
        ("vehicles", count.astype(np.float64)),
        ("mean_speed_mps", np.where(count > 0, total / np.maximum(count, 1), np.nan)),
        ("open_alerts", np.cumsum(change)[:frames]),
    ):
        columns = rr.Scalars.columns(scalars=values)
        stream.send_columns(f"/plots/{name}", _times(rr, run, np.arange(frames)), columns)
