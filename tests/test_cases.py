"""The case studies, on three crossings made by hand where it is known who goes when."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from itertools import combinations, pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from hatn_sim.cli import main
from hatn_sim.commands.run_header import trained_on
from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
    Advice,
    Frame,
    Kind,
    Lane,
    Prediction,
    Scene,
    SemanticGraphs,
    Truth,
)
from hatn_sim.errors import InputError
from hatn_sim.graph import build_graphs
from hatn_sim.log import Run, RunWriter, read_run
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.perception import begin, perceive
from hatn_sim.report.case_cast import (
    BEYOND_WORDS,
    COLOURS,
    cast_of,
    panel_words,
    story_words,
)
from hatn_sim.report.case_figure import DPI, FOOTER_IN, MARGIN_IN, WIDTH_IN
from hatn_sim.report.case_legend import draw_legend
from hatn_sim.report.case_moments import APART_FRAMES, Beat, key_frames
from hatn_sim.report.cases import KINDS, Case, find_cases
from hatn_sim.report.moment import Moment, Slot, read_moments
from hatn_sim.report.story import read_choices, stories
from hatn_sim.road import Road

FRAMES = 170
LANES = [
    Lane("east", np.array([[-120.0, 0.0], [120.0, 0.0]]), 3.5, 13.9, (), frozenset({Kind.CAR})),
    *(
        Lane(name, np.array([[x, -120.0], [x, 120.0]]), 3.5, 13.9, (), frozenset({Kind.CAR}))
        for name, x in (("first", 0.0), ("second", 30.0), ("third", 60.0))
    ),
]
# Seconds -> metres east of (0, 0): slow before the first crossing, there after 6, 9 and 12 s.
EGO = (
    (0.0, -25.0),
    (2.0, -10.0),
    (4.0, -8.0),
    (6.0, 0.0),
    (9.0, 30.0),
    (12.0, 60.0),
    (17.0, 110.0),
)
OTHERS = {
    # (x of the lane, second at which it crosses, m/s)
    "before": (0.0, 2.5, 8.0),
    "after": (0.0, 8.0, 6.0),
    "next": (30.0, 11.0, 6.0),
    "last": (60.0, 14.0, 6.0),
}
GOES_FRAME = 45
"""Until then the ego is said to yield, although there has been nobody to yield to since 2.5 s."""


def scene_at(frame: int) -> Scene:
    time_s = DT_S * frame
    knots_s, knots_m = np.array(EGO).T
    ego_m, next_m = np.interp([time_s, time_s + DT_S], knots_s, knots_m)
    x = [ego_m, *(lane_m for lane_m, _, _ in OTHERS.values())]
    y = [0.0, *(speed * (time_s - at_s) for _, at_s, speed in OTHERS.values())]
    count = 1 + len(OTHERS)
    return Scene(
        time_s=time_s,
        ids=("ego", *OTHERS),
        xy_m=np.stack((x, y), axis=1),
        yaw_rad=np.array([0.0] + [0.5 * np.pi] * len(OTHERS)),
        speed_mps=np.array([(next_m - ego_m) / DT_S, *(speed for _, _, speed in OTHERS.values())]),
        size_m=np.tile([4.0, 1.8], (count, 1)),
        kind=np.zeros(count, dtype=np.int64),
        colour=np.zeros((count, 3), dtype=np.int64),
        blinker=np.zeros(count, dtype=np.int64),
        signal_closed=np.zeros(0, dtype=bool),
    )


def chances(frame: int, graphs: SemanticGraphs) -> np.ndarray:
    """The ego yields with 90 %, from `GOES_FRAME` on with 10 %; the next best slot has the rest."""
    chance = np.zeros(graphs.node_mask.shape)
    yields = 0.9 if frame < GOES_FRAME else 0.1
    for e in np.flatnonzero(graphs.has_conflict):
        slots = np.flatnonzero(graphs.focus_mask[e])
        chance[e, 0], chance[e, slots[-1]] = yields, 1.0 - yields
    return chance


def write_run(
    out: Path, frames: int = FRAMES, header: Mapping[str, object] | None = None, slots: bool = True
) -> Run:
    writer = RunWriter(out, {"scene": "crossings", "title": "Crossings", **(header or {})})
    state = begin(Road(LANES))
    for frame in range(frames):
        scene = scene_at(frame)
        state = perceive(state, scene, None)
        graphs = build_graphs(state.road, state.seen)
        heading = np.stack((np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)), axis=1)
        ahead_m = scene.speed_mps[:, None] * DT_S * np.arange(1, HORIZON_FRAMES + 1)
        count = len(scene.ids)
        prediction = Prediction(
            ids=scene.ids,
            xy_m=(scene.xy_m[:, None] + heading[:, None] * ahead_m[:, :, None])[:, None],
            mode_probability=np.ones((count, 1)),
            fallback=np.zeros(count, dtype=bool),
            adapted=np.zeros(count, dtype=bool),
            lines=state.seen.lines,
            graphs=graphs,
            slot_probability=chances(frame, graphs) if slots else None,
        )
        advice = {"made_up": Advice(prediction, (), ())}
        writer.write(frame, Frame(scene, Truth((None,) * count), False), advice)
    writer.close(finished=True)
    write_road(out / ROAD_FILE, LANES)
    return read_run(out)


@pytest.fixture(scope="module")
def crossings(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return write_run(tmp_path_factory.mktemp("runs") / "crossings")


@pytest.fixture(scope="module")
def cases(crossings: Run) -> dict[str, Case]:
    """Each kind sought for itself: together, the last two must differ."""
    return {name: find_cases([crossings], (name,))[name] for name in KINDS}


def named(run: Run, vehicles: tuple[int, ...]) -> list[str]:
    return [run.ids[v] for v in vehicles]


# -- what befell the ego --------------------------------------------------------------------------


def test_who_went_first_at_each_conflict(crossings: Run) -> None:
    met = dict(stories(read_choices(crossings)))[crossings.ids.index("ego")]
    first, second, third = met
    assert (named(crossings, first.let_go), first.let_go_frame) == (["before"], (25,))
    assert (named(crossings, first.passed), first.passed_frame) == (["after"], (80,))
    assert [named(crossings, one.passed) for one in met] == [["after"], ["next"], ["last"]]
    assert not second.let_go and not third.let_go
    assert [one.crossed_frame for one in met] == [60, 90, 120]
    assert first.last_frame < second.first_frame <= 64


# -- which case -----------------------------------------------------------------------------------


def test_one_interaction_is_found(crossings: Run, cases: dict[str, Case]) -> None:
    case = cases["interaction"]
    (one,) = case.encounters
    assert crossings.ids[case.ego] == "ego"
    assert (named(crossings, one.let_go), named(crossings, one.passed)) == (["before"], ["after"])
    assert 4 <= len(case.frames) <= 6
    # Panels before and after the change of what is likeliest, and one of the end.
    assert case.frames[0] < GOES_FRAME < case.frames[-2] < 60 < case.frames[-1]


def test_a_sequence_is_found(crossings: Run, cases: dict[str, Case]) -> None:
    case = cases["sequence"]
    assert [one.crossed_frame for one in case.encounters] == [60, 90, 120]
    for low, high in ((0, 60), (65, 90), (95, 120)):
        assert any(low <= frame <= high for frame in case.frames)
    assert 4 <= len(case.frames) <= 8


def test_a_change_of_plan_is_found_where_the_networks_did_not_learn(
    crossings: Run, cases: dict[str, Case], tmp_path: Path
) -> None:
    case = cases["transfer"]
    assert [one.crossed_frame for one in case.encounters] == [60, 90]
    assert any(GOES_FRAME - 15 <= frame < GOES_FRAME for frame in case.frames)
    assert any(GOES_FRAME <= frame <= GOES_FRAME + 15 for frame in case.frames)
    learnt = write_run(tmp_path / "learnt", header={"trained_on": ["crossings", "another"]})
    assert set(find_cases([learnt], tuple(KINDS))) == {"interaction", "sequence"}
    other = write_run(tmp_path / "other", header={"trained_on": ["another"]})
    # Of equally telling ones the first is taken.
    found = find_cases([learnt, other, crossings], ("transfer", "interaction"))
    assert found["transfer"].run is other and found["interaction"].run is learnt


def test_a_sequence_and_a_transfer_are_never_the_same_moment(
    crossings: Run, cases: dict[str, Case], tmp_path: Path
) -> None:
    """One ego has all there is to tell; in a second run its like has it as well."""
    assert cases["sequence"].ego == cases["transfer"].ego
    found = find_cases([crossings], tuple(KINDS))
    assert list(found) == ["interaction", "transfer"]
    other = write_run(tmp_path / "other")
    found = find_cases([crossings, other], tuple(KINDS))
    assert list(found) == list(KINDS)
    assert {found[name].run.path for name in ("sequence", "transfer")} == {
        crossings.path, other.path
    }  # fmt: skip


def test_a_run_says_what_its_weights_learnt_from() -> None:
    part = {"risk": None, "seeds": [1]}
    split = {
        "train": [{"scene": "roundabout8", **part}, {"site": "harbour", "runs": ["a"]}],
        "tune": [{"scene": "roundabout8", **part}],
        "test": [{"scene": "tjunction", **part}],
    }
    learnt = SimpleNamespace(weights=SimpleNamespace(card={"split": split}))
    assert trained_on(learnt) == ["harbour", "roundabout8"]  # type: ignore[arg-type]
    tuned = SimpleNamespace(weights=SimpleNamespace(card={"start": {"split": split}, "split": {
        "train": [{"scene": "intersection5", **part}], "tune": [],
    }}))  # fmt: skip
    assert trained_on(tuned) == ["harbour", "intersection5", "roundabout8"]  # type: ignore[arg-type]
    assert trained_on(SimpleNamespace()) == []  # type: ignore[arg-type]


# -- what is said ---------------------------------------------------------------------------------


def test_words_tell_what_was_said_and_what_happened(crossings: Run, cases: dict[str, Case]) -> None:
    case = cases["interaction"]
    cast = cast_of(list(read_moments(crossings, case.frames, "ego")))
    assert {vehicle: part.name for vehicle, part in cast.items() if vehicle != "next"} == {
        "ego": "A1",
        "before": "A2",
        "after": "A3",
    }
    assert story_words(case, cast) == "The ego lets A2 go first and passes before A3."
    said = panel_words(case, cast, 15)
    assert (said.said, said.happened, said.wrong) == (
        "Yields (90 %).",
        "It did: A2 went first.",
        False,
    )
    said = panel_words(case, cast, 40)
    assert (said.said, said.happened, said.wrong) == (
        "Yields (90 %).",
        "Wrong: it passed before A3.",
        True,
    )
    said = panel_words(case, cast, 50)
    assert (said.said, said.happened) == ("Passes before A3 (90 %).", "It did.")
    said = panel_words(case, cast, 150)
    assert (said.said, said.happened) == ("No conflict ahead.", "It has crossed.")


@pytest.mark.parametrize(
    ("frames", "happened"),
    [
        (125, "It went; nobody was seen to follow soon."),
        (110, "Nobody was seen to cross until the end of the run."),
    ],
)
def test_words_where_the_log_ends_too_soon(tmp_path: Path, frames: int, happened: str) -> None:
    """The ego crosses the third way at frame 120, another at 140; the case is of the first way."""
    run = write_run(tmp_path / "run", frames)
    case = find_cases([run], ("interaction",))["interaction"]
    cast = cast_of(list(read_moments(run, case.frames, "ego")))
    assert panel_words(case, cast, 100).happened == happened


@pytest.mark.parametrize(
    ("said_to_yield", "happened", "is_wrong"),
    [
        (True, "Right in the end: A2 went first, 6.0\u00a0s later.*", False),
        (False, "Wrong in the end: A2 went first, 6.0\u00a0s later.*", True),
    ],
)
def test_what_comes_later_than_scores_look_is_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    said_to_yield: bool,
    happened: str,
    is_wrong: bool,
) -> None:
    """They are at (0, 0) 9 s and 7 s after the start: the other 6 s after frame 10."""
    monkeypatch.setattr(sys.modules[__name__], "EGO", ((0.0, -45.0), (9.0, 0.0), (17.0, 60.0)))
    late = {"late": (0.0, 7.0, 5.0), "last": (60.0, 30.0, 3.0)}
    monkeypatch.setattr(sys.modules[__name__], "OTHERS", late)
    monkeypatch.setattr(sys.modules[__name__], "GOES_FRAME", FRAMES if said_to_yield else 0)
    run = write_run(tmp_path / "run")
    choices = read_choices(run)
    ego = run.ids.index("ego")
    met = tuple(dict(stories(choices))[ego])
    case = Case(KINDS["interaction"], run, choices, ego, met[:1], (10, 30), 0.0)
    cast = cast_of(list(read_moments(run, case.frames, "ego")))
    told = panel_words(case, cast, 10)
    assert (told.happened, told.wrong) == (happened, is_wrong)
    # From frame 30 on the other is there within the 5 s of the scores.
    assert not panel_words(case, cast, 30).happened.endswith("*")


def slot(rear_id: str) -> Slot:
    nowhere = np.zeros((2, 2))
    return Slot(rear_id, rear_id == "ego", True, 0.5, nowhere, None)


def test_colours_are_told_apart_within_and_between_neighbouring_panels() -> None:
    scene = scene_at(0)
    panels = [[f"v{k + n}" for n in range(4)] for k in range(0, 24, 2)]
    moments = [
        Moment(scene, "ego", (slot("ego"), *(slot(v) for v in met)), {}, None) for met in panels
    ]
    cast = cast_of(moments)
    assert len({part.name for part in cast.values()}) == len(cast) == 27
    for here, there in pairwise(panels):
        shown = {cast[v].colour for v in {*here, *there}}
        assert len(shown) == len({*here, *there}) and shown <= set(COLOURS)


def test_signals_have_a_key_that_fits() -> None:
    """As matplotlib draws it: words of a line neither touch nor leave the page."""
    figure = Figure(figsize=(WIDTH_IN, 1.0), dpi=DPI)
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.set(xlim=(0.0, WIDTH_IN), ylim=(0.0, 1.0))
    draw_legend(page, (MARGIN_IN, WIDTH_IN - MARGIN_IN), FOOTER_IN, 3.0, BEYOND_WORDS, True)
    FigureCanvasAgg(figure).draw()
    words = {text.get_text(): text for text in page.texts}
    assert {"signal closed", "open", BEYOND_WORDS} <= words.keys()
    for y in {text.get_position()[1] for text in page.texts}:
        of_line = [text.get_window_extent() for text in page.texts if text.get_position()[1] == y]
        ends = sorted((box.x0, box.x1) for box in of_line)
        assert ends[-1][1] < DPI * (WIDTH_IN - MARGIN_IN)
        assert all(one[1] < other[0] for one, other in pairwise(ends))


def test_panels_are_apart_and_never_too_few() -> None:
    beats = [Beat(0, 10), Beat(1, 12), Beat(1, 40), Beat(2, 41), Beat(0, 60), Beat(0, 99)]
    # 12 and 41 are too near to what goes before them, 99 is behind the end; three are no four.
    frames = key_frames(beats, 0, 70, 6)
    assert {10, 40, 60} < set(frames) and len(frames) == 4
    assert key_frames([Beat(1, f) for f in range(300)], 0, 299, 8) == tuple(range(0, 48, 6))
    for a, b in combinations(frames, 2):
        assert abs(a - b) >= APART_FRAMES
    assert key_frames([Beat(0, 3)], 0, 8, 6) == (3,)


# -- the figure and the command -------------------------------------------------------------------


def test_figures_are_drawn_and_the_same_every_time(
    crossings: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one", "two"):
        words = ["figures", str(crossings.path), "--only", "interaction", "--formats", "png,pdf"]
        assert main([*words, "--out", str(tmp_path / name)]) == 0
    told = capsys.readouterr().out.split()
    files = ["interaction.png", "interaction.pdf"]
    assert told[:2] == [str(tmp_path / "one" / file) for file in files]
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    picture = np.asarray(Image.open(tmp_path / "one" / files[0]).convert("RGB"))
    assert picture.shape[1] == 2160
    colours = {int(colour[1:], 16) for colour in COLOURS[:2]}
    assert colours <= set(np.unique(picture @ np.array([0x10000, 0x100, 1])).tolist())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--only", "sequences"], "did you mean 'sequence'"),
        (["--only", "transfer", "--ego", "ego"], "--ego: without effect on transfer"),
        (["--only", "transfer", "--time", "3"], "--time: without effect on transfer"),
    ],
)
def test_wrong_words_are_one_line(
    crossings: Run, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["figures", str(crossings.path), *words]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1


def test_a_run_without_a_case_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = write_run(tmp_path / "short", frames=40)
    assert main(["figures", str(short.path), "--only", "interaction"]) == 2
    error = capsys.readouterr().err
    assert "no case to draw: expected an ego that yields" in error and error.count("\n") == 1
    assert not list(short.path.rglob("interaction*"))


def test_a_case_that_is_not_there_does_not_hide_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    learnt = write_run(tmp_path / "learnt", frames=110, header={"trained_on": ["crossings"]})
    # Of several runs only cases are drawn.
    assert main(["figures", str(learnt.path), str(learnt.path)]) == 0
    printed = capsys.readouterr()
    left_out = printed.err.splitlines()
    assert [line.split()[1] for line in left_out] == ["sequence", "transfer"]
    assert "where the networks were not trained" in left_out[1]
    names = [Path(line).name for line in printed.out.split()]
    assert names == ["interaction.pdf", "interaction.svg", "interaction.png"]


def test_a_predictor_without_slots_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="gives no ego of this run slots to choose from"):
        read_choices(write_run(tmp_path / "mute", frames=20, slots=False))
