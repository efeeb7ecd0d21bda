"""What a `.sumocfg` says, and the options SUMO is started with so that it runs at our tick."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hatn_sim.datatypes import DT_S
from hatn_sim.errors import InputError
from hatn_sim.safe_xml import parse_xml

if TYPE_CHECKING:
    from hatn_sim.config import Scenario

SYNONYMS = {
    "n": "net-file",
    "net": "net-file",
    "r": "route-files",
    "routes": "route-files",
    "a": "additional-files",
    "additional": "additional-files",
}
"""Other names SUMO knows for the options read here."""
FILE_OPTIONS = ("net-file", "route-files", "additional-files")
VIEW_FILE = "view.xml"
"""The look of SUMO's window, beside the scenes that ship."""
SUMO_DEFAULT_STEP_S = 1.0
MAX_SEED = 2**31 - 1
COLLISIONS_SEEN = {
    "collision.action": "warn",
    "collision.check-junctions": "true",
    "collision.mingap-factor": "0",
}
"""SUMO's own defaults overlook collisions in junctions and count a gap below minGap as one."""


def read_sumocfg(path: Path) -> dict[str, str]:
    """Option -> value of a configuration. Raises InputError if it is missing or malformed."""
    root = parse_xml(path)
    options: dict[str, str] = {}
    for element in root.iter():
        value = element.get("value", element.get("v"))
        if value is not None:
            options[SYNONYMS.get(element.tag, element.tag)] = value.strip()
    return options


def named_files(path: Path) -> list[Path]:
    """The net, routes and additional files that a configuration names; some may not be there."""
    options = read_sumocfg(path)
    return [path.parent / name for key in FILE_OPTIONS for name in _names(options.get(key, ""))]


def check_sumocfg(path: Path) -> None:
    """Raises InputError if the configuration or a file that it names is missing."""
    options = read_sumocfg(path)
    for option in FILE_OPTIONS:
        for name in _names(options.get(option, "")):
            # SUMO itself fills in variables and fetches addresses.
            if "${" in name or "://" in name or name.startswith("~"):
                continue
            if not (path.parent / name).exists():
                raise InputError(
                    f"{path}: {option}: there is no file {path.parent / name}; "
                    "correct the name or put the file there"
                )


def start_options(
    scenario: Scenario, has_window: bool = False
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """SUMO's command line for a scene, the seed excepted, and notices for the user.

    The scene's own begin and end, outputs and models stay; the tick becomes 0.1 s, randomness
    comes from the seed alone, and nothing is left to wait for a window or a TraCI client.
    """
    configured = read_sumocfg(scenario.config_path)
    name = scenario.config_path.name
    notices: list[str] = []
    options = {
        "configuration-file": str(scenario.config_path),
        "step-length": f"{DT_S:g}",
        "random": "false",
        "no-step-log": "true",
        "duration-log.disable": "true",
    }
    look = configured.get("gui-settings-file")
    if look is not None and not has_window:
        options["gui-settings-file"] = ""
    elif look is not None and Path(look).name != VIEW_FILE:
        notices.append(
            f"gui-settings-file in {name}: kept; words of advice are seen in the window where its "
            "scheme shows the parameter 'hatn-sim' of points (poiTextParam)"
        )
    if "remote-port" in configured:
        options["remote-port"] = "0"
        notices.append(f"remote-port in {name}: not opened")
    if configured.get("random", "false").lower() in ("true", "1", "yes", "on", "x", "t"):
        notices.append(f"random in {name}: overridden, so that the seed repeats the run")
    if not any(option.startswith("collision.") for option in configured):
        options |= COLLISIONS_SEEN
    if scenario.scale is not None:
        options["scale"] = f"{scenario.scale:g}"
    if scenario.driver_path is not None:
        options["additional-files"] = ",".join(
            _with_driver(
                [
                    scenario.config_path.parent / other
                    for other in _names(configured.get("additional-files", ""))
                ],
                scenario.driver_path,
                scenario.driver_paths,
            )
        )
    step_s = _step_length_s(scenario.config_path, configured)
    if abs(step_s - DT_S) > 1e-9:
        said = f"step-length {step_s:g} s" + ("" if "step-length" in configured else " (default)")
        notice = f"{said} in {name}: run at {DT_S:g} s"
        if step_s > DT_S and "default.action-step-length" not in configured:
            action_s = round(step_s / DT_S) * DT_S
            options["default.action-step-length"] = f"{action_s:g}"
            notice += f" with {action_s:g} s as action step length"
        notices.append(notice)
    words = tuple(word for key, value in options.items() for word in (f"--{key}", value))
    return words, tuple(notices)


def first_error(words: str) -> str | None:
    """The first error among the lines SUMO printed, with its file and place, in one line.

    >>> first_error("Warning: x\\nError: unexpected end of input\\n In file 'a'\\nQuitting.")
    "Error: unexpected end of input In file 'a'"
    """
    lines = iter(words.splitlines())
    for line in lines:
        if line.startswith("Error: "):
            parts = [line.strip()]
            for further in lines:
                if not further.startswith(" "):
                    break
                parts.append(further.strip())
            return " ".join(parts)
    return None


def _names(value: str) -> list[str]:
    return [name.strip() for name in value.split(",") if name.strip()]


def _with_driver(additional: list[Path], chosen: Path, drivers: tuple[Path, ...]) -> list[str]:
    """The additional files with the chosen driver file in place of the configured one."""
    known = {path.resolve() for path in drivers}
    others = [path for path in additional if path.resolve() not in known]
    return [str(path) for path in (chosen, *others)]


def _step_length_s(path: Path, configured: Mapping[str, str]) -> float:
    text = configured.get("step-length")
    if text is None:
        return SUMO_DEFAULT_STEP_S
    try:
        seconds = 0.0
        for part, unit_s in zip(reversed(text.split(":")), (1, 60, 3600, 86400), strict=False):
            seconds += float(part) * unit_s
    except ValueError as error:
        raise InputError(
            f"{path}: step-length: expected seconds, found {text!r}; correct the value"
        ) from error
    if not seconds > 0:
        raise InputError(f"{path}: step-length: expected more than 0 s, found {text!r}")
    return seconds
