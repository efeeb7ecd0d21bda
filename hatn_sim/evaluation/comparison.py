"""Alert rules side by side, at equal false-alarm rate and at equal recall.

For each scene, and pooled over those of each suite and over all that are of none.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import Score
from hatn_sim.resources import WITHOUT_EVENTS, suite_of_each_scene
from hatn_sim.score.assessed import AssessedRun
from hatn_sim.score.assistance import (
    AT_EQUAL_RECALL,
    FALSE_ALARMS,
    ORACLE,
    alert_scores,
    counterfactual_scores,
    rare_s,
    suggestion_scores,
    warned,
)
from hatn_sim.score.matching import SEVERE
from hatn_sim.score.sweep import (
    Operating,
    best_within,
    operating,
    quietest_at,
    sharpest,
    sweep,
    thresholds_of,
)

OURS: Final = "hatn"
FIXED: Final = {"always": 0.5, "never": 0.5}
"""Rules without a threshold to choose, whose dangers are 1."""
ALL: Final = "all"

Curves = Mapping[str, Mapping[str, Sequence[Operating]]]
"""Scene -> rule -> the rule at each of its thresholds."""


@dataclass(frozen=True)
class Thresholds:
    """Where rules are compared; without any events, only ours and fixed rules are there."""

    equal_rate: Mapping[str, float]  # infinite: no threshold has so few false alarms
    equal_recall: Mapping[str, float]  # only of rules that recall so much
    chosen_on: tuple[str, ...] = ()  # scenes, where not on the same runs


def curves_of(
    runs: Sequence[AssessedRun], settings: AssistSettings | None = None
) -> dict[str, dict[str, list[Operating]]]:
    """Every rule with a threshold, swept, for each scene and pool of scenes."""
    return {
        scene: _swept(of_scene, settings or AssistSettings())
        for scene, of_scene in by_scene(runs).items()
    }


def _swept(runs: Sequence[AssessedRun], settings: AssistSettings) -> dict[str, list[Operating]]:
    return {
        rule: sweep(runs, rule, thresholds_of(runs, rule), settings)
        for rule in runs[0].traces
        if rule not in FIXED
    }


def thresholds_by_scene(
    runs: Sequence[AssessedRun], curves: Curves, settings: AssistSettings
) -> dict[str, Thresholds]:
    """Where rules are compared in each scene and pool of scenes.

    Ours is at the threshold of the settings. The others are where they recall most at no more false
    alarms than ours, or raise fewest at no less recall, in the same runs; where these have no
    events to recall, or are not meant to have any, in all other runs that have.
    """
    groups = by_scene(runs)
    suites = suite_of_each_scene()
    telling = [run for run in runs if suites.get(run.scene) not in WITHOUT_EVENTS]
    with_events = {run.scene for run in telling if _has_events(run)}
    chosen: dict[str, Thresholds] = {}
    elsewhere: Thresholds | None = None
    for name, group in groups.items():
        if any(run.scene in with_events for run in group):
            chosen[name] = _chosen(group, curves[name], settings)
            continue
        if elsewhere is None:
            others = [run for run in telling if run.scene in with_events]
            curves_there = _swept(others, settings) if others else {}
            names = tuple(dict.fromkeys(run.scene for run in others))
            elsewhere = replace(_chosen(others, curves_there, settings), chosen_on=names)
        chosen[name] = elsewhere
    return chosen


def _has_events(run: AssessedRun) -> bool:
    low_s, high_s = run.window_s
    return any(
        one.tier in SEVERE and one.second_id is not None and low_s <= one.start_s < high_s
        for one in run.events
    )


def _chosen(
    runs: Sequence[AssessedRun],
    curves: Mapping[str, Sequence[Operating]],
    settings: AssistSettings,
) -> Thresholds:
    at = {**FIXED, ORACLE: np.inf}
    if OURS not in curves:
        return Thresholds({**at, OURS: settings.alert_onset}, {OURS: settings.alert_onset})
    ours = operating(runs, OURS, settings.alert_onset, settings)
    equal_rate, equal_recall = {**at, OURS: ours.threshold}, {OURS: ours.threshold}
    within = partial(best_within, false_alarms_per_hour=ours.false_alarms_per_hour)
    enough = partial(quietest_at, event_recall=ours.event_recall)
    for rule, curve in curves.items():
        if rule != OURS:
            best = sharpest(runs, rule, curve, within, settings)
            equal_rate[rule] = np.inf if best is None else best.threshold
            quietest = sharpest(runs, rule, curve, enough, settings)
            if quietest is not None:
                equal_recall[rule] = quietest.threshold
    return Thresholds(equal_rate, equal_recall)


def compare_rules(
    runs: Sequence[AssessedRun],
    thresholds: Mapping[str, Thresholds],
    settings: AssistSettings | None = None,
) -> list[Score]:
    """The measures of every rule, for each scene and risk profile and pooled over each.

    `thresholds` are those of `thresholds_by_scene`; a rule without one is left out.
    """
    settings = settings or AssistSettings()
    rare = rare_s(runs)
    scores: list[Score] = []
    for scene, of_scene in by_scene(runs).items():
        at = thresholds[scene]
        rules = [rule for rule in (*of_scene[0].traces, ORACLE) if rule in at.equal_rate]
        for risk, chosen in by_risk(of_scene).items():
            for rule in rules:
                found = warned(chosen, rule, at.equal_rate[rule], rare, settings)
                scores += alert_scores(found, rule, scene, risk)
                if rule in of_scene[0].traces and rule not in FIXED:
                    scores.append(
                        _at_equal_recall(chosen, rule, scene, risk, at.equal_recall, settings)
                    )
            scores += suggestion_scores(chosen, OURS, scene, risk)
            scores += counterfactual_scores(chosen, OURS, scene, risk)
    return scores


def _at_equal_recall(
    runs: Sequence[AssessedRun],
    rule: str,
    scene: str,
    risk: str,
    thresholds: Mapping[str, float],
    settings: AssistSettings,
) -> Score:
    """The false alarms of a rule where it recalls as much as ours; no value where it never does."""
    if rule not in thresholds:
        return Score(AT_EQUAL_RECALL, rule, scene, risk, "none", None, "1/h", 0, None, None)
    found = warned(runs, rule, thresholds[rule], settings=settings)
    (score,) = alert_scores(found, rule, scene, risk, (FALSE_ALARMS,))
    return replace(score, measure=AT_EQUAL_RECALL)


def by_scene(runs: Sequence[AssessedRun]) -> dict[str, list[AssessedRun]]:
    """The runs of each scene; where there are several of a suite, of it, and of none, of all."""
    suites = suite_of_each_scene()
    scenes: dict[str, list[AssessedRun]] = {}
    pools: dict[str, list[AssessedRun]] = {}
    for run in runs:
        scenes.setdefault(run.scene, []).append(run)
        pools.setdefault(suites.get(run.scene, ALL), []).append(run)
    several = {name: of for name, of in pools.items() if len({run.scene for run in of}) > 1}
    return scenes | several


def by_risk(runs: Sequence[AssessedRun]) -> dict[str, list[AssessedRun]]:
    """The runs of each risk profile, and where there are several, of all."""
    names = dict.fromkeys(run.risk for run in runs)
    profiles = {name or ALL: [run for run in runs if run.risk == name] for name in names}
    return {**profiles, ALL: list(runs)} if len(profiles) > 1 else profiles


def write_curves(path: Path, curves: Curves) -> None:
    """One line for each scene, rule and threshold; a field is empty where there is no number."""
    columns = ["scene", "rule", *(field.name for field in fields(Operating))]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for scene, of_rule in curves.items():
            for rule, curve in of_rule.items():
                for one in curve:
                    values = asdict(one).values()
                    writer.writerow([scene, rule, *("" if np.isnan(v) else v for v in values)])
