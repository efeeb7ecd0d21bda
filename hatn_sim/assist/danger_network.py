"""The network that tells the danger of a pair from its signs, and its file.

One hidden layer: danger = logistic(b + w . tanh(B + W (signs - mean) / scale)). The file is JSON
and carries its card: what it was fitted to.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.assist.settings import LEAST_DANGER
from hatn_sim.assist.signs import SIGNS
from hatn_sim.datatypes import FloatArray
from hatn_sim.errors import InputError
from hatn_sim.whole_file import ROOM_OR_OUT, save_whole

FORMAT: Final = 1
SHIPPED: Final = "danger.json"
_SHIPPED: Final = files("hatn_sim.assist") / "weights" / SHIPPED
_ARRAYS: Final = ("mean", "scale", "hidden", "hidden_bias", "out")


@dataclass(frozen=True, eq=False)
class DangerNetwork:
    """S signs, H units."""

    mean: FloatArray  # [S]
    scale: FloatArray  # [S]
    hidden: FloatArray  # [S, H]
    hidden_bias: FloatArray  # [H]
    out: FloatArray  # [H]
    out_bias: float

    def danger(self, signs: FloatArray) -> FloatArray:
        """[P] of pairs with signs [P, S]; 0 below `LEAST_DANGER`."""
        unit = np.tanh(((signs - self.mean) / self.scale) @ self.hidden + self.hidden_bias)
        logit = np.clip(unit @ self.out + self.out_bias, -30.0, 30.0)
        danger = 1.0 / (1.0 + np.exp(-logit))
        return np.where(danger < LEAST_DANGER, 0.0, danger)


@cache
def danger_network(path: str, rule: str) -> DangerNetwork:
    """The network of a rule in a file; "": in that which ships.

    Raises InputError where the file is missing, of another version, or damaged.
    """
    name = path or SHIPPED
    try:
        told: dict[str, Any] = json.loads(_bytes_of(path))
        return _network(told, rule)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{name}: expected networks of danger that this version's `hatn-sim assess "
            f"--calibrate` writes, found damage or another version ({error})"
        ) from None


def sha256_of_danger_network(path: str) -> str:
    """Of the file's bytes; "": of that which ships. Raises InputError where it cannot be read."""
    return sha256(_bytes_of(path)).hexdigest()


def _bytes_of(path: str) -> bytes:
    try:
        return Path(path).read_bytes() if path else _SHIPPED.read_bytes()
    except OSError as error:
        raise InputError(f"{path or SHIPPED}: cannot be read ({error.strerror})") from None


def _network(told: Mapping[str, Any], rule: str) -> DangerNetwork:
    if told["format"] != FORMAT or tuple(told["signs"]) != SIGNS:
        raise ValueError("its signs are others")
    values = told["rules"][rule]
    arrays = {name: np.asarray(values[name], dtype=np.float64) for name in _ARRAYS}
    units = len(arrays["out"])
    shapes = {"mean": (len(SIGNS),), "scale": (len(SIGNS),), "hidden": (len(SIGNS), units)}
    for name, array in arrays.items():
        expected = shapes.get(name, (units,))
        if array.shape != expected or not np.isfinite(array).all():
            raise ValueError(f"{rule}: {name}: expected {expected} numbers, found {array.shape}")
    out_bias = float(values["out_bias"])
    if not math.isfinite(out_bias) or (arrays["scale"] <= 0.0).any():
        raise ValueError(f"{rule}: expected a finite out_bias and scales above 0")
    return DangerNetwork(**arrays, out_bias=out_bias)


def network_values(network: DangerNetwork) -> dict[str, Any]:
    """What the file says of one network."""
    arrays = {name: np.round(getattr(network, name), 5).tolist() for name in _ARRAYS}
    return {**arrays, "out_bias": round(network.out_bias, 5)}


def write_danger_networks(
    path: Path, networks: Mapping[str, DangerNetwork], card: Mapping[str, Any]
) -> None:
    """Write networks by rule, with a card. Raises InputError where there is no room."""
    told = {
        "format": FORMAT,
        "card": dict(card),
        "signs": SIGNS,
        "rules": {rule: network_values(network) for rule, network in networks.items()},
    }
    save_whole(path, json.dumps(told, separators=(",", ":")) + "\n", ROOM_OR_OUT)
