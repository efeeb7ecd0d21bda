"""Whether the recordings of a split were driven on their maps: looked at before anything is cut."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Final

from hatn_sim.learn.sources import named
from hatn_sim.learn.split import PARTS, Split, Traffic
from hatn_sim.learn.watch import Watch
from hatn_sim.traffic import found_out, open_traffic

STAGE: Final = "maps and tracks"
MOST_SAID: Final = 3


def with_doubts(split: Split, watch: Watch) -> Split:
    """The split, each of its recordings with what speaks against its map; some of it is said.

    Raises HatnSimError, in one line that names the recording, where files are at fault or the map
    is of another place; those to test on are looked at too.
    """
    on_maps = [one for part in PARTS for one in split.part(part) if _of_map(one)]
    doubts: dict[int, tuple[str, ...]] = {}
    for done, one in enumerate(on_maps):
        watch.step(STAGE, done, len(on_maps), one.name)
        doubts[id(one)] = _doubts(one)
    if on_maps:
        watch.step(STAGE, len(on_maps), len(on_maps), "looked at")
    _say(list(dict.fromkeys(doubt for some in doubts.values() for doubt in some)), watch)
    parts = {
        part: tuple(replace(one, doubts=doubts.get(id(one), ())) for one in split.part(part))
        for part in PARTS
    }
    return Split(**parts)


def _of_map(traffic: Traffic) -> bool:
    recorded = traffic.scenario.recorded
    return recorded is not None and recorded.map_path is not None


def _doubts(traffic: Traffic) -> tuple[str, ...]:
    """What is known with the first frame, for which tracks are read to the end."""
    with named(traffic), closing(open_traffic(traffic.scenario)) as simulator:
        simulator.reset(traffic.seed)
        return tuple(found_out(simulator).get("doubts", ()))


def _say(doubts: Sequence[str], watch: Watch) -> None:
    for doubt in doubts[:MOST_SAID]:
        watch.say(doubt)
    if len(doubts) > MOST_SAID:
        watch.say(f"and {len(doubts) - MOST_SAID} more doubts about maps")
