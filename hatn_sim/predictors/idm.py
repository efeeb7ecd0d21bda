"""The intelligent driver model: everybody follows the leader on the own reference line."""

from __future__ import annotations

from hatn_sim.predictors.along_lines import LineFollower
from hatn_sim.predictors.car_following import roll_out


def intelligent_driver_model() -> LineFollower:
    """Car following, see `car_following`; who crosses the own way is not seen."""
    return LineFollower("idm", roll_out)
