"""A policy's network as it drives: NumPy only, read from a file of weights with its card."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from hatn_sim.datatypes import MAX_NODES
from hatn_sim.envs.features import ON_ROAD, OTHER, OWN, SLOT, VEHICLES
from hatn_sim.errors import InputError
from hatn_sim.policies.inputs import Layout
from hatn_sim.policies.law import LEVELS_MPS2
from hatn_sim.resources import PACKAGE_DIR
from hatn_sim.whole_file import save_whole

FORMAT: Final = 1
WIDTH: Final = 64
HEAD_WIDTH: Final = 128
SETS: Final = ("own", "slot", "other")
LAYERS: Final = {"own": 1, "slot": 2, "other": 2, "head": 3}
"""Linear layers of each part, rectified but for the last of the head."""
AGAIN: Final = "train again with `hatn-sim train-policy`"

Tensors = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Network:
    """Each slot and each vehicle by itself, the most of either, and a head over all.

    `tensors` are named PART.LAYER.weight [out, in] and PART.LAYER.bias [out].
    """

    layout: Layout
    tensors: Tensors
    card: Mapping[str, Any]

    def values(self, row: np.ndarray) -> np.ndarray:
        """What each level [len(LEVELS_MPS2)] is worth, given a row of inputs [layout.size]."""
        own, slots, slot_mask, others, other_mask = (row[part] for part in self.layout.parts())
        seen = (
            self._through("own", own),
            self._most("slot", slots.reshape(MAX_NODES, -1), slot_mask),
            self._most("other", others.reshape(VEHICLES, -1), other_mask),
        )
        return self._through("head", np.concatenate(seen), is_last_plain=True)

    def best(self, row: np.ndarray) -> int:
        """The number of the level that is worth most."""
        return int(self.values(row).argmax())

    def _most(self, part: str, rows: np.ndarray, mask: np.ndarray) -> np.ndarray:
        # Rectified: none is less than 0, so that 0 stands for nobody.
        return (self._through(part, rows) * mask[:, None]).max(axis=0)

    def _through(self, part: str, values: np.ndarray, is_last_plain: bool = False) -> np.ndarray:
        for layer in range(LAYERS[part]):
            weight = self.tensors[f"{part}.{layer}.weight"]
            values = values @ weight.T + self.tensors[f"{part}.{layer}.bias"]
            if not (is_last_plain and layer == LAYERS[part] - 1):
                values = np.maximum(values, 0.0)
        return values


def shapes_of(layout: Layout) -> dict[str, tuple[int, ...]]:
    """The shape of every tensor of a network."""
    sizes = {
        "own": (layout.own, WIDTH),
        "slot": (layout.slot, WIDTH, WIDTH),
        "other": (layout.other, WIDTH, WIDTH),
        "head": (len(SETS) * WIDTH, HEAD_WIDTH, HEAD_WIDTH, len(LEVELS_MPS2)),
    }
    shapes: dict[str, tuple[int, ...]] = {}
    for part, widths in sizes.items():
        for layer, (inner, outer) in enumerate(pairwise(widths)):
            shapes[f"{part}.{layer}.weight"] = (outer, inner)
            shapes[f"{part}.{layer}.bias"] = (outer,)
    return shapes


def features() -> dict[str, list[str]]:
    """The names of what is read, in order: weights mean nothing for others."""
    return {
        "ego": [one.name for one in OWN + ON_ROAD],
        "vehicles": [one.name for one in OTHER],
        "slots": [one.name for one in SLOT],
    }


def shipped_policy(name: str) -> Path:
    """The weights of a policy that ships."""
    return PACKAGE_DIR / "policies" / "weights" / f"{name}.safetensors"


def save_network(path: Path, network: Network) -> None:
    """Writes the weights, and the card beside them. Raises InputError where that cannot be."""
    tensors = {name: np.ascontiguousarray(one) for name, one in network.tensors.items()}
    card = dict(network.card) | {
        "format": FORMAT,
        "sees_predictions": network.layout.sees_predictions,
        "knows_times": network.layout.knows_times,
        "levels_mps2": list(LEVELS_MPS2),
        "features": features(),
    }
    save_whole(path, save(tensors))
    save_whole(path.with_suffix(".json"), json.dumps(card, indent=1, ensure_ascii=False) + "\n")


def load_network(path: Path) -> Network:
    """Reads weights and card. Raises InputError where they are not of this version, or damaged."""
    card_path = path.with_suffix(".json")
    try:
        card = json.loads(card_path.read_text(encoding="utf-8"))
        found = {key: card[key] for key in ("format", "levels_mps2", "features")}
        layout = Layout(bool(card["sees_predictions"]), bool(card.get("knows_times", False)))
        tensors = load(path.read_bytes())
    except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
        raise InputError(
            f"policy {path}: cannot be read with its card ({error}); {AGAIN}"
        ) from None
    expected = {"format": FORMAT, "levels_mps2": list(LEVELS_MPS2), "features": features()}
    for key, value in expected.items():
        if found[key] != value:
            raise InputError(
                f"policy {path}: made for another {key} than this version has; {AGAIN}"
            )
    shapes = {name: one.shape for name, one in tensors.items()}
    if shapes != shapes_of(layout):
        raise InputError(f"policy {path}: its tensors are not of the shapes of the card; {AGAIN}")
    if not all(np.isfinite(one).all() for one in tensors.values()):
        raise InputError(f"policy {path}: its tensors are not finite; {AGAIN}")
    return Network(layout, tensors, card)
