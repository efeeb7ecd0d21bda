"""What is learnt from, what is tuned on, and what is kept for testing.

The split is by traffic: a seed of a scene, a recording, the log of a run; never by sample, since
neighbouring frames tell of each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from hatn_sim.config import Scenario, load_scenario, load_tracks, recording_names
from hatn_sim.content import content_hash
from hatn_sim.errors import InputError
from hatn_sim.line_choice import LineChoice
from hatn_sim.log import read_run
from hatn_sim.recordings.each import each_recording, own_cases, own_files
from hatn_sim.recordings.track_lines.source import Drawing
from hatn_sim.resources import find_scenarios

PARTS: Final = ("train", "tune", "test")
DURATION_S: Final = 600.0
"""Of simulated traffic, for each seed."""
WARM_UP_S: Final = 60.0
"""For traffic to build up in a shipped scene, which begins empty."""
MOST_SHOWN: Final = 5
CONTENT: Final = "sha256"
DOUBTS: Final = "doubts"
"""In an entry of a card: of its recordings' files, and what speaks against their map."""


@dataclass(frozen=True)
class Source:
    """Something that may be in one part of a split only: all of it, or some of its cases."""

    key: str
    words: str
    cases: frozenset[str] = frozenset()  # empty: all

    def shares(self, other: Source) -> bool:
        """Whether anything is in both."""
        same = self.key == other.key
        return same and (not self.cases or not other.cases or bool(self.cases & other.cases))


@dataclass(frozen=True, eq=False)
class Traffic:
    """One piece of traffic to cut samples from."""

    name: str
    scenario: Scenario
    seed: int  # without effect where the traffic is recorded
    warm_up_s: float
    duration_s: float | None  # None: to the end
    sources: tuple[Source, ...]
    choice: LineChoice | None = None  # of reference lines; None: the one that ships
    doubts: tuple[str, ...] = ()  # whether its map is that of the place


@dataclass(frozen=True, eq=False)
class Split:
    """The parts of a split, none of which shares anything with another."""

    train: tuple[Traffic, ...]
    tune: tuple[Traffic, ...]
    test: tuple[Traffic, ...] = ()

    def part(self, name: str) -> tuple[Traffic, ...]:
        """One of `PARTS` by its name."""
        traffic: tuple[Traffic, ...] = getattr(self, name)
        return traffic

    def with_choice(self, choice: LineChoice) -> Split:
        """The same traffic, reference lines chosen otherwise."""
        parts = {
            name: tuple(replace(one, choice=choice) for one in self.part(name)) for name in PARTS
        }
        return Split(**parts)

    def card(self) -> dict[str, list[dict[str, Any]]]:
        """What each part is made of, for the card of weights: no paths of anybody's folders."""
        return {name: _card(self.part(name)) for name in PARTS if self.part(name)}


def traffic_of_scenes(
    scenes: Sequence[str],
    seeds: Sequence[int],
    risks: Sequence[str] = (),
    density: str | None = None,
    duration_s: float = DURATION_S,
    warm_up_s: float | None = None,
) -> list[Traffic]:
    """Every scene with every seed, the seeds taking the risk profiles in turn.

    Raises InputError for scenes, densities and risk profiles that there are not.
    """
    found: list[Traffic] = []
    for scene in scenes:
        profiles = [load_scenario(scene, density, risk) for risk in risks or (None,)]
        for k, seed in enumerate(seeds):
            scenario = profiles[k % len(profiles)]
            if scenario.recorded is not None:
                raise InputError(
                    f"{scene}: recorded traffic has no seeds; name it among runs or tracks"
                )
            words = [scenario.name, f"seed {seed}", scenario.risk, scenario.density]
            shipped = scene in find_scenarios()
            build_up_s = 0.0 if scenario.is_user_config else WARM_UP_S
            found.append(
                Traffic(
                    name=", ".join(word for word in words if word),
                    scenario=scenario,
                    seed=seed,
                    warm_up_s=build_up_s if warm_up_s is None else warm_up_s,
                    duration_s=duration_s,
                    sources=(
                        _seed_of(scenario.name if shipped else str(Path(scene).resolve()), seed),
                    ),
                )
            )
    return found


def traffic_of_tracks(
    patterns: Sequence[str],
    map_path: Path | None,
    recordings: str = "",
    lines: str = "auto",
    drawing: Drawing | None = None,
) -> list[Traffic]:
    """Every recording of some tracks; `recordings` names those wanted, as `000-014`: else all.

    `lines`: reference lines along the "lanes" of the map, along those drawn from the "tracks" of
    other recordings, or "auto", from tracks where there are enough; `drawing`: how these are.

    Raises InputError as `load_tracks` and `with_track_lines` do.
    """
    whole = load_tracks(patterns, map_path, recording_names(recordings))
    found: list[Traffic] = []
    for name, scenario in each_recording(whole, lines, drawing).items():
        assert scenario.recorded is not None
        files = own_files(scenario.recorded)
        cases = frozenset(own_cases(scenario.recorded))
        found.append(
            Traffic(
                name=f"{scenario.name}, {name}",
                scenario=scenario,
                seed=0,
                warm_up_s=0.0,
                duration_s=None,
                sources=tuple(Source(content_hash(path), str(path), cases) for path in files),
            )
        )
    return found


def traffic_of_runs(folders: Sequence[str]) -> list[Traffic]:
    """The logs of runs. Raises InputError where a folder is not of a run."""
    found: list[Traffic] = []
    for folder in folders:
        scenario = load_tracks((folder,), None)
        path = Path(folder)
        sources = [Source(content_hash(path / "run.json"), f"the run {path}")]
        header = read_run(path).header
        scene, seed = str(header.get("scene", path.name)), header.get("seed")
        if isinstance(seed, int):
            sources.append(_seed_of(scene, seed))
        found.append(
            Traffic(
                name=f"{scene}, run {path.resolve().name}",
                scenario=replace(scenario, name=scene),
                seed=seed if isinstance(seed, int) else 0,
                warm_up_s=0.0,
                duration_s=None,
                sources=tuple(sources),
            )
        )
    return found


def make_split(
    parts: Mapping[str, Iterable[Traffic]], called: Mapping[str, str] | None = None
) -> Split:
    """A split of parts by their names; `called`: what errors call them.

    Raises InputError where two parts, or one part twice, have something in common, and where there
    is nothing to learn from or nothing to tune on.
    """
    called = {name: name for name in PARTS} | dict(called or {})
    traffic = {name: tuple(parts.get(name, ())) for name in PARTS}
    for name in ("train", "tune"):
        if not traffic[name]:
            raise InputError(f"{called[name]}: expected at least one piece of traffic, found none")
    for k, first in enumerate(PARTS):
        _refuse_twice(called[first], traffic[first])
        for second in PARTS[k + 1 :]:
            _refuse_shared(called[first], traffic[first], called[second], traffic[second])
    return Split(**traffic)


def _refuse_shared(
    first: str, ours: Sequence[Traffic], second: str, theirs: Sequence[Traffic]
) -> None:
    by_key: dict[str, list[Source]] = {}
    for source in (source for one in theirs for source in one.sources):
        by_key.setdefault(source.key, []).append(source)
    shared = dict.fromkeys(
        source.words
        for one in ours
        for source in one.sources
        if any(source.shares(other) for other in by_key.get(source.key, ()))
    )
    if shared:
        more = f" and {len(shared) - MOST_SHOWN} more" if len(shared) > MOST_SHOWN else ""
        raise InputError(
            f"{first} and {second} share {', '.join(list(shared)[:MOST_SHOWN])}{more}: what is "
            "learnt from, tuned on and tested on must be different traffic; take it out of one"
        )


def _refuse_twice(where: str, traffic: Sequence[Traffic]) -> None:
    seen: set[tuple[object, ...]] = set()
    for one in traffic:
        key = (one.sources, one.scenario.risk, one.scenario.density)
        if key in seen:
            raise InputError(f"{where}: {one.name} is named twice; name it once")
        seen.add(key)


def _seed_of(scene: str, seed: int) -> Source:
    """The same seed of a scene is the same demand, whoever drives."""
    return Source(f"{scene} {seed}", f"seed {seed} of {Path(scene).name}")


def _card(part: Sequence[Traffic]) -> list[dict[str, Any]]:
    """Traffic of one kind in one entry, with the list of its seeds or recordings."""
    entries: dict[tuple[object, ...], dict[str, Any]] = {}
    for one in part:
        scenario = one.scenario
        if scenario.recorded is None:
            key = (scenario.name, scenario.risk, scenario.density, one.duration_s, one.warm_up_s)
            entry = entries.setdefault(
                key,
                {
                    "scene": scenario.name,
                    "risk": scenario.risk,
                    "density": scenario.density,
                    "duration_s": one.duration_s,
                    "warm_up_s": one.warm_up_s,
                    "seeds": [],
                },
            )
            entry["seeds"].append(one.seed)
            continue
        is_run = scenario.recorded.map_path is None
        kind = "runs" if is_run else "recordings"
        lines = "lanes" if scenario.recorded.drawn is None else "tracks"
        of_map = _map_card(scenario.recorded.map_path)
        key = (scenario.name, kind, lines, *of_map.values())
        new = {"site": scenario.name, "lines": lines, **of_map, kind: []}
        entry = entries.setdefault(key, new)
        cases = own_cases(scenario.recorded)
        files = own_files(scenario.recorded)
        names = [path.resolve().name for path in files]
        entry[kind].append({"files": names, "cases": list(cases)} if cases else ", ".join(names))
        if not is_run and not cases:
            # Of pedestrians beside vehicles there may be none, in many files alike.
            entry.setdefault(CONTENT, []).append(content_hash(files[0]))
        if one.doubts:
            entry.setdefault(DOUBTS, []).extend(one.doubts)
    return list(entries.values())


def _map_card(path: Path | None) -> dict[str, str]:
    return {} if path is None else {"map": path.name, "map_sha256": content_hash(path)}
