"""The alert rules that are compared, by name: each says how dangerous every pair is now.

The oracle is not among them: it knows the future (see `score.dangers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from hatn_sim.assist.baselines import RULES
from hatn_sim.assist.moment import AlertRule
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.errors import InputError, nearest

THRESHOLDS: Final = {"hatn": AssistSettings().alert_onset_mps2, "always": 0.5, "never": 0.5}
"""Rule -> the danger at which its alerts begin."""


def chosen_rules(names: Sequence[str]) -> dict[str, AlertRule]:
    """The rules of these names. Raises InputError where there is none."""
    for name in names:
        if name not in RULES:
            raise InputError(f"--rules: unknown rule {name!r}{nearest(name, RULES)}")
    return {name: RULES[name] for name in names}
