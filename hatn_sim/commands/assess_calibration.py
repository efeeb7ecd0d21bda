"""`hatn-sim assess --calibrate`: the danger of a pair fitted anew, and the threshold of alerts."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.assess_runs import assist_settings

if TYPE_CHECKING:
    from hatn_sim.score.assessed import AssessedRun

SETTINGS_FILE: Final = "assist.toml"
NETWORK_FILE: Final = "danger.json"
SEVERE: Final = ("T1", "T2")
NO_EVENTS: Final = "no collision and no evasive braking in these runs"


def calibrate(arguments: argparse.Namespace, out: Path, runs: Sequence[AssessedRun]) -> int:
    """Fit, seek, write and tell; needs runs that keep signs (`AssessPlan.keeps_signs`)."""
    from hatn_sim.assist.danger import HATN
    from hatn_sim.assist.danger_network import write_danger_networks
    from hatn_sim.assist.settings import NETWORK
    from hatn_sim.commands.versions import installed
    from hatn_sim.errors import HatnSimError, InputError
    from hatn_sim.learn.danger_study import fit_all, held_out_runs
    from hatn_sim.score.sweep import best_within, operating, sharpest, sweep, thresholds_of
    from hatn_sim.whole_file import ROOM_OR_OUT, save_whole

    if len({run.seed for run in runs}) < 2:
        raise InputError(
            "--calibrate: expected two --seeds or more, since a threshold is sought on seeds that "
            "the danger was not fitted to; found one"
        )
    networks = fit_all(runs)
    if networks is None:
        raise HatnSimError(
            f"{NO_EVENTS}: there is nothing to calibrate by; add seeds, or --risk inattentive"
        )
    settings = assist_settings(arguments)
    judged = held_out_runs(runs, HATN)
    curve = sweep(judged, HATN, thresholds_of(judged, HATN), settings)
    within = partial(best_within, false_alarms_per_hour=arguments.false_alarms)
    best = sharpest(judged, HATN, curve, within, settings)
    if best is None:
        raise HatnSimError(
            f"no threshold keeps within {arguments.false_alarms:g} false alarms per vehicle-hour; "
            "allow more with --false-alarms, or add runs"
        )
    # Rounded up, so that what is written is as strict; the figures told are those of it.
    onset = math.ceil(1000.0 * best.threshold) / 1000.0
    best = operating(judged, HATN, onset, settings)
    release = settings.alert_end / settings.alert_onset
    found = replace(settings, alert_onset=onset, alert_end=round(release * onset, 4))
    card = {
        "scenes": sorted({run.scene for run in runs}),
        "profiles": sorted({run.risk for run in runs}),
        "seeds": sorted({run.seed for run in runs}),
        "vehicle_hours": round(sum(run.vehicle_hours for run in runs), 2),
        "events": sum(one.tier in SEVERE for run in runs for one in run.events),
        "versions": installed(),
    }
    write_danger_networks(out / NETWORK_FILE, networks, card)
    path = out / SETTINGS_FILE
    values = {field.name: getattr(found, field.name) for field in fields(found)}
    lines = [f"{key} = {value}" for key, value in values.items() if key != NETWORK]
    lines.append(f'{NETWORK} = "{NETWORK_FILE}"')
    save_whole(path, "\n".join(lines) + "\n", ROOM_OR_OUT)
    print(
        f"alerts from a danger of {onset:g} on: {best.false_alarms_per_hour:.2f} false "
        f"alarms per vehicle-hour, {_percent(best.event_recall)} of events preceded by an alert, "
        f"{_percent(best.recall_1s5)} by 1.5 s or more (on runs that the network was not fitted "
        f"to); settings in {path}, the network in {out / NETWORK_FILE}"
    )
    return 0


def _percent(share: float) -> str:
    return "none" if math.isnan(share) else f"{100.0 * share:.1f} %"
