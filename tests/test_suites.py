"""The suites' scenes: found and listed by suite, and what their scripts promise really happens."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from conftest import scene_of

from hatn_sim.commands.scenarios import Stretch, measure
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame, Truth
from hatn_sim.errors import InputError
from hatn_sim.resources import SUITES, find_scenarios, scenes_of_suite, scenes_to_test_on
from hatn_sim.score.encounters import (
    EncounterCount,
    count_encounters,
    encounter_figures,
    partners,
)

SCENES = [f"{suite}_{place}" for suite in SUITES for place in ("crossing", "roundabout")]


def frame(speeds_mps: dict[str, float], **truth: tuple[object, ...]) -> Frame:
    scene = scene_of(0.0, {name: (0.0, 0.0, 0.0, speed) for name, speed in speeds_mps.items()})
    nowhere = (None,) * len(speeds_mps)
    return Frame(scene, Truth(nowhere, **truth), done=False)  # type: ignore[arg-type]


# ---------------------------------------------------------------------------------------------
# Found by suite


def test_every_suite_has_a_crossing_and_a_roundabout() -> None:
    for suite in SUITES:
        assert scenes_of_suite(suite) == (f"{suite}_crossing", f"{suite}_roundabout")
        assert all(load_scenario(name).suite == suite for name in scenes_of_suite(suite))
    assert load_scenario("tjunction").suite is None


def test_no_suite_is_tested_on_unless_it_is_named() -> None:
    assert set(SCENES) <= set(find_scenarios())
    assert not set(SCENES) & set(scenes_to_test_on())


def test_an_unknown_suite_names_the_nearest() -> None:
    with pytest.raises(InputError, match="unknown suite 'dowarn'; did you mean 'do_warn'"):
        scenes_of_suite("dowarn")


# ---------------------------------------------------------------------------------------------
# The same approaches


def test_who_violates_and_who_yields_late_differ_in_nothing_else() -> None:
    """The scenes of do_warn and suppress_warn name the same files but for the foes' drivers; these
    differ in what they ignore."""
    folder = find_scenarios()["do_warn_crossing"].parents[1]

    def inputs(name: str) -> set[str]:
        root = ElementTree.parse(folder / name / f"{name}.sumocfg").getroot()
        values = (element.get("value", "") for element in root.findall("input/*"))
        return {part for value in values for part in value.split(",")}

    for place in ("crossing", "roundabout"):
        late, never = (inputs(f"{suite}_{place}") for suite in ("suppress_warn", "do_warn"))
        assert never - late == {"../suites/offenders.add.xml"}
        assert late - never == {"../suites/late_yielders.add.xml"}

    def types(name: str) -> dict[str, dict[str, str]]:
        root = ElementTree.parse(folder / "suites" / f"{name}.add.xml").getroot()
        return {element.attrib["id"]: dict(element.attrib) for element in root.iter("vType")}

    late, never = types("late_yielders"), types("offenders")
    foes = {name: values for name, values in late.items() if name.startswith("foe")}
    twins = {name: never.pop(f"lawful_{name}") for name in foes}
    for name, values in foes.items():
        assert values == twins[name] | {"id": name, "probability": values["probability"]}
    assert late.keys() == never.keys()
    for name, values in late.items():
        more = {"jmIgnoreFoeProb", "jmIgnoreFoeSpeed", "jmIgnoreJunctionFoeProb"}
        assert never[name].keys() - values.keys() == (more if name.startswith("foe") else set())
        assert all(never[name][key] == value for key, value in values.items())


@pytest.mark.parametrize("place", ["crossing", "roundabout"])
def test_flows_stand_in_the_order_in_which_they_begin(place: str) -> None:
    """SUMO drops without a word a flow that begins before the one above it."""
    path = find_scenarios()["do_warn_crossing"].parents[1] / "suites"
    root = ElementTree.parse(path / f"{place}_encounters.rou.xml").getroot()
    begins_s = [float(flow.attrib["begin"]) for flow in root.iter("flow")]
    assert begins_s == sorted(begins_s)


# ---------------------------------------------------------------------------------------------
# What happens in them


@pytest.mark.parametrize("name", SCENES)
def test_what_a_suite_promises(name: str) -> None:
    scenario = load_scenario(name)
    count = measure(Stretch(name, scenario.density, scenario.risk, seed=3, duration_s=110.0))
    assert isinstance(count, EncounterCount)
    assert count.unscripted == 0
    assert count.vehicle_hours > 0.05
    if scenario.suite == "do_warn":
        assert count.encounters >= 3
        assert count.with_event >= count.encounters - 1
    else:
        assert (count.collisions, count.hard_brakings) == (0, 0)
        assert (count.encounters >= 3) == (scenario.suite == "suppress_warn")


@pytest.mark.parametrize("name", SCENES)
def test_the_cards_say_what_a_suite_promises(name: str) -> None:
    scenario = load_scenario(name)
    figures = scenario.card["suite"][scenario.suite]
    assert figures["unscripted_per_run"] == 0.0
    if scenario.suite == "do_warn":
        assert figures["event_percent"] >= 80.0
        assert figures["collisions_per_run"] > 0.0
    else:
        assert figures["collisions_per_run"] == figures["hard_brakings_per_run"] == 0.0
    if scenario.suite == "no_warn":
        assert figures["vehicle_hours"] > 1.0


# ---------------------------------------------------------------------------------------------
# Counted by hand


def test_partners() -> None:
    pair = ("left_turn_ego.12", "left_turn_foe.12")
    assert partners("left_turn_ego.12") == partners("left_turn_foe.12") == pair
    assert partners("left_turn_bystander.12") is None
    assert partners("ego.1") is None
    assert partners("a_ego.x") is None


def test_encounters_by_hand() -> None:
    frames = [
        # a's ego brakes at 5, a bystander at 4.4; the foe of c and a stranger touch
        frame(
            {"a_ego.0": 9.5, "a_foe.0": 5.0, "b_ego.0": 7.0, "by": 3.56},
            collisions=(("c_foe.0", "x"),),
        ),
        # d's two touch and only one of them leaves; x brakes as hard as it can
        frame({"by": 3.5}, collisions=(("d_ego.1", "d_foe.1"),), arrived=("a_ego.0", "a_foe.0")),
        frame({}, arrived=("b_ego.0", "b_foe.0", "d_ego.1"), emergency_braking=("x",)),
    ]
    count = count_encounters(frame({"a_ego.0": 10.0, "by": 4.0}), frames, dt_s=0.1)
    assert count == EncounterCount(
        runs=1,
        vehicle_hours=pytest.approx(5 * 0.1 / 3600),
        encounters=2,
        with_event=1,
        collisions=2,
        hard_brakings=2,
        unscripted=2,
    )
    assert encounter_figures(count + count) == {
        "vehicle_hours": pytest.approx(1e-1 / 360),
        "encounters_per_run": 2.0,
        "event_percent": 50.0,
        "collisions_per_run": 2.0,
        "hard_brakings_per_run": 2.0,
        "unscripted_per_run": 2.0,
    }


def test_figures_of_nothing_have_no_value() -> None:
    figures = encounter_figures(EncounterCount())
    assert figures.pop("vehicle_hours") == 0.0
    assert set(figures.values()) == {None}


def test_a_run_without_encounters_has_no_share() -> None:
    figures = encounter_figures(count_encounters(frame({}), [frame({})], dt_s=0.1))
    assert figures["event_percent"] is None
    assert figures["encounters_per_run"] == 0.0
