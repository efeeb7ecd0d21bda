"""SUMO's vehicle types for recorded vehicles: who drives them once they are released."""

from __future__ import annotations

from typing import Final

from hatn_sim.datatypes import Kind
from hatn_sim.simulators.sumo_replay.plan import type_of

DRIVERS: Final = {
    Kind.CAR: ("passenger", 2.1, 3.3),
    Kind.VAN: ("delivery", 1.9, 3.3),
    Kind.LORRY: ("truck", 1.2, 3.0),
    Kind.BUS: ("bus", 1.2, 3.0),
    Kind.MOTORCYCLE: ("motorcycle", 2.6, 3.5),
    Kind.BICYCLE: ("bicycle", 1.2, 3.0),
    Kind.TRAM: ("tram", 1.0, 3.0),
    Kind.OTHER: ("passenger", 2.1, 3.3),
}
"""SUMO's vehicle class of each kind, and its acceleration and comfortable deceleration in m/s2.

Pedestrians are not placed.
"""
DRIVER: Final = (
    'carFollowModel="EIDM" treaction="0.1" tau="1.25" minGap="2" emergencyDecel="9" '
    'speedFactor="normc(1,0.1,0.8,1.2)"'
)
"""Between the steady and the brisk drivers of the scenes that ship."""


def vehicle_types() -> str:
    """An additional file of SUMO with a vehicle type for each kind that is placed."""
    types = "\n".join(
        f'    <vType id="{type_of(kind)}" vClass="{vehicle_class}" accel="{accel_mps2}" '
        f'decel="{decel_mps2}" {DRIVER}/>'
        for kind, (vehicle_class, accel_mps2, decel_mps2) in DRIVERS.items()
    )
    return f"<additional>\n{types}\n</additional>\n"
