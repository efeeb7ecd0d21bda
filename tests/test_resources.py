"""Scenes, agents and weights are found in a wheel, an sdist and an editable install."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import pytest

from hatn_sim.resources import find_agents, find_scenarios

ROOT = Path(__file__).parents[1]
SHIPPED = ("hatn_sim", "scenarios", "agents", "tests")
FILES = ("pyproject.toml", "LICENSE", "CHANGELOG.md", "README.md", ".gitignore")

LOOK = """
import json, sys
from hatn_sim import resources
from hatn_sim.config import load_scenario
from hatn_sim.traffic import open_traffic

scenes, opened = {}, []
for name in resources.find_scenarios():
    scenario = load_scenario(name)
    for density in scenario.densities:
        for risk in scenario.risks:
            load_scenario(name, density, risk)
    simulator = open_traffic(scenario)
    begin_s = simulator.reset(1).scene.time_s
    scenes[name] = round(simulator.step().scene.time_s - begin_s, 6)
    opened.append(simulator)  # one that is open spares the next its beginning
for simulator in opened:
    simulator.close()
weights = resources.weights_dir()
print(json.dumps({
    "package": str(resources.PACKAGE_DIR),
    "scenes": scenes,
    "agents": sorted(resources.find_agents()),
    "weights": sorted(path.name for path in weights.iterdir()),
}))
"""


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What git holds of this project, at another place."""
    folder = tmp_path_factory.mktemp("clone")
    for name in SHIPPED:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, folder)
    (folder / "README.md").touch()
    return folder


def build(source: Path, target: str, out: Path) -> Path:
    """The archive that hatchling, the build backend, makes of a source folder."""
    words = ["-m", "hatchling", "build", "-t", target, "-d", str(out)]
    subprocess.run([sys.executable, *words], cwd=source, check=True, capture_output=True)
    (archive,) = out.iterdir()
    return archive


def unpack(archive: Path, folder: Path) -> Path:
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as opened:
            opened.extractall(folder)
        return folder
    with tarfile.open(archive) as opened:
        # Python before 3.11.4 knows no filters; what this test packed is safe without.
        opened.extraction_filter = getattr(tarfile, "fully_trusted_filter", None)
        opened.extractall(folder)
    (top,) = folder.iterdir()
    return top


def look(folder: Path, where: Path) -> dict[str, Any]:
    """What a Python that finds hatn_sim in `folder` only, or by a .pth file there, has of it."""
    paths = [str(folder)]
    for pth in folder.glob("*.pth"):
        paths += pth.read_text().split()
    program = f"import sys; sys.path[:0] = {paths!r}\n{LOOK}"
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", program],
        cwd=where,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def check(found: dict[str, Any], package: Path) -> None:
    assert Path(found["package"]) == package.resolve()
    assert found["scenes"] == dict.fromkeys(sorted(find_scenarios()), 0.1)
    assert found["agents"] == sorted(find_agents()) != []
    assert {"hatn.safetensors", "hatn.json"} <= set(found["weights"])


def test_an_unpacked_wheel(clone: Path, tmp_path: Path) -> None:
    folder = unpack(build(clone, "wheel", tmp_path / "built"), tmp_path / "site")
    names = {path.name for path in folder.iterdir()}
    assert len(names) == 2 and "hatn_sim" in names  # the other is the .dist-info
    assert (folder / "hatn_sim" / "py.typed").is_file()
    check(look(folder, tmp_path), folder / "hatn_sim")


@pytest.mark.slow
def test_an_unpacked_sdist_and_the_wheel_made_of_it(clone: Path, tmp_path: Path) -> None:
    folder = unpack(build(clone, "sdist", tmp_path / "built"), tmp_path / "source")
    check(look(folder, tmp_path), folder / "hatn_sim")
    site = unpack(build(folder, "wheel", tmp_path / "again"), tmp_path / "site")
    check(look(site, tmp_path), site / "hatn_sim")


@pytest.mark.slow
def test_an_editable_install(clone: Path, tmp_path: Path) -> None:
    folder = unpack(build(clone, "wheel:editable", tmp_path / "built"), tmp_path / "site")
    assert list(folder.glob("*.pth"))
    check(look(folder, tmp_path), clone / "hatn_sim")
