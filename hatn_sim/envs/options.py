"""What can be set of an environment: one frozen object, every key and value checked.

| option | default | meaning |
|---|---|---|
| `scene` | (of `Scene-v0`: required) | name of a scene, a scenario.toml, a .sumocfg, a run's \
folder, the id of an environment of highway-env, or a `Scenario` |
| `tracks`, `map` | none | recorded tracks and their map, in place of a scene |
| `net` | none | SUMO net of a recording: the ego is driven in it, among those who were recorded |
| `density`, `risk` | of the scene | how much traffic, and who drives |
| `predictor` | `"hatn"` | name, `module:Class`, or a predictor; None: nothing is predicted |
| `lines` | `"inferred"` | `"route"`: the predictor is told everybody's route, an upper bound |
| `advice` | True | suggestions and alerts for the ego are in `info`; without them a step is \
faster |
| `ego` | by the scene | `"spawned"`: one more vehicle `ego` (in highway-env its own); \
`"taken_over"`: one of those who come anyhow, the only choice in recordings |
| `ego_id` | none | whom to take over; None: whoever comes next, of recorded vehicles one by lot |
| `observation` | by the predictor | `"slots"`: all of it; `"vehicles"`: ego and neighbours only, \
the default without a predictor |
| `action` | by the predictor | `"slot"`: `Discrete`; `"acceleration"`: `Box`, the default without \
a predictor; `"highway"`: highway-env's own continuous action |
| `masked_action` | `"refuse"` | `"yield"`: who chooses a slot that is not there yields |
| `frames_per_step` | 5 | of 0.1 s; an action holds for so many |
| `warm_up_s` | by the scene | traffic builds up for so long before the ego comes |
| `duration_s` | 90 | an episode is truncated after so long |
| `until` | `"crossed"` | the ego has arrived when it is past the last junction of its way, \
or off the road; `"end"`: only then |
| `reward` | see `RewardWeights` | weights by name; those not named keep their default |
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Any, Final, get_args, get_origin, get_type_hints

import numpy as np

from hatn_sim.config import Scenario
from hatn_sim.datatypes import DT_S, Predictor
from hatn_sim.envs.errors import OptionError
from hatn_sim.errors import nearest

CHOICES: Final = {
    "lines": ("inferred", "route"),
    "ego": ("spawned", "taken_over"),
    "observation": ("slots", "vehicles"),
    "action": ("slot", "acceleration", "highway"),
    "masked_action": ("refuse", "yield"),
    "until": ("crossed", "end"),
}
SAME_WORD: Final = 0.7
"""Words that are less like an option are no slip of the pen."""
RANGES: Final = {
    "frames_per_step": (1, 50),
    "warm_up_s": (0.0, 3600.0),
    "duration_s": (DT_S, 3600.0),
}
"""Lowest and highest value."""


@dataclass(frozen=True)
class RewardWeights:
    """The reward of a step is the sum of its terms, each times its weight; see `reward.Terms`."""

    progress_m: float = 0.02  # per metre along its way
    time_s: float = -0.05
    discomfort_s: float = -0.1
    risk_s: float = -0.5
    lawless: float = -5.0  # what is gained at a stop line or by speeding is less
    collision: float = -10.0
    arrival: float = 3.0


@dataclass(frozen=True, eq=False)
class EnvOptions:
    """All options, see the table of this module; what is None here is chosen by the scene."""

    scene: str | Scenario | None = None
    tracks: str | None = None
    map: str | None = None
    net: str | None = None
    density: str | None = None
    risk: str | None = None
    predictor: str | Predictor | None = "hatn"
    lines: str = "inferred"
    advice: bool = True
    ego: str | None = None
    ego_id: str | None = None
    observation: str | None = None
    action: str | None = None
    masked_action: str = "refuse"
    frames_per_step: int = 5
    warm_up_s: float | None = None
    duration_s: float = 90.0
    until: str = "crossed"
    reward: RewardWeights = field(default_factory=RewardWeights)

    @property
    def observation_form(self) -> str:
        """What is observed, whoever chose it."""
        return self.observation or ("vehicles" if self.predictor is None else "slots")

    @property
    def action_form(self) -> str:
        """What an action is, whoever chose it."""
        return self.action or ("acceleration" if self.predictor is None else "slot")


def read_options(given: Mapping[str, Any]) -> EnvOptions:
    """The options given by name, the others as they are by default.

    Raises OptionError for an unknown name, a value of the wrong type, an unknown one or one out of
    its range, and for options that do not go together.
    """
    known = [one.name for one in fields(EnvOptions)]
    for key in given:
        if key not in known:
            near = get_close_matches(key, known, cutoff=SAME_WORD)
            hint = nearest(key, near) if near else f"; known: {', '.join(known)}"
            raise OptionError(f"unknown option {key!r}{hint}")
    values = dict(given)
    if values.get("advice") and values.get("predictor", EnvOptions.predictor) is None:
        raise OptionError(
            "advice: True needs a predictor, found None; name one, or leave advice out"
        )
    if "reward" in values:
        values["reward"] = _weights(values["reward"])
    hints = get_type_hints(EnvOptions)
    for key, value in values.items():
        if isinstance(value, Path):
            values[key] = value = str(value)
        _check(key, value, hints[key])
    options = EnvOptions(**values)
    _check_together(options)
    return options


def _weights(given: object) -> RewardWeights:
    if isinstance(given, RewardWeights):
        return given
    known = [one.name for one in fields(RewardWeights)]
    if not isinstance(given, Mapping):
        raise OptionError(f"reward: expected weights by name, found {given!r}; known: {known}")
    for key, value in given.items():
        if key not in known:
            raise OptionError(f"reward: unknown term {key!r}{nearest(str(key), known)}")
        if not _is_number(value) or not np.isfinite(value):
            raise OptionError(f"reward: {key}: expected a number, found {value!r}; correct it")
    return RewardWeights(**{str(key): float(value) for key, value in given.items()})


def _check(key: str, value: object, hint: Any) -> None:
    if key == "predictor" and hasattr(value, "observe"):
        return
    kinds = get_args(hint) if get_origin(hint) is UnionType else (hint,)
    plain = tuple(kind for kind in kinds if kind is not Predictor)
    right = _is_number(value) if float in plain and value is not None else isinstance(value, plain)
    if (isinstance(value, bool) and bool not in kinds) or not right:
        expected = " or ".join("None" if kind is type(None) else kind.__name__ for kind in kinds)
        raise OptionError(f"{key}: expected {expected}, found {value!r}; correct it")
    if key in CHOICES and value is not None and value not in CHOICES[key]:
        raise OptionError(f"{key}: unknown value {value!r}{nearest(str(value), CHOICES[key])}")
    if key in RANGES and value is not None:
        low, high = RANGES[key]
        assert isinstance(value, int | float | np.number)
        if not low <= value <= high:
            raise OptionError(f"{key}: expected {low:g} to {high:g}, found {value:g}; correct it")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _check_together(options: EnvOptions) -> None:
    if (options.scene is None) == (options.tracks is None):
        found = "neither" if options.scene is None else "both"
        raise OptionError(f"expected either scene or tracks, found {found}; name what to simulate")
    if options.tracks is None and options.map is not None:
        raise OptionError(f"map: {options.map} is for tracks; leave it out")
    if options.ego == "spawned" and options.ego_id is not None:
        raise OptionError(
            f"ego_id: {options.ego_id!r} can only be taken over; leave ego='spawned' out"
        )
    if options.predictor is None:
        needs = {"observation": options.observation == "slots", "action": options.action == "slot"}
        for key in (key for key, wrong in needs.items() if wrong):
            raise OptionError(
                f"{key}: {getattr(options, key)!r} needs a predictor, found None; name one "
                "('constant_velocity' costs least)"
            )
