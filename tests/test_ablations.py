"""The networks of the paper's ablations against its tables, and a small study from end to end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hatn_sim import cli
from hatn_sim.datatypes import FloatArray, IntArray
from hatn_sim.evaluation.arrays import displacement_scores, error_scores
from hatn_sim.evaluation.paper import SUMMARISES, TABLES
from hatn_sim.hatn.edn_settings import PAPER, EdnSettings
from hatn_sim.hatn.sgn_settings import paper_sgn
from hatn_sim.learn import ablation_training, ablations
from hatn_sim.learn.ablation_scores import judge
from hatn_sim.learn.ablation_training import (
    Job,
    Study,
    card_of,
    is_trained,
    load_edn,
    path_of,
    rows_where,
    train_model,
    whole,
)
from hatn_sim.learn.ablations import OURS, EdnModel, Row, SgnModel, in_order, models_of, rows_of
from hatn_sim.learn.cache import SampleCache
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.edn_training import vehicle_batch
from hatn_sim.learn.fit import FitSettings
from hatn_sim.learn.sources import gather
from hatn_sim.learn.split import PARTS, Split
from hatn_sim.learn.split_file import read_split
from hatn_sim.learn.watch import Nobody

SPLIT = """
[[train]]
scenes = ["intersection4_allway"]
seeds = "1"
density = "dense"
duration_s = 15
warm_up_s = 45

[[tune]]
scenes = ["intersection4_allway"]
seeds = "2"
density = "dense"
duration_s = 15
warm_up_s = 45

[[test]]
scenes = ["intersection4_allway", "roundabout4_two_lane"]
seeds = "3"
density = "dense"
duration_s = 8
warm_up_s = 45
"""


class Counting:
    """A `Teller` that may stop a training."""

    def __init__(self, stop_at: int | None = None) -> None:
        self.told, self._stop_at = 0, stop_at

    def tell(self, steps: int) -> None:
        self.told = steps
        if steps == self._stop_at:
            raise KeyboardInterrupt


# --- which networks


@pytest.mark.parametrize("table", ablations.TABLES)
def test_every_row_of_the_paper_has_a_network(table: str) -> None:
    ours = [(row.table, row.name) for row in rows_of(table)]
    assert len(set(ours)) == len(ours)
    paper = {(part.key, name) for part in TABLES[table] for name in part.rows}
    assert paper == {place for place in ours if place[1] != OURS}


def test_networks_are_the_same_where_the_papers_numbers_are() -> None:
    """Its tables repeat a row exactly where they go on from it."""
    for tables in (("edn",), ("intention",)):
        cells = {
            (part.key, name): dict(row)
            for table in tables
            for part in TABLES[table]
            for name, row in part.rows.items()
        }
        model = {(row.table, row.name): row.model for table in tables for row in rows_of(table)}
        # Time by Transform reads as if nothing had been added to the goal as Input.
        cells.pop(("intention.c", "Transform"), None)
        for one, other in combinations(cells, 2):
            assert (cells[one] == cells[other]) == (model[one] == model[other]), (one, other)


def test_no_network_is_trained_twice() -> None:
    counts = {"sgn": 8, "edn": 14, "intention": 16, "summary": 8}
    for table, count in counts.items():
        models = models_of(rows_of(table))
        assert len(models) == len(set(models)) == count
    # Shared: the best without intention, and the two graph networks that tell goals.
    every = models_of([row for table in ablations.TABLES for row in rows_of(table)])
    assert len(every) == 8 + 14 + 16 - 3
    first, later = in_order(every)
    assert set(first) | set(later) == set(every)
    told_by = {model.goals for model in later if isinstance(model, EdnModel)}
    assert {goals for goals in told_by if isinstance(goals, SgnModel)} <= set(first)


def test_steps_of_the_tables_change_what_they_say() -> None:
    model = {(row.table, row.name): row.model for table in ("edn", "intention", "summary")
             for row in rows_of(table)}  # fmt: skip

    def change(one: tuple[str, str], other: tuple[str, str]) -> Mapping[str, Any]:
        first, second = model[one], model[other]
        assert isinstance(first, EdnModel) and isinstance(second, EdnModel)
        before, after = asdict(first.settings), asdict(second.settings)
        return {key: value for key, value in after.items() if value != before[key]}

    changes = {
        (("edn.a", "Frenet"), ("edn.a", "Cartesian")): {"coordinates": "cartesian"},
        (("edn.a", "Frenet"), ("edn.c", "yaw in")): {"speed_in": True, "yaw_in": True},
        (("edn.b", "speed in"), ("edn.c", "yaw out")): {"yaw_out": True},
        (("edn.c", "yaw in"), ("edn.d", "incremental")): {"incremental": True},
        (("edn.c", "yaw in"), ("edn.d", "aligned")): {"aligned": True},
        (("edn.e", "neither"), ("edn.e", "attention")): {"attention": True},
        (("edn.e", "neither"), ("intention.a", "Hidden")): {"goal": "hidden"},
        (("intention.b", "Input"), ("intention.c", "Output")): {"clock": "output"},
    }
    for (one, other), expected in changes.items():
        assert change(one, other) == expected
    # The end of the way is the paper's best as it ships, told by the paper's graph network.
    assert model["summary", "Time Signal"] == EdnModel(PAPER, SgnModel(paper_sgn()))
    assert all(model["summary", name] == model[place] for name, place in SUMMARISES.items())


# --- a small study


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Split:
    path = tmp_path_factory.mktemp("split") / "split.toml"
    path.write_text(SPLIT)
    return read_split(path)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory, split: Split) -> SampleCache:
    found = SampleCache(tmp_path_factory.mktemp("samples"))
    for part in PARTS:
        gather(part, split.part(part), found, 1, Nobody())
    return found


@pytest.fixture
def study(tmp_path: Path, split: Split, cache: SampleCache) -> Study:
    return Study(split, cache, tmp_path, FitSettings(epochs=2, batch=16))


@pytest.fixture(scope="module")
def tuning(split: Split, cache: SampleCache) -> Samples:
    return gather("tune", split.tune, cache, 1, Nobody())


GOAL_FREE = EdnModel(
    EdnSettings(width=8, decoder="plain", goal="none", goal_steps=1, clock="none"), "none"
)
TRUE_GOAL = EdnModel(EdnSettings(width=8, decoder="plain", goal_steps=1), "true")


def test_scores_are_those_of_the_network_by_hand(study: Study, tuning: Samples) -> None:
    rows = [Row("intention.a", "Input", TRUE_GOAL), Row("edn.e", "neither", GOAL_FREE)]
    for row in rows:
        train_model(Job(study, row.model), Counting())
    judged = judge(study, rows, {"s": tuning}, {"curve": ("edn.e", "neither"), "no": ("x", "y")})
    assert judged.clustered_over == "vehicles"
    known = rows_where(tuning, whole(tuning))
    everything = torch.arange(len(known)).numpy()
    for row, told in zip(rows, (known.goal_m[:, :1], np.zeros((len(known), 1))), strict=True):
        assert isinstance(row.model, EdnModel)
        goal = torch.from_numpy(told.astype(np.float32))
        with torch.no_grad():
            xy = load_edn(study, row.model)(vehicle_batch(known, everything), goal).numpy()
        error = np.hypot(*np.moveaxis(xy - known.future_xy, -1, 0))
        (found,) = (one for one in judged.rows if (one.table, one.name) == (row.table, row.name))
        by_measure = {s.measure: s for s in found.scores if s.subset == "all"}
        for measure, of_each in {
            "ade_3s": error.mean(axis=1),
            "ade_0s3": error[:, :3].mean(axis=1),
            "fde_3s": error[:, -1],
        }.items():
            score = by_measure[measure]
            assert score.n == len(known) and score.scene == "s"
            assert score.value == pytest.approx(of_each.mean(), rel=1e-4)
            assert score.std == pytest.approx(of_each.std(), rel=1e-3)
            # Of resamples of vehicles by another generator.
            bounds = interval_by_hand(of_each, known.vehicle)
            assert (score.low, score.high) == pytest.approx(bounds, rel=0.1)
        if row.name == "neither":
            (curve,) = judged.steps
            assert (curve.predictor, curve.n) == ("curve", len(known))
            assert curve.mean_m == pytest.approx(error.mean(axis=0), rel=1e-3)


def interval_by_hand(values: FloatArray, vehicle: IntArray) -> tuple[float, float]:
    random = np.random.default_rng(17)
    groups = [values[vehicle == one] for one in np.unique(vehicle)]
    means = [
        np.concatenate([groups[k] for k in random.integers(0, len(groups), len(groups))]).mean()
        for _ in range(2000)
    ]
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def test_scores_of_errors_are_those_of_the_positions() -> None:
    random = np.random.default_rng(3)
    predicted, future = random.normal(size=(2, 40, 30, 2))
    goal_m, cluster = random.uniform(0, 9, 40), random.integers(0, 7, 40)
    error_m = np.linalg.norm(predicted - future, axis=2)
    assert error_scores("n", "s", error_m, goal_m, cluster) == displacement_scores(
        "n", "s", predicted, future, goal_m, cluster
    )


def test_a_stopped_training_goes_on_and_ends_the_same(study: Study, tmp_path: Path) -> None:
    elsewhere = Study(study.split, study.cache, tmp_path / "other", study.how)
    train_model(Job(elsewhere, GOAL_FREE), Counting())
    job = Job(study, GOAL_FREE)
    last = Counting()
    with pytest.raises(KeyboardInterrupt):
        train_model(job, Counting(stop_at=6))
    assert not is_trained(study, GOAL_FREE)
    card = train_model(job, last)
    assert card["samples"] > 40 and set(card["tune_figures"]) == {"ade_3s_m", "ade_0s3_m"}
    path, other = path_of(study, GOAL_FREE), path_of(elsewhere, GOAL_FREE)
    assert path.name == other.name and not path.with_suffix(".progress").exists()
    ours, theirs = (load_edn(one, GOAL_FREE).state_dict() for one in (study, elsewhere))
    assert all(torch.equal(ours[key], theirs[key]) for key in ours)


def test_a_network_hangs_on_all_that_it_was_made_of(study: Study, split: Split) -> None:
    names = {
        path_of(one, model).name
        for one in (
            study,
            Study(split, study.cache, study.folder, study.how, seed=1),
            Study(split, study.cache, study.folder, FitSettings(epochs=3, batch=16)),
            Study(Split(split.test, split.tune), study.cache, study.folder, study.how),
        )
        for model in (GOAL_FREE, TRUE_GOAL, SgnModel(paper_sgn()))
    }
    assert len(names) == 4 * 3
    judged_elsewhere = Study(Split(split.train, split.tune), study.cache, study.folder, study.how)
    assert path_of(judged_elsewhere, GOAL_FREE) == path_of(study, GOAL_FREE)


def test_a_damaged_file_is_as_if_it_were_not_there(study: Study) -> None:
    path = path_of(study, GOAL_FREE)
    path.write_bytes(b"\x10")
    assert not is_trained(study, GOAL_FREE) and card_of(study, GOAL_FREE) == {}


@pytest.mark.slow
def test_a_table_from_end_to_end_is_not_trained_again(
    tmp_path: Path,
    cache: SampleCache,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ablations, "rows_of", lambda table: rows_of(table, width=8))
    Path("split.toml").write_text(SPLIT)
    words = ["evaluate", "--table", "summary", "--split", "split.toml", "--epochs", "1"]
    words += ["--cache", str(cache.folder), "--workers", "1", "--out", "out", "--quiet"]
    assert cli.main(words) == 0
    printed = capsys.readouterr().out
    for part in (
        "Summary of the ablations",
        "Baseline",
        "Ours",
        "hatn, which does not",
        "(seeds 1, 15 s each)",
        "standing or moving",
        "bootstrapped over vehicles",
    ):
        assert part in printed
    out = Path("out")
    assert len(list((out / "models").glob("*.safetensors"))) == 8
    for name in ("csv", "json"):
        assert (out / f"summary.{name}").is_file()
    for name in ("csv", "png", "pdf"):
        assert (out / f"summary-steps.{name}").is_file()

    def never(*_: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(ablation_training, "train_model", never)
    assert cli.main([*words, "--json"]) == 0
    again = capsys.readouterr().out
    assert json.loads(again) == json.loads((out / "summary.json").read_text())
    filled = {(entry["scene"], entry["row"]) for entry in json.loads(again) if entry["n"]}
    assert len(filled) == 2 * 6
    assert cli.main(["evaluate", "--table", "summary", "--rows", "out/summary-rows.json"]) == 0
    numbers = [line for line in printed.splitlines() if "±" in line]
    assert set(numbers[:-1]) <= set(capsys.readouterr().out.splitlines())


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--split", "split.toml", "--seeds", "5"], "--seeds: --split names all traffic"),
        (["--torch-seed", "-1"], "--torch-seed -1: expected 0 or more"),
        (["--split", "no_test.toml"], "no_test.toml: expected [[test]], what to judge on"),
        (["--seeds", "1"], "seeds 1-4, learnt from and --seeds share seed 1 of intersection5"),
        (["--seeds", "101"], "seed 101, tuned on and --seeds share seed 101 of intersection5"),
    ],
)
def test_traffic_that_cannot_be_is_refused(
    words: list[str],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("split.toml").write_text(SPLIT)
    Path("no_test.toml").write_text(SPLIT.partition("[[test]]")[0])
    assert cli.main(["evaluate", "--table", "edn", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"hatn-sim: {expected}")
    assert not Path("runs").exists()
