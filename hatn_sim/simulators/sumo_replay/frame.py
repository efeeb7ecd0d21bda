"""The frame that a replay shows: recorded vehicles as recorded, the others as they drive. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hatn_sim.datatypes import Frame, Route, Scene, Truth
from hatn_sim.simulators.sumo_messages import RawFrame, numbers_of
from hatn_sim.simulators.sumo_replay.figures import Overlap
from hatn_sim.simulators.sumo_replay.plan import Look
from hatn_sim.simulators.touching import touching_rows_of


def shown_scene(
    recorded: Scene, raw: RawFrame, instead: Collection[str], looks: Mapping[str, Look]
) -> Scene:
    """The recorded vehicles but those `instead`, then SUMO's with the looks that were recorded."""
    kept = np.array([name not in instead for name in recorded.ids], dtype=np.bool_)
    of_sumo = [looks[name] for name in raw.ids]
    count, rows = len(of_sumo), numbers_of([raw])
    size_m = np.array([look.size_m for look in of_sumo], np.float64).reshape(count, 2)
    kind = np.array([look.kind for look in of_sumo], np.int64)
    colour = np.array([look.colour for look in of_sumo], np.int64).reshape(count, 3)
    return Scene(
        time_s=recorded.time_s,
        ids=(*(name for name in recorded.ids if name not in instead), *raw.ids),
        xy_m=np.concatenate([recorded.xy_m[kept], rows[:, :2]]),
        yaw_rad=np.concatenate([recorded.yaw_rad[kept], rows[:, 2]]),
        speed_mps=np.concatenate([recorded.speed_mps[kept], rows[:, 3]]),
        size_m=np.concatenate([recorded.size_m[kept], size_m]),
        kind=np.concatenate([recorded.kind[kept], kind]),
        colour=np.concatenate([recorded.colour[kept], colour]),
        blinker=np.concatenate([recorded.blinker[kept], rows[:, 4].astype(np.int64)]),
        signal_closed=raw.signal_closed,
    )


def shown_truth(
    recorded: Frame,
    raw: RawFrame,
    instead: Collection[str],
    driven_routes: Sequence[Route | None],
    overlaps: Sequence[Overlap],
    left: Sequence[str],
) -> Truth:
    """What is known of the vehicles of `shown_scene`, in its order.

    Args:
        recorded: the recording's frame.
        raw: SUMO's, of the vehicles that drive.
        instead: recorded ids that are not shown as recorded.
        driven_routes: of the vehicles of `raw`.
        overlaps: driven vehicles whose outlines touch others'.
        left: driven vehicles that have come to the end of their way.
    """
    ids, truth = recorded.scene.ids, recorded.truth
    routes = (r for name, r in zip(ids, truth.routes, strict=True) if name not in instead)
    as_recorded = {pair for pair in truth.collisions if not set(pair) & set(instead)}
    touching = {(min(o.driven_id, o.other_id), max(o.driven_id, o.other_id)) for o in overlaps}

    def not_instead(names: Sequence[str]) -> tuple[str, ...]:
        return tuple(name for name in names if name not in instead)

    return Truth(
        routes=(*routes, *driven_routes),
        collisions=tuple(sorted(as_recorded | touching)),
        emergency_braking=not_instead(truth.emergency_braking) + raw.emergency_braking,
        departed=truth.departed,
        arrived=(*not_instead(truth.arrived), *left),
        teleported=not_instead(truth.teleported),
    )


def overlaps_of(shown: Scene, driven: Collection[str]) -> list[Overlap]:
    """The driven vehicles of a scene whose outlines touch another vehicle's."""
    of = np.array([name in driven for name in shown.ids], dtype=np.bool_)
    return [
        Overlap(shown.time_s, shown.ids[first], shown.ids[second], other_recorded=not of[second])
        for first, second in touching_rows_of(shown, of)
    ]
