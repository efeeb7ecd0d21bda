"""Predictions put right, so that a fault that was told does not hide the next."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np

from hatn_sim.datatypes import Prediction, Scene

Fault = Literal["order", "finite"]
ALL: Final[tuple[Fault, ...]] = ("order", "finite")
_ROWS: Final = (
    *("xy_m", "mode_probability", "fallback", "adapted"),
    *("goal_weight", "goal_mean_m", "goal_std_m"),
)


def mended(prediction: Any, scene: Scene, faults: Collection[Fault]) -> Any:
    """With vehicles in the order of the scene, and 0 where positions are not finite.

    What cannot be put right is left as it is. Slots of vehicles in another order are dropped.
    """
    if not isinstance(prediction, Prediction):
        return prediction
    ids = prediction.ids
    if "order" in faults and ids != scene.ids and sorted(ids) == sorted(scene.ids):
        rows = [ids.index(name) for name in scene.ids]
        values = {part: getattr(prediction, part) for part in _ROWS}
        if any(value is not None and len(value) != len(rows) for value in values.values()):
            return prediction
        turned: dict[str, Any] = {
            part: value[rows] for part, value in values.items() if value is not None
        }
        none = dict.fromkeys(("lines", "graphs", "slot_probability"))
        prediction = replace(prediction, ids=scene.ids, **none, **turned)
    if "finite" in faults:
        prediction = replace(prediction, xy_m=np.nan_to_num(prediction.xy_m))
    return prediction
