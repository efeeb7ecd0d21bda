"""Weights: safetensors with a JSON card beside them that says how they were made.

Tensors mean something only together with the settings of their networks, the order of their inputs
and the scales these are divided by. The card carries all three, and nothing else is loaded.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args, get_origin, get_type_hints

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, HORIZON_FRAMES
from hatn_sim.errors import InputError
from hatn_sim.graph import CONTEXT
from hatn_sim.hatn import edn as edn_module
from hatn_sim.hatn import edn_kinematic, edn_plain, kinematics
from hatn_sim.hatn import sgn as sgn_module
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.inputs import HISTORY, LINE_AT_M
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.line_choice import LineChoice
from hatn_sim.line_features import FEATURES
from hatn_sim.whole_file import beside, save_whole

FORMAT: Final = 4
RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "width": (1, 4096),
    "components": (1, 64),
    "class_weight": (0.0, 1e6),
    "dropout": (0.0, 1.0),
    "race_dropout": (0.0, 1.0),
    "history_stride": (1, HISTORY_FRAMES),
    "graph_layers": (1, 8),
    "heads": (1, 16),
    "ego_weight": (0.0, 1e6),
    "goal_l1_weight": (0.0, 1e6),
    "label_smoothing": (0.0, 1.0),
}
"""What each setting that is a number may be, both ends included."""
AGAIN: Final = "train again with `hatn-sim train`"

START: Final = "start"
"""In a card: of the weights that the networks began with; None: chance."""
LISTS: Final = ("seeds", "recordings", "runs", "sha256", "doubts")
"""Of an entry of a card's split ..."""
OF_CASES: Final = ("files", "cases")
"""... and of one of its recordings, where some cases were chosen."""
OF_LINES: Final = "line_choice."
"""Begins the names of the tensors of a choice of lines."""
_CHOICES: Final[dict[str, LineChoice]] = {}
"""Those that were read, by their hash."""

Settings = TypeVar("Settings", SgnSettings, EdnSettings)


@dataclass(frozen=True, eq=False)
class Weights:
    """Both networks, ready to predict, with the card and the hash of the file."""

    sgn: SemanticGraphNetwork
    edn: EncoderDecoderNetwork
    card: Mapping[str, Any]
    sha256: str
    line_choice: LineChoice | None = None  # that they were trained with; None: the one that ships


def features() -> dict[str, Any]:
    """What the networks of this version read and write: names in order, scales and bounds."""
    return {
        "context": list(CONTEXT),
        "feature_scale": list(sgn_module.FEATURE_SCALE),
        "context_scale": list(sgn_module.CONTEXT_SCALE),
        "history": list(HISTORY),
        "line_at_m": LINE_AT_M.tolist(),
        "goal_scale_m": [sgn_module.GOAL_SCALE_M, edn_module.GOAL_SCALE_M],
        "queued_penalty": sgn_module.QUEUED_PENALTY,
        "race_per_s": sgn_module.RACE_PER_S,
        "race_per_gate": sgn_module.RACE_PER_GATE,
        "plain_scales": [
            edn_plain.ALIGNED_SCALE_M,
            edn_plain.MAP_SCALE_M,
            edn_plain.SPEED_SCALE_MPS,
        ],
        "kinematic_limits": [
            edn_kinematic.MAX_JERK_MPS3,
            *edn_kinematic.ACCELERATION_MPS2,
            edn_kinematic.MAX_SWERVE_PER_M,
            edn_kinematic.MAX_SLOPE,
            *edn_kinematic.START_LIMITS,
            edn_kinematic.BLEND_M,
            edn_kinematic.BLEND_S,
            *edn_kinematic.GAP_AT_S,
            edn_kinematic.GAP_M,
            kinematics.MAX_CURVATURE_PER_M,
            kinematics.MAX_LATERAL_MPS2,
            kinematics.SLOW_M,
            kinematics.SHORT_M,
        ],
        "frames": [HISTORY_FRAMES, HORIZON_FRAMES],
        "dt_s": DT_S,
    }


def card_of(
    sgn: SemanticGraphNetwork, edn: EncoderDecoderNetwork, card: Mapping[str, Any]
) -> dict[str, Any]:
    """The whole card of two networks: `card`, with what the tensors' meaning hangs on.

    Format, settings and features are always those of the networks, whatever `card` says of them.
    """
    own = {
        "format": FORMAT,
        "sgn": asdict(sgn.settings),
        "edn": asdict(edn.settings),
        "features": features(),
    }
    return own | {key: value for key, value in card.items() if key not in own}


def save_weights(
    path: Path,
    sgn: SemanticGraphNetwork,
    edn: EncoderDecoderNetwork,
    card: Mapping[str, Any],
    line_choice: LineChoice | None = None,
) -> None:
    """Write `path` (.safetensors) and its card (.json), each whole or not at all.

    `line_choice`: how lines were chosen for what the networks learnt from, if not as everywhere.
    InputError where the folder cannot be written.
    """
    tensors = {name: value.contiguous() for name, value in _pair(sgn, edn).state_dict().items()}
    if line_choice is not None:
        tensors |= choice_tensors(line_choice)
        card = {**card, "line_features": list(FEATURES)}
    text = json.dumps(card_of(sgn, edn, card), indent=2) + "\n"
    make_folder(path)
    save_whole(path.with_suffix(".json"), text)
    save_whole(path, save(tensors))


def make_folder(path: Path) -> None:
    """Make the folder of the file `path`. InputError where a file cannot be written there."""
    probe = beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(
            f"weights {path}: cannot be written there: {error.strerror}; choose another folder"
        ) from None


def load_weights(path: Path) -> Weights:
    """Networks from a weight file.

    InputError where it or its card is missing, corrupt, of another format or for other features.
    """
    if path.is_dir():
        raise InputError(f"weights {path}: expected a .safetensors file, found a folder")
    card_path = path.with_suffix(".json")
    for needed in (path, card_path):
        if not needed.is_file():
            raise InputError(
                f"weights {path}: no file {needed.name} there; give a .safetensors file that "
                "`hatn-sim train` wrote, with the .json card beside it"
            )
    card = _read_card(path, card_path)
    sgn_settings = _settings(card_path, card, "sgn", SgnSettings)
    edn_settings = _settings(card_path, card, "edn", EdnSettings)
    try:
        data = path.read_bytes()
        tensors = load(data)
        of_lines = {name: tensors.pop(name) for name in [*tensors] if name.startswith(OF_LINES)}
        sgn, edn = SemanticGraphNetwork(sgn_settings), EncoderDecoderNetwork(edn_settings)
        _pair(sgn, edn).load_state_dict(tensors)
    except (SafetensorError, RuntimeError, ValueError, TypeError, KeyError, OSError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"weights {path}: cannot be read as the networks of its card ({reason[:160]}); "
            f"copy the file again or {AGAIN}"
        ) from None
    _check_finite(path, tensors | of_lines)
    choice = None
    if of_lines:
        if card.get("line_features") != list(FEATURES):
            raise InputError(
                f"weights {path}: made for other features of lines than this version has; {AGAIN}"
            )
        choice = choice_of(path, of_lines)
    return Weights(sgn.eval(), edn.eval(), card, hashlib.sha256(data).hexdigest(), choice)


def choice_tensors(choice: LineChoice) -> dict[str, Tensor]:
    """A choice of lines as tensors of a file."""
    return {OF_LINES + name: torch.from_numpy(one) for name, one in choice.to_arrays().items()}


def choice_of(path: Path, tensors: Mapping[str, Tensor]) -> LineChoice:
    """The choice of lines of `choice_tensors`, read from `path`.

    The same object for the same numbers, so that networks share what is perceived with it. Raises
    InputError where it is of another version.
    """
    arrays = {name.removeprefix(OF_LINES): one.numpy() for name, one in tensors.items()}
    choice = LineChoice.from_arrays(arrays, f"weights {path}")
    return _CHOICES.setdefault(choice.sha256, choice)


def _read_card(path: Path, card_path: Path) -> dict[str, Any]:
    try:
        card = json.loads(card_path.read_text(encoding="utf-8"))
        found = card["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"weights card {card_path}: not a card ({error}); {AGAIN}") from None
    if found != FORMAT:
        raise InputError(
            f"weights {path}: format {found}, this version reads format {FORMAT}; {AGAIN}"
        )
    here, there = features(), card.get("features")
    if there != here:
        known: Mapping[str, Any] = there if isinstance(there, dict) else {}
        other = [name for name in here | known if known.get(name) != here.get(name)]
        raise InputError(
            f"weights {path}: made for other features than this version has "
            f"({', '.join(other)} differ); {AGAIN}"
        )
    _check_made_from(card_path, card, "")
    return dict(card)


def _check_made_from(path: Path, card: Mapping[str, Any], where: str) -> None:
    """InputError where a card says in another form than ours what its weights were made from."""
    split, start = card.get("split", {}), card.get(START)
    entries = [split] if not isinstance(split, dict) else list(split.values())
    if not all(isinstance(part, list) and all(map(_is_entry, part)) for part in entries):
        raise InputError(
            f"weights card {path}: {where}split: expected lists of traffic by part, as "
            f"`hatn-sim train` writes them, found another form; restore the card or {AGAIN}"
        )
    if isinstance(start, dict):
        _check_made_from(path, start, f"{where}{START}.")
    elif start is not None:
        raise InputError(
            f"weights card {path}: {where}{START}: expected null or what `hatn-sim train` writes, "
            f"found {str(start)[:40]!r}; restore the card or {AGAIN}"
        )


def _is_entry(entry: Any) -> bool:
    """Whether it names traffic: seeds of a scene, recordings or runs of a site."""
    if not isinstance(entry, dict):
        return False
    recordings = entry.get("recordings", [])
    return (
        all(isinstance(entry.get(key, []), list) for key in LISTS)
        and all(isinstance(entry.get(key, ""), str | None) for key in ("scene", "site", "lines"))
        and all(
            isinstance(one, str)
            or (isinstance(one, dict) and all(isinstance(one.get(k), list) for k in OF_CASES))
            for one in recordings
        )
    )


def _settings(path: Path, card: Mapping[str, Any], network: str, kind: type[Settings]) -> Settings:
    """The settings of one network from the card: all of them, no others, each in its range."""
    found = card.get(network)
    names = [field.name for field in fields(kind)]
    if not isinstance(found, dict) or set(found) != set(names):
        given = ", ".join(map(str, found)) if isinstance(found, dict) else repr(found)
        raise InputError(
            f"weights card {path}: {network}: expected the settings {', '.join(names)}, "
            f"found {given or 'none'}; {AGAIN}"
        )
    wanted = get_type_hints(kind)
    for name in names:
        expected = unfit(found[name], wanted[name], RANGES.get(name))
        if expected:
            raise InputError(
                f"weights card {path}: {network}.{name}: expected {expected}, "
                f"found {found[name]!r}; {AGAIN}"
            )
    return kind(**found)


def unfit(value: object, wanted: Any, span: tuple[float, float] | None) -> str:
    """What was expected in place of a setting's value; "" where it is fit."""
    if get_origin(wanted) is Literal:
        known = get_args(wanted)
        fit = any(type(value) is type(one) and value == one for one in known)
        return "" if fit else "one of " + ", ".join(map(str, known))
    if wanted is bool or span is None:
        return "" if isinstance(value, bool) else "true or false"
    low, high = span
    types = int if wanted is int else (int, float)
    if isinstance(value, types) and not isinstance(value, bool) and low <= value <= high:
        return ""
    return f"{'a whole number' if wanted is int else 'a number'} from {low:g} to {high:g}"


def _check_finite(path: Path, tensors: Mapping[str, Tensor]) -> None:
    for name, value in tensors.items():
        if not bool(torch.isfinite(value).all()):
            raise InputError(f"weights {path}: {name} is not finite; {AGAIN}")


def _pair(sgn: SemanticGraphNetwork, edn: EncoderDecoderNetwork) -> nn.ModuleDict:
    """Both networks as one, whose tensors are named sgn.* and edn.*."""
    return nn.ModuleDict({"sgn": sgn, "edn": edn})
