"""Danger networks of all runs, and what networks say of runs that they were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from hatn_sim.assist.danger import SIGNS_OF
from hatn_sim.assist.danger_network import DangerNetwork
from hatn_sim.learn.danger import fit_danger
from hatn_sim.score.assessed import AssessedRun

FOLDS: Final = 3


def fit_all(runs: Sequence[AssessedRun]) -> dict[str, DangerNetwork] | None:
    """The network of each rule that has one; None: there was no event to learn from."""
    found = {rule: fit_danger(runs, rule) for rule in SIGNS_OF}
    networks = {rule: network for rule, network in found.items() if network is not None}
    return networks if len(networks) == len(found) else None


def held_out_runs(runs: Sequence[AssessedRun], rule: str) -> list[AssessedRun]:
    """The runs, each with the trace of a network that was fitted to other seeds.

    Runs without any event to learn from in the other seeds are left out.
    """
    seeds = sorted({run.seed for run in runs})
    judged: list[AssessedRun] = []
    for fold in range(FOLDS):
        own = set(seeds[fold::FOLDS])
        network = fit_danger([run for run in runs if run.seed not in own], rule)
        if network is not None:
            judged += [
                replace(run, traces={rule: run.signs[rule].dangers(network)})
                for run in runs
                if run.seed in own
            ]
    return judged
