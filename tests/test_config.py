"""Scenes by name and by path, the resource finder, and one clear line for every fault."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import pytest

from hatn_sim import resources
from hatn_sim.config import Scenario, load_scenario, recording_names
from hatn_sim.errors import InputError
from hatn_sim.simulators.sumo_config import first_error, read_sumocfg, start_options

NETS = Path(__file__).parent / "nets"

SCENE = """
name = "corner"
title = "A corner"
description = "Where two streets meet."
simulator = "sumo"
config = "street.sumocfg"
[density]
light = 0.5
normal = 1
[risk]
courteous = "calm.add.xml"
assertive = "brisk.add.xml"
[card]
throughput = { value = 800, unit = "1/h" }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("street.net.xml", "street.rou.xml"):
        shutil.copy(NETS / name, tmp_path)
    config = (NETS / "street.sumocfg").read_text()
    (tmp_path / "street.sumocfg").write_text(
        config.replace(
            "</input>", '<additional-files value="calm.add.xml, other.add.xml"/></input>'
        )
    )
    for name in ("calm", "brisk", "other"):
        (tmp_path / f"{name}.add.xml").write_text("<additional/>")
    (tmp_path / "scenario.toml").write_text(SCENE)
    return tmp_path


def fault(folder: Path, old: str, new: str, **chosen: str) -> str:
    """The error's text after changing scenario.toml."""
    assert old in SCENE
    (folder / "scenario.toml").write_text(SCENE.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_scenario(str(folder), **chosen)
    text = str(caught.value)
    assert text.startswith(str(folder))
    assert "\n" not in text
    return text


def option(scenario: Scenario, name: str) -> str:
    words, _ = start_options(scenario)
    return words[words.index(f"--{name}") + 1]


def test_a_scene_by_its_folder_and_by_its_file(folder: Path) -> None:
    scenario = load_scenario(str(folder))
    assert scenario == load_scenario(str(folder / "scenario.toml"))
    assert (scenario.name, scenario.title) == ("corner", "A corner")
    assert (scenario.density, scenario.risk, scenario.scale) == ("normal", "courteous", 1.0)
    assert scenario.densities == ("light", "normal")
    assert scenario.risks == ("courteous", "assertive")
    assert scenario.card == {"throughput": {"value": 800, "unit": "1/h"}}
    assert not scenario.is_user_config
    assert pickle.loads(pickle.dumps(scenario)) == scenario


def test_density_and_risk_reach_sumo(folder: Path) -> None:
    scenario = load_scenario(str(folder), density="light", risk="assertive")
    assert (scenario.density, scenario.risk) == ("light", "assertive")
    assert option(scenario, "scale") == "0.5"
    # The profile's file takes the place of the configured one; other files stay.
    assert option(scenario, "additional-files") == f"{folder}/brisk.add.xml,{folder}/other.add.xml"


def test_a_users_own_configuration() -> None:
    scenario = load_scenario(str(NETS / "street.sumocfg"))
    assert scenario.name == "street"
    assert scenario.is_user_config
    assert scenario.scale is None and scenario.density is None and scenario.risk is None
    words, notices = start_options(scenario)
    assert "--scale" not in words and "--additional-files" not in words
    assert notices == ()


@pytest.mark.parametrize("chosen", [{"density": "light"}, {"risk": "assertive"}])
def test_a_users_own_configuration_has_no_profiles(chosen: dict[str, str]) -> None:
    (key, value), *_ = chosen.items()
    with pytest.raises(InputError, match=rf"street\.sumocfg: --{key} {value} is for scenes with"):
        load_scenario(str(NETS / "street.sumocfg"), **chosen)


def test_unknown_scene_names_the_nearest(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = {"corner": folder / "scenario.toml", "roundabout": folder / "scenario.toml"}
    monkeypatch.setattr("hatn_sim.config.find_scenarios", lambda: shipped)
    assert load_scenario("corner").name == "corner"
    with pytest.raises(InputError) as caught:
        load_scenario("cornre")
    assert str(caught.value) == "unknown scene 'cornre'; did you mean 'corner'?"
    with pytest.raises(InputError) as caught:
        load_scenario("zzz")
    assert str(caught.value) == "unknown scene 'zzz'; known: corner, roundabout"


def test_paths_that_are_no_scene(folder: Path) -> None:
    with pytest.raises(InputError, match=r"street\.net\.xml: expected the name of a scene, a sce"):
        load_scenario(str(folder / "street.net.xml"))
    with pytest.raises(InputError, match=r"missing\.sumocfg: cannot be read: No such file"):
        load_scenario(str(folder / "missing.sumocfg"))
    with pytest.raises(InputError, match=r"missing/scenario\.toml: cannot be read: No such file"):
        load_scenario(str(folder / "missing" / "scenario.toml"))


def test_faults_in_scenario_toml(folder: Path) -> None:
    where = f"{folder}/scenario.toml"
    assert fault(folder, "title =", "titel =") == (
        f"{where}: unknown key 'titel'; did you mean 'title' or 'suite'?"
    )
    assert fault(folder, 'title = "A corner"', "") == (
        f"{where}: key 'title' is missing: add a text"
    )
    assert fault(folder, '"A corner"', "3") == f"{where}: title: expected a text, found 3"
    assert fault(folder, '"sumo"', '"suma"') == (
        f"{where}: simulator: unknown value 'suma'; did you mean 'sumo'?"
    )
    assert fault(folder, "[density]", 'suite = "do_wran"\n[density]') == (
        f"{where}: suite: unknown value 'do_wran'; did you mean 'do_warn' or 'no_warn'?"
    )
    assert fault(folder, "0.5", '"half"') == (
        f"{where}: density.light: expected a positive number, found 'half'"
    )
    assert fault(folder, "0.5", "true").endswith("expected a positive number, found True")
    assert fault(folder, "0.5", "-1").endswith("expected a positive number, found -1")
    assert fault(folder, "normal = 1", "") == (
        f"{where}: [density] lacks 'normal', the default: add it"
    )
    assert fault(folder, "[card]", "card = 3\n[more]").startswith(f"{where}: unknown key 'more'")
    assert fault(folder, '"calm.add.xml"', '"clam.add.xml"') == (
        f"{where}: risk.courteous: no file {folder}/clam.add.xml; correct the name"
    )
    assert fault(folder, "A corner", "A corner", density="dens") == (
        f"{where}: unknown density 'dens'; known: light, normal"
    )
    assert fault(folder, "A corner", "A corner", risk="asertive") == (
        f"{where}: unknown risk 'asertive'; did you mean 'assertive'?"
    )


def test_a_toml_that_is_none(folder: Path) -> None:
    text = fault(folder, 'config = "street.sumocfg"', "config = ")
    assert text.startswith(f"{folder}/scenario.toml:6: not valid TOML: ")


def test_a_scene_without_profiles(folder: Path) -> None:
    plain = SCENE[: SCENE.index("[density]")]
    (folder / "scenario.toml").write_text(plain)
    scenario = load_scenario(str(folder))
    assert scenario.density is None and scenario.scale is None and scenario.driver_path is None
    with pytest.raises(InputError, match=r"has no \[risk\]: leave --risk assertive out"):
        load_scenario(str(folder), risk="assertive")


@pytest.mark.parametrize(
    ("option_name", "file"),
    [
        ("net-file", "street.net.xml"),
        ("route-files", "street.rou.xml"),
        ("additional-files", "other.add.xml"),
    ],
)
def test_a_missing_file_is_named_with_its_option(folder: Path, option_name: str, file: str) -> None:
    (folder / file).unlink()
    with pytest.raises(InputError) as caught:
        load_scenario(str(folder / "street.sumocfg"))
    assert str(caught.value) == (
        f"{folder}/street.sumocfg: {option_name}: there is no file {folder}/{file}; "
        "correct the name or put the file there"
    )


def test_a_malformed_configuration_is_placed(folder: Path) -> None:
    config = folder / "street.sumocfg"
    config.write_text("<configuration>\n  <input>\n</configuration>")
    with pytest.raises(InputError, match=r"street\.sumocfg:3: not well-formed XML: mismatched"):
        load_scenario(str(config))


@pytest.mark.parametrize("encoding", ["UTF-7", "UTF-32", "no-such", "base64"])
def test_an_encoding_that_cannot_be_read_is_said(folder: Path, encoding: str) -> None:
    config = folder / "street.sumocfg"
    config.write_text(f'<?xml version="1.0" encoding="{encoding}"?><configuration/>')
    with pytest.raises(InputError) as caught:
        load_scenario(str(config))
    assert str(caught.value).startswith(f"{config}:")
    assert "encoding" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_short_names_of_options_are_understood(tmp_path: Path) -> None:
    config = tmp_path / "short.sumocfg"
    config.write_text(
        '<configuration><n v="a.net.xml"/><routes value=" b.rou.xml "/></configuration>'
    )
    assert read_sumocfg(config) == {"net-file": "a.net.xml", "route-files": "b.rou.xml"}


def test_first_error_skips_warnings_and_keeps_the_place() -> None:
    words = "Warning: no\nError: bad end\n In file 'a.xml'\n At line/column 3/4.\n\nQuitting.\n"
    assert first_error(words) == "Error: bad end In file 'a.xml' At line/column 3/4."
    assert first_error("Warning: only this\n") is None


# ---------------------------------------------------------------------------------------------
# Where things are found


def test_shipped_scenes_load_with_every_density_and_risk() -> None:
    scenes = resources.find_scenarios()
    assert "intersection5" in scenes
    for name in scenes:
        scenario = load_scenario(name)
        assert scenario.name == name
        assert scenario.config_path.is_file()
        for density in scenario.densities:
            assert load_scenario(name, density=density).density == density
        for risk in scenario.risks:
            chosen = load_scenario(name, risk=risk)
            assert option(chosen, "additional-files").startswith(str(chosen.driver_path))


def test_resources_of_a_clone_and_of_a_wheel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "hatn_sim"
    (package / "hatn" / "weights").mkdir(parents=True)
    monkeypatch.setattr(resources, "PACKAGE_DIR", package)
    (tmp_path / "scenarios").mkdir()
    with pytest.raises(InputError, match="expected the shipped scenarios here, or in"):
        resources.scenarios_dir()  # a stray folder beside an installed package is not ours
    (tmp_path / "pyproject.toml").touch()
    assert resources.scenarios_dir() == tmp_path / "scenarios"
    with pytest.raises(InputError, match="expected the shipped agents here"):
        resources.agents_dir()
    (package / "_data" / "scenarios" / "corner").mkdir(parents=True)
    (package / "_data" / "scenarios" / "corner" / "scenario.toml").touch()
    (package / "_data" / "scenarios" / "drivers").mkdir()
    assert resources.find_scenarios() == {
        "corner": package / "_data" / "scenarios" / "corner" / "scenario.toml"
    }
    (package / "_data" / "scenarios" / "learn_corner").mkdir()
    (package / "_data" / "scenarios" / "learn_corner" / "scenario.toml").touch()
    assert tuple(resources.find_scenarios()) == ("corner", "learn_corner")
    (package / "_data" / "scenarios" / "near").mkdir(parents=True)
    of_suite = package / "_data" / "scenarios" / "near" / "scenario.toml"
    of_suite.write_text('suite = "do_warn"\n')
    assert resources.scenes_to_test_on() == ("corner",)
    assert resources.scenes_of_suite("do_warn") == ("near",)
    assert resources.scenes_of_suite("no_warn") == ()
    of_suite.unlink()
    assert resources.weights_dir() == package / "hatn" / "weights"
    (package / "hatn" / "weights").rmdir()
    with pytest.raises(InputError, match="expected the shipped weights here"):
        resources.weights_dir()


def test_names_of_recordings_are_spelled_out() -> None:
    assert recording_names("000-002, 7,001") == ("000", "001", "002", "7")
    for text in ("5-2", "a-3", "²-³", "0-9999999999"):
        with pytest.raises(InputError, match="expected names like 000-004,017, found"):
            recording_names(text)
