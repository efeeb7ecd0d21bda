"""A small learned scorer of candidate lines (METHOD section 1.1): features in, nats out.

A conditional logit with one hidden layer: the candidates of a vehicle are held against each other
by a softmax, so that it learns from choices anywhere and is used anywhere. NumPy only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import FloatArray
from hatn_sim.errors import InputError
from hatn_sim.line_features import FEATURES, HAND_MADE
from hatn_sim.resources import weights_dir
from hatn_sim.whole_file import save_whole

FORMAT: Final = 1
SHIPPED: Final = "line_choice.json"
DIGITS: Final = 6
"""Decimals of the numbers in files."""


@dataclass(frozen=True, eq=False)
class LineChoice:
    """Weights of the scorer: F features, H hidden units."""

    linear: FloatArray  # [F] nats of each feature
    hidden: FloatArray  # [F, H]
    bias: FloatArray  # [H]
    out: FloatArray  # [H]

    def nats(self, features: FloatArray) -> FloatArray:
        """-log likelihood [Q], up to what a vehicle's candidates share, of features [Q, F]."""
        units = squash(features) @ self.hidden + self.bias
        units /= 1.0 + np.abs(units)
        score: FloatArray = features @ self.linear + units @ self.out
        return score

    @property
    def sha256(self) -> str:
        """The same for the same weights."""
        arrays = self.to_arrays()
        return hashlib.sha256(
            b"".join(arrays[name].tobytes() for name in sorted(arrays))
        ).hexdigest()

    def to_arrays(self) -> dict[str, FloatArray]:
        """The weights by name, for `from_arrays`."""
        return {name: values.copy() for name, values in asdict(self).items()}

    @staticmethod
    def from_arrays(arrays: Mapping[str, Any], where: object = "line choice") -> LineChoice:
        """The choice of what `to_arrays` gave, or of lists with the same numbers.

        Raises InputError, which begins with `where`, for missing arrays, shapes that do not fit
        the features of this version, and numbers that are not finite.
        """
        names = ("linear", "hidden", "bias", "out")
        missing = [name for name in names if name not in arrays]
        if missing:
            raise InputError(f"{where}: no {', '.join(missing)}; fit the choice of lines again")
        try:
            parts = {name: np.array(arrays[name], dtype=np.float64) for name in names}
        except (TypeError, ValueError) as error:
            raise InputError(f"{where}: weights are no numbers ({error}); fit again") from error
        units = parts["out"].size
        shapes = ((len(FEATURES),), (len(FEATURES), units), (units,), (units,))
        for (name, values), shape in zip(parts.items(), shapes, strict=True):
            if values.shape != shape or not np.isfinite(values).all():
                raise InputError(
                    f"{where}: {name} must be {list(shape)} finite numbers, found "
                    f"{list(values.shape)}; fit the choice of lines again"
                )
        return LineChoice(**parts)


def squash(features: FloatArray) -> FloatArray:
    """Features [Q, F] as the hidden layer reads them: likelihoods may be very large."""
    out = features.copy()
    out[:, : len(HAND_MADE)] = np.log1p(features[:, : len(HAND_MADE)])
    return out


def _by_hand() -> LineChoice:
    linear = np.zeros(len(FEATURES))
    linear[: len(HAND_MADE)] = 1.0
    return LineChoice(linear, np.zeros((len(FEATURES), 0)), np.zeros(0), np.zeros(0))


HAND_MADE_CHOICE: Final = _by_hand()
"""The likelihoods of motion, blinker and habit, taken at their word."""


def save_line_choice(path: Path, choice: LineChoice, card: Mapping[str, Any]) -> None:
    """Write a choice with a card that says how it was made. Raises as `save_whole`."""
    weights = {name: np.round(one, DIGITS).tolist() for name, one in choice.to_arrays().items()}
    content = {"format": FORMAT, "features": list(FEATURES), "card": dict(card), "weights": weights}
    save_whole(path, json.dumps(content, indent=1) + "\n")


def load_line_choice(path: Path) -> LineChoice:
    """The choice in a file. Raises InputError where it is not one of this version's."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a choice of lines ({error})") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{path}: expected a choice of lines of format {FORMAT}; fit it again")
    if content.get("features") != list(FEATURES):
        raise InputError(f"{path}: made for other features than this version's; fit it again")
    return LineChoice.from_arrays(content.get("weights", {}), path)


@cache
def shipped_line_choice() -> LineChoice:
    """The choice that comes with the package, the same object every time."""
    return load_line_choice(weights_dir() / SHIPPED)
