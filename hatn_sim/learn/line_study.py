"""Fits the choice of lines that ships, and tells how it does on scenes it was not fitted to.

`python -m hatn_sim.learn.line_study --out FILE` simulates, fits, prints and writes. Every run is
seen four ways: as simulated and with vehicles that stray as people do, with and without blinkers.
Each scene is judged by a choice that was not fitted to it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame, Lane
from hatn_sim.learn.line_choice import choice_figures, fit_line_choice
from hatn_sim.learn.line_samples import ChoiceSamples, choice_samples, joined
from hatn_sim.learn.strays import strayed
from hatn_sim.line_choice import HAND_MADE_CHOICE, save_line_choice
from hatn_sim.loop import warm_up
from hatn_sim.road import Road
from hatn_sim.traffic import open_traffic

SCENES: Final = (
    "intersection5",
    "learn_merge",
    "learn_priority4",
    "learn_roundabout3",
    "learn_roundabout5",
    "learn_signals4",
    "learn_tee3",
)
"""Fitted to; the other scenes that ship are for judging alone."""
TEST_SCENES: Final = (
    "intersection5",
    "intersection4_allway",
    "tjunction",
    "roundabout4_two_lane",
    "roundabout8",
)
SEEDS: Final = (51, 54)
TEST_SEED: Final = 57
DURATION_S: Final = 100.0
WARM_UP_S: Final = 60.0
WAYS: Final = (
    "as simulated",
    "without blinkers",
    "straying, some blinkers",
    "straying, no blinkers",
)
SIGNALLING: Final = 0.6
"""Share of straying drivers who signal, where some do."""


def main(words: Sequence[str] | None = None) -> int:
    """Simulate, fit, print, write."""
    parser = argparse.ArgumentParser(prog="python -m hatn_sim.learn.line_study")
    parser.add_argument("--out", type=Path, required=True, help="file of the choice and its card")
    arguments = parser.parse_args(words)
    torch.set_num_threads(1)
    learn = {scene: [samples_of(scene, seed) for seed in SEEDS] for scene in SCENES}
    every = joined([part for runs in learn.values() for ways in runs for part in ways])
    choice = fit_line_choice(every)
    told: list[dict[str, Any]] = []
    for scene in TEST_SCENES:
        others = [ways for name, runs in learn.items() if name != scene for ways in runs]
        elsewhere = (
            fit_line_choice(joined([part for ways in others for part in ways]))
            if scene in learn
            else choice
        )
        for way, part in zip(WAYS, samples_of(scene, TEST_SEED), strict=True):
            by_hand = choice_figures(part, HAND_MADE_CHOICE)
            learned = choice_figures(part, elsewhere)
            print(f"{scene:22s} {way:24s} by hand {by_hand}  learned elsewhere {learned}")
            told.append({"scene": scene, "way": way, "by_hand": by_hand, "learned": learned})
    card = {
        "made_by": "python -m hatn_sim.learn.line_study",
        "scenes": list(SCENES),
        "seeds": list(SEEDS),
        "duration_s": DURATION_S,
        "ways": list(WAYS),
        "cases": len(every),
        "test_seed": TEST_SEED,
        "figures": "of a choice not fitted to the scene: n, wrong, log_loss, ece",
        "left_out": [
            {**one, "by_hand": list(one["by_hand"]), "learned": list(one["learned"])}
            for one in told
        ],
    }
    save_line_choice(arguments.out, choice, card)
    print(f"written to {arguments.out}")
    return 0


def samples_of(scene: str, seed: int) -> list[ChoiceSamples]:
    """The samples of a run, seen in each of `WAYS`."""
    lanes, frames = _simulate(scene, seed)
    seen = (
        frames,
        [_without_blinkers(frame) for frame in frames],
        strayed(frames, seed, SIGNALLING),
        strayed(frames, seed + 1, 0.0),
    )
    return [choice_samples(Road(lanes), way) for way in seen]


def _simulate(scene: str, seed: int) -> tuple[list[Lane], list[Frame]]:
    risk = "assertive" if seed % 2 else "courteous"
    with closing(open_traffic(load_scenario(scene, None, risk))) as simulator:
        first = warm_up(simulator, simulator.reset(seed), round(WARM_UP_S / simulator.dt_s))

        def frames() -> Iterator[Frame]:
            yield first
            for _ in range(round(DURATION_S / simulator.dt_s)):
                yield simulator.step()

        return list(simulator.road.lanes.values()), list(frames())


def _without_blinkers(frame: Frame) -> Frame:
    scene = frame.scene
    return replace(frame, scene=replace(scene, blinker=np.zeros_like(scene.blinker)))


if __name__ == "__main__":
    raise SystemExit(main())
