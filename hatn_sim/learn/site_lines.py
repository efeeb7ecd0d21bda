"""A choice of lines fitted to the sites of recordings (METHOD section 1.1), kept with the weights.

It begins with the choice that ships and is drawn back to it, so that it stays good elsewhere. It
learns from the recordings to train on alone; those to tune on decide whether it is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from hatn_sim.errors import HatnSimError
from hatn_sim.evaluation.pool import Teller, work_on
from hatn_sim.learn.line_choice import choice_figures, fit_line_choice, right_candidates
from hatn_sim.learn.line_samples import ChoiceSamples, choice_samples, joined
from hatn_sim.learn.sources import named, played
from hatn_sim.learn.split import Split, Traffic
from hatn_sim.learn.watch import Watch, counted
from hatn_sim.line_choice import LineChoice, shipped_line_choice


@dataclass(frozen=True, eq=False)
class SiteChoice:
    """A choice of lines with what is to be said of it in the card of the weights."""

    choice: LineChoice
    card: Mapping[str, Any]


def fit_to_sites(split: Split, workers: int, watch: Watch) -> SiteChoice | None:
    """The choice for the sites of a split's recordings; None: that which ships is as good.

    Raises HatnSimError, in one line that names the traffic, where a recording is at fault.
    """
    parts = [[one for one in split.part(part) if _is_of_site(one)] for part in ("train", "tune")]
    if not all(parts):
        return None
    learn, tune = (_gather(part, workers, watch) for part in parts)
    start = shipped_line_choice()
    if not len(tune) or not right_candidates(tune)[1].any():
        return None
    try:
        fitted = fit_line_choice(learn, start)
    except HatnSimError:  # nobody was seen where lines part
        return None
    before, after = choice_figures(tune, start), choice_figures(tune, fitted)
    taken = after.log_loss < before.log_loss and after.wrong <= before.wrong
    watch.say(
        f"choice of lines, fitted to {len(learn):,} choices in {len(parts[0])} recordings: on the "
        f"tuning traffic {after}; the one that ships: {before}; the "
        f"{'fitted' if taken else 'shipped'} one is taken"
    )
    if not taken:
        return None
    card = {"cases": len(learn), "tune": after._asdict(), "tune_shipped": before._asdict()}
    return SiteChoice(fitted, card)


def _is_of_site(traffic: Traffic) -> bool:
    recorded = traffic.scenario.recorded
    return recorded is not None and recorded.map_path is not None


def _gather(traffic: Sequence[Traffic], workers: int, watch: Watch) -> ChoiceSamples:
    found: dict[int, ChoiceSamples] = {}
    tell = partial(watch.step, "choices of lines", total=len(traffic))
    show = counted(lambda words: tell(done=len(found), words=words))
    for number, samples in work_on(_cut, traffic, workers, show):
        found[number] = samples
        tell(done=len(found), words=f"{sum(map(len, found.values())):,} choices")
    return joined([found[number] for number in range(len(traffic))])


def _cut(traffic: Traffic, teller: Teller) -> ChoiceSamples:
    with named(traffic), played(traffic, teller.tell) as (simulator, frames):
        return choice_samples(simulator.road, frames, shipped_line_choice())
