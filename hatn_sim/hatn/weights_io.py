"""Weights: safetensors with a JSON card beside them that says how they were made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from hatn_sim.errors import InputError
from hatn_sim.hatn.edn import EdnSettings, EncoderDecoderNetwork
from hatn_sim.hatn.sgn import SemanticGraphNetwork, SgnSettings

FORMAT: Final = 1


@dataclass(frozen=True, eq=False)
class Weights:
    """Both networks, ready to predict, with the card and the hash of the file."""

    sgn: SemanticGraphNetwork
    edn: EncoderDecoderNetwork
    card: Mapping[str, Any]
    sha256: str


def save_weights(
    path: Path, sgn: SemanticGraphNetwork, edn: EncoderDecoderNetwork, card: Mapping[str, Any]
) -> None:
    """Write `path` (.safetensors) and its card (.json)."""
    tensors = {f"sgn.{k}": v.contiguous() for k, v in sgn.state_dict().items()}
    tensors |= {f"edn.{k}": v.contiguous() for k, v in edn.state_dict().items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file(tensors, path)
    whole = {
        "format": FORMAT,
        "sgn": asdict(sgn.settings),
        "edn": asdict(edn.settings),
        **card,
    }
    path.with_suffix(".json").write_text(json.dumps(whole, indent=2) + "\n", encoding="utf-8")


def load_weights(path: Path) -> Weights:
    """Networks from a weight file. InputError where it is missing, corrupt or of another format."""
    card_path = path.with_suffix(".json")
    for needed in (path, card_path):
        if not needed.is_file():
            raise InputError(
                f"weights {path}: no file {needed.name} there; give a .safetensors file that "
                "`hatn-sim train` wrote, with the .json card beside it"
            )
    try:
        card = json.loads(card_path.read_text(encoding="utf-8"))
        found = card["format"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"weights card {card_path}: not a card ({error}); train again with `hatn-sim train`"
        ) from None
    if found != FORMAT:
        raise InputError(
            f"weights {path}: format {found}, this version reads format {FORMAT}; "
            "train again with `hatn-sim train`"
        )
    try:
        sgn = SemanticGraphNetwork(SgnSettings(**card["sgn"]))
        edn = EncoderDecoderNetwork(EdnSettings(**card["edn"]))
        tensors = load_file(path)
        sgn.load_state_dict(_part(tensors, "sgn."))
        edn.load_state_dict(_part(tensors, "edn."))
    except (SafetensorError, RuntimeError, TypeError, KeyError, OSError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"weights {path}: cannot be read as the networks of its card ({reason[:160]}); "
            "copy the file again or train again with `hatn-sim train`"
        ) from None
    sgn.eval()
    edn.eval()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return Weights(sgn=sgn, edn=edn, card=card, sha256=digest)


def _part(tensors: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
