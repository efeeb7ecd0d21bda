"""What `run.json` says of how a run was made."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hatn_sim.commands.options import scene_words

if TYPE_CHECKING:
    from hatn_sim.assist.settings import AssistSettings
    from hatn_sim.config import RecordedSource, Scenario
    from hatn_sim.datatypes import Predictor


def make_header(
    arguments: argparse.Namespace,
    scenario: Scenario,
    predictors: Sequence[Predictor],
    choice_from: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What `run.json` says of how the run was made, without paths of this machine's folders.

    `choice_from`: what chose among the lines of recorded tracks; None: what the weights carry.
    """
    from hatn_sim.commands.versions import installed

    hashes = {
        predictor.name: getattr(getattr(predictor, "weights", None), "sha256", None)
        for predictor in predictors
    }
    return {
        "scene": scenario.name,
        "title": scenario.title or scenario.name,
        "seed": arguments.seed,
        "adapt": arguments.adapt,
        "settings": {
            **_recorded_settings(scenario, choice_from or {"source": "weights"}),
            "duration_s": arguments.duration,
            "warm_up_s": arguments.warm_up,
            "predictor": predictors[0].name,
            "compare": [predictor.name for predictor in predictors[1:]],
            "lines": arguments.lines,
            "egos": None if arguments.egos is None else list(arguments.egos),
            "assist": _assist_settings(arguments.assist),
            "counterfactuals": _counterfactual_settings(arguments),
            "density": scenario.density,
            "risk": scenario.risk,
            "drive": arguments.drive,
            "agent": arguments.agent,
        },
        "versions": installed(),
        "weights_sha256": {name: value for name, value in hashes.items() if value is not None},
        "trained_on": trained_on(predictors[0]),
        "command": _command(arguments, scenario),
    }


def _assist_settings(settings: AssistSettings) -> dict[str, Any]:
    """The settings, without the folder of the network."""
    from hatn_sim.assist.settings import NETWORK

    return {**asdict(settings), NETWORK: Path(settings.danger_network).name}


def _counterfactual_settings(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """The rate, how advice is driven and what costs weigh."""
    if arguments.counterfactuals is None:
        return None
    from hatn_sim.score.counterfactual import CounterfactualSettings

    return {"rates": asdict(arguments.counterfactuals), **asdict(CounterfactualSettings())}


def trained_on(predictor: Predictor) -> list[str]:
    """Scenes and sites that its weights were trained or tuned on, and those that they began with.

    As their card says; none where there is no card.
    """
    card = getattr(getattr(predictor, "weights", None), "card", {})
    return sorted(_learnt_from(card))


def _learnt_from(card: Mapping[str, Any]) -> set[str]:
    split = card.get("split", {})
    used = [*split.get("train", []), *split.get("tune", [])]
    names = {str(entry.get("scene") or entry.get("site")) for entry in used}
    start = card.get("start")
    return names if start is None else names | _learnt_from(start)


def _recorded_settings(scenario: Scenario, choice_from: Mapping[str, Any]) -> dict[str, Any]:
    if scenario.recorded is None:
        return {}
    source = scenario.recorded
    return {
        "tracks": [path.name for path in source.tracks],
        "map": None if source.map_path is None else source.map_path.name,
        "recordings": list(source.recordings),
        "net": None if source.replay is None else source.replay.net_path.name,
        "react_from_s": None if source.replay is None else source.replay.react_from_s,
        "lines_from": lines_from(source),
        "choice_from": dict(choice_from),
    }


def lines_from(source: RecordedSource) -> dict[str, Any]:
    """What the reference lines of recorded traffic follow."""
    if source.drawn is None:
        return {"source": "lanes"}
    return {
        "source": "tracks",
        "recordings": list(source.drawn.recordings),
        "vehicles": source.drawn.vehicles,
        "sha256": source.drawn.sha256,
    }


def _command(arguments: argparse.Namespace, scenario: Scenario) -> str:
    words = ["hatn-sim", "run", *scene_words(arguments)]
    if arguments.seed is not None:
        words += ["--seed", str(arguments.seed)]
    if arguments.duration is not None:
        words += ["--duration", f"{arguments.duration:g}"]
    words += ["--warm-up", f"{arguments.warm_up:g}"]
    words += ["--predictor", arguments.predictor, "--lines", arguments.lines]
    if arguments.weights is not None:
        words += ["--weights", str(arguments.weights)]
    if arguments.adapt != "none":
        words += ["--adapt", arguments.adapt]
    if arguments.compare:
        words += ["--compare", ",".join(arguments.compare)]
    if arguments.egos is not None:
        words += ["--egos", ",".join(arguments.egos)]
    if arguments.acts_on_advice:
        words.append("--assist")
    if arguments.assist_settings is not None:
        words += ["--assist-settings", str(arguments.assist_settings)]
    if arguments.counterfactuals is not None:
        judged = arguments.counterfactuals
        words += ["--counterfactuals", f"{judged.alerts:g},{judged.suggestions:g}"]
    if arguments.net is not None:
        words += ["--net", str(arguments.net)]
    if arguments.react_from is not None:
        words += ["--react-from", f"{arguments.react_from:g}"]
    if arguments.drive is not None:
        words += ["--drive", arguments.drive, "--agent", arguments.agent]
    if scenario.recorded is not None and scenario.recorded.map_path is not None:
        words += ["--lines-from", arguments.lines_from, "--choice-from", arguments.choice_from]
    if scenario.density is not None:
        words += ["--density", scenario.density]
    if scenario.risk is not None:
        words += ["--risk", scenario.risk]
    return shlex.join(words)
