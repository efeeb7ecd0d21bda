"""What an assessed run comes of besides what was asked for: a scene's files, our own source."""

from __future__ import annotations

import hashlib
from typing import Final

from hatn_sim.config import Scenario
from hatn_sim.content import content_hash
from hatn_sim.kept import source_without
from hatn_sim.learn.scene_files import files_of

NO_PART_IN_RUNS: Final = (
    "_data/",
    "bench",
    "cli",
    "commands/",
    "envs",
    "evaluation/closed_loop",
    "evaluation/comparison",
    "learn/",
    "report/",
    "score/assistance",
    "score/closed_loop",
    "score/intervals",
    "score/matching",
    "score/sweep",
)
"""Beginnings of the package's files that look at finished runs, or have nothing to do with them."""
NO_PART_IN_DRIVES: Final = (
    *("_data/", "bench", "cli", "commands/", "envs", "evaluation/assessing"),
    *("evaluation/comparison", "learn/", "report/", "score/closed_loop_scores"),
)
"""The same of drives in closed loop."""
SHOWN: Final = 12
"""Digits of a hash that people are shown."""


def made_by(scenario: Scenario, left_out: tuple[str, ...] = NO_PART_IN_RUNS) -> dict[str, str]:
    """Hashes, named for people: a run that is there is used again only where they are the same.

    `left_out` are beginnings of the package's files that have no part in the run.
    """
    files = "".join(f"{path.name} {content_hash(path)}\n" for path in files_of(scenario))
    return {
        "files of the scene": hashlib.sha256(files.encode()).hexdigest()[:SHOWN],
        "source of hatn_sim": source_without(left_out)[:SHOWN],
    }
