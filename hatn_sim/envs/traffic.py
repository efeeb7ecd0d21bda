"""Options -> the scene that they name and its simulator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import gymnasium

from hatn_sim.config import HighwaySource, ReplaySource, Scenario, load_scenario, load_tracks
from hatn_sim.envs.errors import EgoError, OptionError, in_python
from hatn_sim.envs.options import EnvOptions
from hatn_sim.errors import InputError, nearest
from hatn_sim.resources import find_scenarios
from hatn_sim.simulators.sumo_demand import coming, lasts_s

WARM_UP_S: Final = 60.0
"""Scenes that ship begin empty."""


def scenario_of(options: EnvOptions) -> Scenario:
    """The scene of the options.

    Raises InputError where there is none such, OptionError where it cannot be driven in that way.
    """
    scenario = _named(options)
    if scenario.recorded is not None:
        return _replayed(scenario, options)
    if options.net is not None:
        raise OptionError(f"net: {options.net} is for recorded tracks; leave it out")
    if options.action == "highway" and scenario.highway is None:
        raise OptionError(
            f"action: 'highway' is for environments of highway-env, {scenario.name} is none; "
            "choose 'slot' or 'acceleration'"
        )
    is_on_road = scenario.highway is not None and ego_of(options, scenario) == "spawned"
    if is_on_road and options.warm_up_s:
        raise OptionError(
            "warm_up_s: the ego of highway-env is on the road from the beginning; leave it out, "
            "or choose ego='taken_over'"
        )
    _check_coming(scenario, options)
    return scenario


def check_scene(registered_as: str, own: str, options: EnvOptions) -> None:
    """Raises OptionError where another scene is named than the one that a name stands for."""
    given = options.tracks if options.scene is None else options.scene
    name = given.name if isinstance(given, Scenario) else given
    if options.tracks is not None or name != own:
        raise OptionError(
            f"scene: {registered_as} is {own}, found {name!r}; make hatn_sim/Scene-v0 for others"
        )


def _check_coming(scenario: Scenario, options: EnvOptions) -> None:
    """Refuses a warm-up and an ego of which the scene itself says that nothing comes of them."""
    wait_s, length_s = warm_up_s(options, scenario), lasts_s(scenario)
    if length_s is not None and wait_s >= length_s:
        raise OptionError(
            f"warm_up_s: {wait_s:g} s leave nothing of {scenario.name}, which ends after "
            f"{length_s:g} s; choose less"
        )
    known = None if options.ego_id is None else coming(scenario)
    if known is not None and options.ego_id is not None and not known[0](options.ego_id):
        raise EgoError(
            f"ego_id: nobody called {options.ego_id!r} is in the route files of "
            f"{scenario.name}{nearest(options.ego_id, known[1])}"
        )


def _named(options: EnvOptions) -> Scenario:
    if options.tracks is not None:
        _refuse_traffic(options, "recorded tracks")
        map_path = None if options.map is None else Path(options.map)
        try:
            return load_tracks((options.tracks,), map_path)
        except InputError as error:
            raise OptionError(f"tracks: {in_python(error)}") from None
    scene = options.scene
    assert scene is not None
    if isinstance(scene, Scenario):
        _refuse_traffic(options, "a Scenario")
        return scene
    try:
        return load_scenario(scene, options.density, options.risk)
    except InputError as error:
        highway = _of_highway()
        if scene not in highway:
            if str(error).startswith("unknown scene"):
                if scene in gymnasium.registry:
                    raise OptionError(
                        f"scene: {scene!r} is no road environment of highway-env; those are "
                        + ", ".join(highway)
                    ) from None
                hint = nearest(scene, (*find_scenarios(), *highway))
                raise OptionError(f"scene: unknown scene {scene!r}{hint}") from None
            raise OptionError(f"scene: {in_python(error)}") from None
    _refuse_traffic(options, "an environment of highway-env")
    return Scenario(
        name=scene,
        config_path=Path(scene),
        title=f"highway-env, {scene}",
        simulator="highway",
        highway=HighwaySource(scene),
        is_user_config=True,
    )


def _refuse_traffic(options: EnvOptions, what: str) -> None:
    for key in ("density", "risk"):
        if getattr(options, key) is not None:
            raise OptionError(f"{key}: {what} has its own traffic; leave it out")


def _of_highway() -> tuple[str, ...]:
    from hatn_sim.simulators.highway_environment import known_environments

    return known_environments()


def _replayed(scenario: Scenario, options: EnvOptions) -> Scenario:
    assert scenario.recorded is not None
    if options.ego == "spawned":
        raise OptionError("ego: a recording has nobody but those recorded; choose 'taken_over'")
    if options.action == "highway":
        raise OptionError("action: 'highway' is for environments of highway-env; choose another")
    if options.net is None:
        if scenario.recorded.replay is not None:
            return scenario
        raise OptionError(
            f"{scenario.name}: recorded tracks take no actions; add net='FILE.net.xml', a SUMO net "
            "of the place in which the ego is driven (`hatn-sim net MAP` builds one)"
        )
    replay = ReplaySource(Path(options.net))
    return replace(scenario, recorded=replace(scenario.recorded, replay=replay))


def ego_of(options: EnvOptions, scenario: Scenario) -> str:
    """Whether the ego is spawned or taken over."""
    if options.ego is not None:
        return options.ego
    can_spawn = scenario.recorded is None and options.ego_id is None
    return "spawned" if can_spawn else "taken_over"


def warm_up_s(options: EnvOptions, scenario: Scenario) -> float:
    """For how long traffic builds up before the ego comes."""
    if options.warm_up_s is not None:
        return options.warm_up_s
    begins_full = scenario.is_user_config or scenario.recorded is not None
    is_on_road = scenario.highway is not None and ego_of(options, scenario) == "spawned"
    return 0.0 if begins_full or is_on_road else WARM_UP_S
