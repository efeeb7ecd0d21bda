"""Who may meet whom now, and where: all pairs of vehicles at conflicts or one behind the other.

A pair at a conflict shares an area: the part of either line where a vehicle that drives along it
overlaps the strip that the other's outline sweeps. On straight lines that meet at an angle a, the
centre of a vehicle of length l and width w is in the strip of another of width u within
l/2 + (u + w |cos a|) / (2 |sin a|) of the point where the lines cross.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.conflicts import CONFLICT_WIDTH_M
from hatn_sim.datatypes import ConflictType, FloatArray, IntArray, Lines, Scene
from hatn_sim.geometry import wrap_angle
from hatn_sim.road import Road

REACH_M: Final = 60.0
"""Areas farther ahead than this are not looked at ..."""
NEAR_M: Final = 20.0
AHEAD_S: Final = 5.0
"""... nor those farther than `NEAR_M` which a vehicle does not come so near to in this time."""
LEAST_ANGLE_RAD: Final = np.deg2rad(20.0)
"""Lines that cross at less are taken to cross at this: the area would have no end."""
CROSS: Final = int(ConflictType.CROSS)
MERGE: Final = int(ConflictType.MERGE)
FOLLOW: Final = 2
"""Beside the types of conflict: the second follows the first, in its corridor."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs [Q] of vehicles; columns [Q, 2] are of the first and of the second of each.

    Distances are along the own lines, from where a vehicle is now. `room_m` is from its front
    bumper to the area, `clear_m` the way until its rear bumper is out of it; both are negative
    behind. Of a following pair, the area is the leader: of the follower (the second), `room_m` is
    the gap; the other entries mean nothing.
    """

    index: IntArray  # [Q, 2] vehicles
    type: IntArray  # [Q] ConflictType or FOLLOW
    room_m: FloatArray  # [Q, 2]
    clear_m: FloatArray  # [Q, 2]
    to_point_m: FloatArray  # [Q, 2] from the centre to the point of conflict
    length_m: FloatArray  # [Q, 2] of the vehicles
    angle_rad: FloatArray  # [Q] between the lines there, 0 ... pi

    def of(self, rows: IntArray) -> Pairs:
        """Some of them."""
        return Pairs(*(getattr(self, field.name)[rows] for field in fields(self)))


def pairs_of(
    road: Road, scene: Scene, lines: Lines, leader: IntArray, leader_s_m: FloatArray
) -> Pairs:
    """All pairs of this moment: the first conflict of each two lines that neither has left.

    `leader` and `leader_s_m` [N] are those of `Perception`.
    """
    met, behind = at_conflicts(road, scene, lines), _following(scene, lines, leader, leader_s_m)
    return Pairs(
        *(
            np.concatenate((getattr(met, field.name), getattr(behind, field.name)))
            for field in fields(Pairs)
        )
    )


def area_m(
    road: Road, scene: Scene, index: IntArray, line: IntArray, point_s_m: FloatArray, kind: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Half the length of the areas of conflict [Q, 2], half lengths included, and the angles [Q].

    `index` and `line` [Q, 2] are the vehicles and their lines, `point_s_m` [Q, 2] the conflict on
    either. At a merge the area begins where outlines would touch, as at a crossing.
    """
    yaw = road.line_yaw_rad(line, point_s_m)
    angle = np.abs(wrap_angle(yaw[:, 1] - yaw[:, 0]))
    length, width = scene.size_m[index, 0], scene.size_m[index, 1]
    crossing = np.minimum(np.maximum(angle, LEAST_ANGLE_RAD), np.pi - LEAST_ANGLE_RAD)[:, None]
    sin = np.sin(crossing)
    swept = (width[:, ::-1] + width * np.abs(np.cos(crossing))) / (2.0 * sin)
    # Merging lines are as near as `CONFLICT_WIDTH_M` where the area begins: what is wider than
    # that comes in earlier.
    wider = np.maximum(0.5 * (width[:, :1] + width[:, 1:]) - CONFLICT_WIDTH_M, 0.0)
    aside = np.where((kind == MERGE)[:, None], wider / sin, swept)
    return 0.5 * length + aside, angle


def at_conflicts(road: Road, scene: Scene, lines: Lines) -> Pairs:
    """The pairs at conflicts only, of those of `pairs_of`."""
    reach = np.minimum(NEAR_M + AHEAD_S * scene.speed_mps, REACH_M)
    near = _within_reach(scene.xy_m, reach, np.flatnonzero(lines.line >= 0))
    met = road.conflict_table.of_pairs(*lines.line[near].T)
    index, point_s = near[met.pair], met.point_s_m
    to_point = point_s - lines.s_m[index]
    within = (to_point <= reach[index]) & (to_point > -REACH_M)
    some = np.flatnonzero(within[:, 0] & within[:, 1])
    index, kind, point_s, to_point = index[some], met.type[some], point_s[some], to_point[some]
    half, angle = area_m(road, scene, index, lines.line[index], point_s, kind)
    clear = to_point + half
    ahead = np.flatnonzero((clear[:, 0] > 0.0) & (clear[:, 1] > 0.0))
    index, kind, to_point, half = index[ahead], kind[ahead], to_point[ahead], half[ahead]
    later_m = np.maximum(to_point[:, 0], to_point[:, 1])
    first = _first_of_each(index[:, 0] * len(scene.ids) + index[:, 1], later_m)
    index, to_point, half = index[first], to_point[first], half[first]
    return Pairs(
        index=index,
        type=kind[first],
        room_m=to_point - half,
        clear_m=to_point + half,
        to_point_m=to_point,
        length_m=scene.size_m[index, 0],
        angle_rad=angle[ahead][first],
    )


def _within_reach(xy_m: FloatArray, reach_m: FloatArray, of: IntArray) -> IntArray:
    """The pairs [Q, 2] of vehicles `of` that are no farther apart than both reach together."""
    if len(of) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    far_m = 2.0 * float(reach_m[of].max())
    one, other = of[KDTree(xy_m[of]).query_pairs(far_m, output_type="ndarray").T]
    x_m, y_m = xy_m[:, 0], xy_m[:, 1]
    away_x, away_y = x_m[one] - x_m[other], y_m[one] - y_m[other]
    within = away_x**2 + away_y**2 <= (reach_m[one] + reach_m[other]) ** 2
    return np.stack((one[within], other[within]), axis=1)


def _first_of_each(key: IntArray, rank: FloatArray) -> IntArray:
    """The row of lowest rank of every key."""
    order = np.lexsort((rank, key))
    sorted_key = key[order]
    is_new = np.ones(len(order), dtype=np.bool_)
    is_new[1:] = sorted_key[1:] != sorted_key[:-1]
    return order[is_new]


def _following(scene: Scene, lines: Lines, leader: IntArray, leader_s_m: FloatArray) -> Pairs:
    follower = np.flatnonzero(leader >= 0)
    index = np.stack((leader[follower], follower), axis=1)
    away = leader_s_m[follower] - lines.s_m[follower]
    length = scene.size_m[index, 0]
    gap = away - 0.5 * (length[:, 0] + length[:, 1])
    far = np.full(len(follower), np.inf)
    turned = np.abs(wrap_angle(scene.yaw_rad[index[:, 0]] - scene.yaw_rad[index[:, 1]]))
    return Pairs(
        index=index,
        type=np.full(len(index), FOLLOW),
        room_m=np.stack((far, gap), axis=1),
        clear_m=np.stack((far, far), axis=1),
        to_point_m=np.stack((far, away), axis=1),
        length_m=length,
        angle_rad=turned,
    )
