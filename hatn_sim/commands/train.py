"""Train HATN: simulate traffic, then the semantic graph network, then the encoder-decoder network.

Writes a .safetensors file and beside it a .json card that says how the weights were made. The
seeds of --tune decide which epoch is kept; neither they nor --seeds may judge the result.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hatn_sim.commands.options import names, seconds, seeds, whole_number

EXAMPLES = """example:
  hatn-sim train --out my.safetensors

The command that made the weights that ship is in their card, hatn_sim/hatn/weights/hatn.json.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim train`."""
    parser.add_argument(
        "--scenes",
        type=names,
        default=("intersection5",),
        metavar="A,B",
        help="scenes to learn from (default: intersection5)",
    )
    parser.add_argument(
        "--seeds", type=seeds, default=tuple(range(1, 13)), metavar="A-B", help="(default: 1-12)"
    )
    parser.add_argument(
        "--tune",
        type=seeds,
        default=(101, 102),
        metavar="A-B",
        help="seeds that choose the epoch (default: 101-102)",
    )
    parser.add_argument(
        "--duration",
        type=seconds,
        default=600.0,
        metavar="S",
        help="seconds of traffic for each seed (default: 600)",
    )
    parser.add_argument(
        "--risks",
        type=names,
        default=("courteous",),
        metavar="A,B",
        help="risk profiles, the seeds taking them in turn (default: courteous)",
    )
    parser.add_argument("--density", default="normal", metavar="light|normal|dense")
    parser.add_argument("--sgn-epochs", type=whole_number, default=20, metavar="N")
    parser.add_argument("--edn-epochs", type=whole_number, default=20, metavar="N")
    parser.add_argument("--workers", type=whole_number, default=2, metavar="N", help="processes")
    parser.add_argument(
        "--torch-seed", type=int, default=0, metavar="N", help="0 or more (default: 0)"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.safetensors")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def main(arguments: argparse.Namespace) -> int:
    """Train and say what came out."""
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import InputError

    out: Path = arguments.out
    if out.suffix != ".safetensors":
        raise InputError(f"--out {out}: expected a name that ends in .safetensors")
    for file in (out, out.with_suffix(".json")):
        if file.exists():
            raise InputError(
                f"--out {out}: {file.name} exists already; choose another name or remove it"
            )
    for scene in arguments.scenes:
        simulator = load_scenario(scene).simulator
        if simulator != "sumo":
            raise InputError(
                f"--scenes {scene}: training simulates with SUMO, found a scene of {simulator}; "
                "choose another scene"
            )
        for risk in arguments.risks:
            load_scenario(scene, arguments.density, risk)

    from hatn_sim.learn.train import TrainingPlan, train

    plan = TrainingPlan(
        scenes=arguments.scenes,
        seeds=arguments.seeds,
        tune_seeds=arguments.tune,
        duration_s=arguments.duration,
        risks=arguments.risks,
        density=arguments.density,
        sgn_epochs=arguments.sgn_epochs,
        edn_epochs=arguments.edn_epochs,
        seed=arguments.torch_seed,
        workers=arguments.workers,
    )

    def say(line: str) -> None:
        if not arguments.quiet:
            print(line, file=sys.stderr, flush=True)

    card = train(plan, out, _command(arguments), say)
    figures = ", ".join(f"{name} {value:.4f}" for name, value in card["tune_figures"].items())
    print(f"{out}: {card['samples']:,} samples; on the tuning seeds {figures}")
    return 0


def _command(arguments: argparse.Namespace) -> str:
    return (
        f"hatn-sim train --scenes {','.join(arguments.scenes)} "
        f"--seeds {_spans(arguments.seeds)} --tune {_spans(arguments.tune)} "
        f"--duration {arguments.duration:g} --risks {','.join(arguments.risks)} "
        f"--density {arguments.density} --sgn-epochs {arguments.sgn_epochs} "
        f"--edn-epochs {arguments.edn_epochs} --workers {arguments.workers} "
        f"--torch-seed {arguments.torch_seed} --out {arguments.out.name}"
    )


def _spans(numbers: tuple[int, ...]) -> str:
    """1, 2, 3, 7 -> "1-3,7"."""
    parts: list[str] = []
    start = last = numbers[0]
    for number in (*numbers[1:], None):
        if number is not None and number == last + 1:
            last = number
            continue
        parts.append(f"{start}" if start == last else f"{start}-{last}")
        if number is not None:
            start = last = number
    return ",".join(parts)
