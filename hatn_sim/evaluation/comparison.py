"""Alert rules side by side, at equal false-alarm rate, for each scene and over all of them."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import Score
from hatn_sim.score.assessed import AssessedRun
from hatn_sim.score.assistance import (
    ORACLE,
    alert_scores,
    counterfactual_scores,
    rare_s,
    suggestion_scores,
    warned,
)
from hatn_sim.score.sweep import Operating, operating, sharpest_within, sweep, thresholds_of

OURS: Final = "hatn"
FIXED: Final = {"always": 0.5, "never": 0.5}
"""Rules without a threshold to choose, whose dangers are 1."""
ALL: Final = "all"

Curves = Mapping[str, Mapping[str, Sequence[Operating]]]
"""Scene -> rule -> the rule at each of its thresholds."""


def curves_of(
    runs: Sequence[AssessedRun], settings: AssistSettings | None = None
) -> dict[str, dict[str, list[Operating]]]:
    """Every rule with a threshold, swept, for each scene and all together."""
    return {
        scene: {
            rule: sweep(of_scene, rule, thresholds_of(of_scene, rule), settings)
            for rule in of_scene[0].traces
            if rule not in FIXED
        }
        for scene, of_scene in by_scene(runs).items()
    }


def compare_rules(
    runs: Sequence[AssessedRun],
    curves: Curves | None = None,
    settings: AssistSettings | None = None,
) -> list[Score]:
    """The measures of every rule, for each scene and risk profile and pooled over each.

    Ours is at the threshold of the settings, the others where they recall most at no more false
    alarms than ours in the same scene; see `score.sweep`.
    """
    settings = settings or AssistSettings()
    curves = curves_of(runs, settings) if curves is None else curves
    rare = rare_s(runs)
    scores: list[Score] = []
    for scene, of_scene in by_scene(runs).items():
        rules = list(of_scene[0].traces)
        thresholds = {rule: FIXED.get(rule, np.inf) for rule in (*rules, ORACLE)}
        if OURS in rules:
            thresholds[OURS] = settings.alert_onset
            ours = operating(of_scene, OURS, settings.alert_onset, settings)
            rate = ours.false_alarms_per_hour
            for rule, curve in curves[scene].items():
                if rule != OURS:
                    best = sharpest_within(of_scene, rule, curve, rate, settings)
                    thresholds[rule] = np.inf if best is None else best.threshold
        for risk, chosen in by_risk(of_scene).items():
            for rule, threshold in thresholds.items():
                found = warned(chosen, rule, threshold, rare, settings)
                scores += alert_scores(found, rule, scene, risk)
            scores += suggestion_scores(chosen, OURS, scene, risk)
            scores += counterfactual_scores(chosen, OURS, scene, risk)
    return scores


def by_scene(runs: Sequence[AssessedRun]) -> dict[str, list[AssessedRun]]:
    """The runs of each scene, and where there are several, of all."""
    names = dict.fromkeys(run.scene for run in runs)
    scenes = {name: [run for run in runs if run.scene == name] for name in names}
    return {**scenes, ALL: list(runs)} if len(scenes) > 1 else scenes


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
