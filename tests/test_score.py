"""Measures on hand-made runs against answers by hand: zero, finite, undefined."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from sklearn.metrics import f1_score

from hatn_sim.datatypes import (
    HORIZON_FRAMES,
    Advice,
    Frame,
    Kind,
    Prediction,
    Scene,
    Score,
    SemanticGraphs,
    Truth,
)
from hatn_sim.errors import InputError
from hatn_sim.log import Run, RunWriter, read_run
from hatn_sim.report.table import score_table, scores_json, write_scores
from hatn_sim.score import intervals
from hatn_sim.score.prediction import MOVING_MEASURES, UNITS, score_run, score_runs
from hatn_sim.score.samples import clustered_over
from hatn_sim.score.steps import errors_by_step

ONE_SAMPLE = 45
"""Frames of a run in which each vehicle is sampled once, at frame 10."""


class Traffic:
    """Vehicles at constant velocity: positions are xy0 + 0.1 * frame * velocity."""

    def __init__(self, xy_m: np.ndarray, velocity_mps: np.ndarray, kind: Kind = Kind.CAR) -> None:
        self.xy_m, self.velocity_mps = xy_m, velocity_mps
        self.kind = np.full(len(xy_m), kind, dtype=np.int64)
        self.ids = tuple(f"v{n}" for n in range(len(xy_m)))

    def at(self, frame: int) -> np.ndarray:
        return self.xy_m + 0.1 * frame * self.velocity_mps

    def frame(self, index: int) -> Frame:
        count = len(self.ids)
        scene = Scene(
            time_s=0.1 * index,
            ids=self.ids,
            xy_m=self.at(index),
            yaw_rad=np.zeros(count),
            speed_mps=np.linalg.norm(self.velocity_mps, axis=1),
            size_m=np.ones((count, 2)),
            kind=self.kind,
            colour=np.zeros((count, 3), dtype=np.int64),
            blinker=np.zeros(count, dtype=np.int64),
            signal_closed=np.zeros(0, dtype=bool),
        )
        return Frame(scene, Truth((None,) * count), done=False)

    def exact(self, index: int) -> Prediction:
        """The future as it will be, in one mode."""
        ahead = [self.at(index + step) for step in range(1, HORIZON_FRAMES + 1)]
        count = len(self.ids)
        return Prediction(
            ids=self.ids,
            xy_m=np.stack(ahead, axis=1)[:, None],
            mode_probability=np.ones((count, 1)),
            fallback=np.zeros(count, dtype=bool),
            adapted=np.zeros(count, dtype=bool),
        )


Predictor = Callable[[int], Prediction | None]


def make_run(
    out: Path,
    traffic: Traffic,
    predictors: dict[str, Predictor],
    frames: int = ONE_SAMPLE,
    **header: object,
) -> Run:
    with RunWriter(out, {"scene": "made_up", "adapt": "mekf", **header}) as writer:
        for index in range(frames):
            said = {name: predict(index) for name, predict in predictors.items()}
            advice = {name: Advice(p, (), ()) for name, p in said.items() if p is not None}
            writer.write(index, traffic.frame(index), advice)
    return read_run(out)


def value(scores: list[Score], predictor: str, measure: str, subset: str = "all") -> Score:
    found = [
        s for s in scores if (s.predictor, s.measure, s.subset) == (predictor, measure, subset)
    ]
    assert len(found) == 1
    return found[0]


def two_cars() -> Traffic:
    """One at 5 m/s, one standing."""
    return Traffic(np.array([[0.0, 0.0], [50.0, 0.0]]), np.array([[5.0, 0.0], [0.0, 0.0]]))


# --- displacement


def test_an_exact_prediction_has_no_error(tmp_path: Path) -> None:
    traffic = two_cars()
    scores = score_run(make_run(tmp_path / "run", traffic, {"exact": traffic.exact}, frames=60))
    for measure in ("ade_3s", "fde_3s", "ade_0s3", "fde_0s3", "min_ade_3s"):
        for subset, n in (("all", 8), ("moving", 4)):
            score = value(scores, "exact", measure, subset)
            assert (score.value, score.n, score.unit) == (pytest.approx(0.0, abs=1e-6), n, "m")


def test_displacements_are_those_of_the_most_probable_mode(tmp_path: Path) -> None:
    traffic = two_cars()
    drift_m = 0.1 * np.arange(1, HORIZON_FRAMES + 1)  # 0.1 m a frame, sideways

    def drifting(index: int) -> Prediction:
        exact = traffic.exact(index)
        modes = np.repeat(exact.xy_m, 2, axis=1)
        modes[0, 1, :, 1] += drift_m  # the moving car's probable mode
        return replace(exact, xy_m=modes, mode_probability=np.array([[0.4, 0.6]] * 2))

    scores = score_run(make_run(tmp_path / "run", traffic, {"drifting": drifting}))
    by_hand = {"ade_3s": 1.55, "fde_3s": 3.0, "ade_0s3": 0.2, "fde_0s3": 0.3}
    for measure, expected in by_hand.items():
        moving = value(scores, "drifting", measure, "moving")
        assert (moving.value, moving.n) == (pytest.approx(expected, abs=1e-5), 1)
        both = value(scores, "drifting", measure)
        assert (both.value, both.n) == (pytest.approx(expected / 2.0, abs=1e-5), 2)
        assert both.low is not None and both.high is not None
        assert both.low <= both.value <= both.high  # type: ignore[operator]
        assert moving.low is None, "one vehicle leaves nothing to draw from"


def test_pedestrians_are_left_out_and_fallbacks_counted(tmp_path: Path) -> None:
    traffic = Traffic(np.arange(10.0).reshape(5, 2) * 20.0, np.full((5, 2), 3.0))
    traffic.kind[4] = Kind.PEDESTRIAN

    def half(index: int) -> Prediction:
        return replace(traffic.exact(index), fallback=np.array([True, False, False, False, True]))

    scores = score_run(make_run(tmp_path / "run", traffic, {"half": half}))
    fallback = value(scores, "half", "fallback_share")
    assert (fallback.value, fallback.n, fallback.unit) == (0.25, 4, "share")
    assert value(scores, "half", "ade_3s").n == 4


def test_every_predictor_is_scored_on_the_same_samples(tmp_path: Path) -> None:
    traffic = two_cars()

    def seldom(index: int) -> Prediction | None:
        return traffic.exact(index) if index in (10, 15) else None

    run = make_run(tmp_path / "run", traffic, {"main": traffic.exact, "seldom": seldom}, frames=60)
    scores = score_run(run)
    assert [value(scores, name, "ade_3s").n for name in ("main", "seldom")] == [4, 4]


def test_a_run_without_samples_has_no_values(tmp_path: Path) -> None:
    traffic = two_cars()
    scores = score_run(make_run(tmp_path / "run", traffic, {"exact": traffic.exact}, frames=20))
    assert len(scores) == len(UNITS) + len(MOVING_MEASURES)
    for score in scores:
        assert (score.value, score.n, score.low, score.high) == (None, 0, None, None)
    nobody = Traffic(np.zeros((0, 2)), np.zeros((0, 2)))
    for name, predictors in (("nobody", {}), ("unpredicted", {"exact": nobody.exact})):
        for score in score_run(make_run(tmp_path / name, nobody, predictors)):
            assert (score.value, score.n) == (None, 0)
    assert score_runs([]) == []


def modes(traffic: Traffic, probabilities: list[float]) -> Predictor:
    """Of the moving car the first mode is exact, the second drifts 0.1 m a frame sideways."""
    drift_m = 0.1 * np.arange(1, HORIZON_FRAMES + 1)

    def predict(index: int) -> Prediction:
        exact = traffic.exact(index)
        both = np.repeat(exact.xy_m, 2, axis=1)
        both[0, 1, :, 1] += drift_m
        return replace(exact, xy_m=both, mode_probability=np.array([probabilities] * 2))

    return predict


def test_the_least_error_is_of_the_best_mode_that_is_not_ruled_out(tmp_path: Path) -> None:
    traffic = two_cars()
    predictors = {
        "sure": modes(traffic, [1.0, 0.0]),
        "both": modes(traffic, [0.4, 0.6]),
        "wrong": modes(traffic, [0.0, 1.0]),
    }
    scores = score_run(make_run(tmp_path / "run", traffic, predictors))
    for name, least, missed in (("sure", 0.0, 0.0), ("both", 0.0, 1.0), ("wrong", 1.55, 1.0)):
        for subset, share in (("moving", 1.0), ("all", 0.5)):
            found = value(scores, name, "min_ade_3s", subset)
            assert found.value == pytest.approx(share * least, abs=1e-5)
            miss = value(scores, name, "miss_rate_2m", subset)
            assert (miss.value, miss.unit) == (share * missed, "share")


def test_the_deviation_is_over_samples(tmp_path: Path) -> None:
    traffic = two_cars()  # 1.55 m and nothing
    scores = score_run(make_run(tmp_path / "run", traffic, {"both": modes(traffic, [0.4, 0.6])}))
    assert value(scores, "both", "ade_3s").std == pytest.approx(1.55 / 2.0, abs=1e-5)
    assert value(scores, "both", "ade_3s", "moving").std == pytest.approx(0.0)
    assert value(scores, "both", "goal_error").std is None


def test_errors_by_step(tmp_path: Path) -> None:
    traffic = two_cars()
    predictors = {"off": modes(traffic, [0.4, 0.6]), "exact": traffic.exact}
    runs = [make_run(tmp_path / name, traffic, predictors, seed=name) for name in ("a", "b")]
    found = {(one.predictor, one.subset): one for one in errors_by_step(runs)}
    drift_m = 0.1 * np.arange(1, HORIZON_FRAMES + 1)
    every, moving = found["off", "all"], found["off", "moving"]
    assert (every.scene, every.n, moving.n) == ("made_up", 4, 2)
    np.testing.assert_allclose(moving.mean_m, drift_m, atol=1e-5)
    np.testing.assert_allclose(every.mean_m, drift_m / 2.0, atol=1e-5)
    np.testing.assert_allclose(every.std_m, drift_m / 2.0, atol=1e-5)
    np.testing.assert_allclose(found["exact", "all"].mean_m, 0.0, atol=1e-5)
    # What a score says of three and of thirty steps is said of single steps here.
    score = value(score_runs(runs), "off", "fde_3s")
    last = (every.mean_m[-1], every.std_m[-1], every.low_m[-1], every.high_m[-1])
    assert last == pytest.approx((score.value, score.std, score.low, score.high))
    short = make_run(tmp_path / "short", traffic, {"exact": traffic.exact}, frames=20)
    assert errors_by_step([short]) == []


# --- goals


def test_the_share_of_goals_that_the_mixture_covers(tmp_path: Path) -> None:
    traffic = two_cars()  # 15 m and 0 m in 3 s

    def goals(mean_m: list[list[float]], std_m: float) -> Predictor:
        def predict(index: int) -> Prediction:
            return replace(
                traffic.exact(index),
                goal_weight=np.full((2, 2), 0.5),
                goal_mean_m=np.array(mean_m),
                goal_std_m=np.full((2, 2), std_m),
            )

        return predict

    predictors = {
        # 0 m is at 16 % of the standing car's distribution: in the 90 % interval only.
        "some": goals([[15.0, 15.0], [1.0, 1.0]], 1.0),
        "never": goals([[40.0, 41.0], [9.0, 9.0]], 1.0),
        "points": goals([[15.0, 15.0], [0.0, 0.0]], 0.0),
        "split": goals([[5.0, 25.0], [-9.0, 9.0]], 1.0),  # half below, half above
        "none": traffic.exact,
    }
    scores = score_run(make_run(tmp_path / "run", traffic, predictors))
    by_hand = {"some": (0.5, 1.0), "never": (0, 0), "points": (1, 1), "split": (1, 1)}
    for name, expected in by_hand.items():
        found = [value(scores, name, f"goal_coverage_{share}") for share in (50, 90)]
        assert [score.value for score in found] == list(expected), name
        assert {score.n for score in found} == {2}
    undefined = value(scores, "none", "goal_coverage_50")
    assert (undefined.value, undefined.n) == (None, 0)


def test_goal_error_is_of_the_mean_of_the_mixture(tmp_path: Path) -> None:
    traffic = two_cars()  # 15 m and 0 m in 3 s

    def goals(index: int) -> Prediction:
        return replace(
            traffic.exact(index),
            goal_weight=np.array([[0.25, 0.75], [0.5, 0.5]]),
            goal_mean_m=np.array([[10.0, 14.0], [-1.0, 1.0]]),
            goal_std_m=np.ones((2, 2)),
        )

    run = make_run(tmp_path / "run", traffic, {"goals": goals, "none": traffic.exact})
    scores = score_run(run)
    moving = value(scores, "goals", "goal_error", "moving")
    assert (moving.value, moving.n) == (pytest.approx(2.0), 1)
    assert value(scores, "goals", "goal_error").value == pytest.approx(1.0)
    undefined = value(scores, "none", "goal_error")
    assert (undefined.value, undefined.n) == (None, 0)


# --- slots

LABELS = [0, 0, 0, 1, 1, 1]
"""Slots that the six egos of `junctions` take."""


def junctions() -> Traffic:
    """Six junctions far apart: an ego going east, another going north, a third parked.

    Vehicles 3k, 3k + 1, 3k + 2 are those of junction k, whose conflict is at (1000 k, 0). Who goes
    first is there at frame 20, the other at frame 30; the parked one never. One more ego, 18.
    """
    xy, velocity = [], []
    for k, label in enumerate(LABELS):
        first, second = 19.95, 29.95  # m at 10 m/s
        ego_m, other_m = (second, first) if label == 0 else (first, second)
        xy += [[1000.0 * k - ego_m, 0.0], [1000.0 * k, -other_m], [1000.0 * k, -60.0]]
        velocity += [[10.0, 0.0], [0.0, 10.0], [0.0, 0.0]]
    xy.append([-500.0, 0.0])
    velocity.append([10.0, 0.0])
    return Traffic(np.array(xy), np.array(velocity))


def slots(
    traffic: Traffic, answers: list[int], confidences: list[float], single: int = 0
) -> Predictor:
    """A predictor that gives ego k the slot `answers[k]` with a confidence.

    Vehicle 18 has a graph with a conflict and one slot (`single` = 1) or without a conflict (0).
    """

    def predict(index: int) -> Prediction:
        ego = np.array([3 * k for k in range(6)] + [18])
        rear = ego[:, None] + np.arange(3)
        rear[6, 1:] = -1
        mask = rear >= 0
        conflict = np.zeros((7, 3, 2))
        conflict[:6, :, 0] = 1000.0 * np.arange(6)[:, None]
        now = traffic.at(index)
        to_conflict_m = np.linalg.norm(now[rear] - conflict, axis=2)
        probability = np.array(
            [
                [c if m == a else (1.0 - c) / 2.0 for m in range(3)]
                for a, c in zip(answers, confidences, strict=True)
            ]
            + [[1.0, 0.0, 0.0]]
        )
        unused = np.zeros((7, 3), dtype=np.int64)
        graphs = SemanticGraphs(
            ids=traffic.ids,
            ego=ego,
            rear=rear,
            front=unused,
            front_type=unused,
            x=np.zeros((7, 3, 1, 7)),
            context=np.zeros((7, 3, 1)),
            node_mask=mask,
            focus_mask=mask,
            history_mask=mask[..., None],
            has_conflict=np.array([True] * 6 + [single == 1]),
            ego_at_red=np.zeros(7, dtype=np.bool_),
            ego_to_conflict_m=np.repeat(to_conflict_m[:, :1], 3, axis=1),
            rear_to_conflict_m=to_conflict_m,
            conflict_xy_m=conflict,
            conflict_type=unused,
            leader=np.full(7, -1),
            leader_gap_m=np.zeros(7),
        )
        return replace(traffic.exact(index), graphs=graphs, slot_probability=probability)

    return predict


SLOT_MEASURES = ("slot_accuracy", "slot_macro_f1", "slot_ece", "yield_base_rate")


def test_slot_measures_by_hand(tmp_path: Path) -> None:
    traffic = junctions()
    # Right, right, a yield taken for a pass; right, a pass before the wrong one, a pass missed.
    predictors = {
        "some": slots(traffic, [0, 0, 1, 1, 2, 0], [0.9, 0.9, 0.9, 0.5, 0.5, 0.5], single=1),
        "all": slots(traffic, LABELS, [1.0] * 6),
        "cannot": traffic.exact,
    }
    scores = score_run(make_run(tmp_path / "run", traffic, predictors))
    by_hand = {
        "slot_accuracy": 3 / 6,
        # yield: 2 hits, 3 labels, 3 answers; pass: 1 hit, 3 labels, 3 answers
        "slot_macro_f1": (2 * 2 / 6 + 2 * 1 / 6) / 2,
        # 0.9: 2 of 3 right; 0.5: 1 of 3 right
        "slot_ece": (abs(2.7 - 2.0) + abs(1.5 - 1.0)) / 6,
        "yield_base_rate": 3 / 6,
        # 2 times 0.1^2 + 2 * 0.05^2; 0.9^2 + 0.95^2 + 0.05^2; 0.5^2 + 2 * 0.25^2;
        # 2 times 0.5^2 + 0.75^2 + 0.25^2
        "slot_brier": (2 * 0.015 + 1.715 + 0.375 + 2 * 0.875) / 6,
    }
    assert value(scores, "some", "slot_accuracy").std == pytest.approx(0.5)
    assert value(scores, "some", "slot_macro_f1").std is None
    for measure, expected in by_hand.items():
        some = value(scores, "some", measure)
        assert (some.value, some.n) == (pytest.approx(expected, abs=1e-6), 6), measure
        assert some.low is not None and some.high is not None and some.low < some.high
        cannot = value(scores, "cannot", measure)
        assert (cannot.value, cannot.n) == (None, 0)
    assert value(scores, "all", "slot_accuracy").value == 1.0
    assert value(scores, "all", "slot_macro_f1").value == 1.0
    assert value(scores, "all", "slot_ece").value == 0.0
    assert value(scores, "all", "slot_brier").value == 0.0
    single = value(scores, "some", "single_slot_share")
    assert (single.value, single.n) == (pytest.approx(1 / 7), 7)
    assert value(scores, "all", "single_slot_share").value == 0.0
    assert value(scores, "cannot", "single_slot_share").n == 0


def test_graphs_where_nobody_knows_the_slot_taken_are_counted(tmp_path: Path) -> None:
    traffic = junctions()
    # At junctions 0 and 4 everybody has stopped, long before the conflict.
    for vehicle in (0, 1, 12, 13):
        traffic.xy_m[vehicle] -= traffic.velocity_mps[vehicle] * 2.0
        traffic.velocity_mps[vehicle] = 0.0
    predictors = {
        "some": slots(traffic, LABELS, [1.0] * 6, single=1),
        "cannot": traffic.exact,
    }
    scores = score_run(make_run(tmp_path / "run", traffic, predictors))
    masked = value(scores, "some", "slot_masked_share")
    assert (masked.value, masked.n, masked.unit) == (pytest.approx(2 / 6), 6, "share")
    accuracy = value(scores, "some", "slot_accuracy")
    assert (accuracy.value, accuracy.n) == (1.0, 4)
    assert value(scores, "cannot", "slot_masked_share").n == 0


def test_always_wrong_scores_zero(tmp_path: Path) -> None:
    traffic = junctions()
    wrong = slots(traffic, [1, 2, 1, 2, 2, 0], [0.6] * 6)
    scores = score_run(make_run(tmp_path / "run", traffic, {"wrong": wrong}))
    assert value(scores, "wrong", "slot_accuracy").value == 0.0
    assert value(scores, "wrong", "slot_macro_f1").value == 0.0
    assert value(scores, "wrong", "slot_ece").value == pytest.approx(0.6)


def test_f1_agrees_with_one_against_the_rest() -> None:
    """With one vehicle to pass before, the measure is the ordinary macro-F1 of two classes."""
    rng = np.random.default_rng(3)
    label, answer = rng.integers(0, 2, 500), rng.integers(0, 2, 500)
    right = label == answer
    columns = [right & (label == 0), label == 0, answer == 0]
    columns += [right & (label == 1), label == 1, answer == 1]
    sums = np.column_stack(columns).astype(float).sum(axis=0)
    assert float(intervals.macro_f1(sums)) == pytest.approx(
        f1_score(label, answer, average="macro")
    )


def test_f1_is_undefined_while_a_class_never_occurs() -> None:
    assert np.isnan(intervals.macro_f1(np.array([5.0, 6.0, 7.0, 0.0, 0.0, 0.0])))
    assert intervals.macro_f1(np.array([5.0, 5.0, 5.0, 0.0, 1.0, 0.0])) == pytest.approx(0.5)


# --- intervals


def test_the_interval_of_a_mean_is_that_of_the_normal_distribution() -> None:
    draws = np.random.default_rng(5).normal(3.0, 2.0, 400)
    sums = np.column_stack([draws, np.ones(400)])
    bounds = intervals.interval(sums, intervals.ratio)
    assert bounds is not None
    half = 1.96 * draws.std() / 20.0
    assert bounds == pytest.approx((draws.mean() - half, draws.mean() + half), abs=0.15 * half)
    assert bounds == intervals.interval(sums, intervals.ratio), "seeded"


def test_repeating_a_vehicle_does_not_narrow_its_interval() -> None:
    draws = np.random.default_rng(6).normal(0.0, 1.0, 100)
    once = np.column_stack([draws, np.ones(100)])
    repeated = intervals.cluster_sums(np.repeat(once, 10, axis=0), np.repeat(np.arange(100), 10))
    bounds = intervals.interval(once, intervals.ratio)
    assert bounds is not None
    assert intervals.interval(repeated, intervals.ratio) == pytest.approx(bounds)


def test_intervals_of_several_means_are_those_of_each() -> None:
    rng = np.random.default_rng(7)
    sums = np.column_stack([rng.normal(2.0, 1.0, (30, 3)), rng.integers(0, 4, 30)])
    low, high = intervals.mean_intervals(sums)
    for k in range(3):
        assert (low[k], high[k]) == pytest.approx(
            intervals.interval(sums[:, [k, -1]], intervals.ratio)
        )
    assert np.isnan(intervals.mean_intervals(sums[:1])).all()


def test_no_interval_from_one_cluster_or_no_value() -> None:
    assert intervals.interval(np.array([[3.0, 1.0]]), intervals.ratio) is None
    assert intervals.interval(np.zeros((0, 2)), intervals.ratio) is None
    assert intervals.interval(np.zeros((9, 2)), intervals.ratio) is None


# --- several runs


def offset_run(out: Path, offset_m: float, **header: object) -> Run:
    traffic = two_cars()

    def off(index: int) -> Prediction:
        exact = traffic.exact(index)
        return replace(exact, xy_m=exact.xy_m + np.array([offset_m, 0.0]))

    return make_run(out, traffic, {"off": off}, **header)


def test_runs_are_pooled_and_five_of_them_are_the_clusters(tmp_path: Path) -> None:
    runs = [offset_run(tmp_path / str(k), float(k)) for k in range(5)]
    assert clustered_over(runs[:4]) == "vehicles" and clustered_over(runs) == "runs"
    few, many = (value(score_runs(r), "off", "ade_3s") for r in (runs[:4], runs))
    assert (few.value, few.n) == (pytest.approx(1.5), 8)
    assert (many.value, many.n) == (pytest.approx(2.0), 10)
    # Of 4 runs, 8 vehicles are drawn; of 5 runs, the runs: their spread is the wider.
    assert few.low is not None and few.high is not None
    assert many.low is not None and many.high is not None
    assert many.high - many.low > few.high - few.low
    # The bootstrap's standard error of a mean is the population's over the root of the number.
    assert many.high - many.low == pytest.approx(2 * 1.96 * np.std(range(5)) / 5**0.5, rel=0.15)


def recordings_run(out: Path, count: int, ids_by: str) -> Run:
    """Two vehicles of each of some recordings, the predictor `number` metres off in each."""
    traffic = Traffic(np.zeros((2 * count, 2)), np.tile([[5.0, 0.0]], (2 * count, 1)))
    traffic.ids = tuple(f"{number:03d}:{name}" for number in range(count) for name in "ab")
    offset_m = np.repeat(np.arange(float(count)), 2)

    def off(index: int) -> Prediction:
        exact = traffic.exact(index)
        xy_m = exact.xy_m + np.stack([offset_m, np.zeros(2 * count)], axis=1)[:, None, None]
        return replace(exact, xy_m=xy_m)

    return make_run(out, traffic, {"off": off}, settings={"ids_by": ids_by})


def test_recordings_in_a_run_are_the_clusters_where_there_are_five(tmp_path: Path) -> None:
    said = [
        (5, "recordings", "recordings"),
        (6, "cases", "cases"),
        (4, "recordings", "vehicles"),
        (6, "", "vehicles"),
    ]
    for number, (count, ids_by, expected) in enumerate(said):
        run = recordings_run(tmp_path / str(number), count, ids_by)
        assert clustered_over([run]) == expected
        score = value(score_run(run), "off", "ade_3s")
        assert (score.value, score.n) == (pytest.approx((count - 1) / 2), 2 * count)
        # As above, the standard error of a mean over so many independent draws.
        draws = count if expected != "vehicles" else 2 * count
        error_m = np.std(range(count)) / draws**0.5
        assert score.low is not None and score.high is not None
        assert score.high - score.low == pytest.approx(2 * 1.96 * error_m, rel=0.15)


def test_cases_are_sampled_after_ten_frames(tmp_path: Path) -> None:
    traffic = two_cars()
    for ids_by, expected in (("", 0), ("cases", 2)):
        said: dict[str, Predictor] = {"p": traffic.exact}
        with RunWriter(tmp_path / f"x{ids_by}", {"settings": {"ids_by": ids_by}}) as writer:
            for index in range(41):
                nobody = index == 0
                frame = traffic.frame(index)
                seen = Traffic(traffic.xy_m[:0], traffic.velocity_mps[:0]).frame(index)
                advice = {n: Advice(predict(index), (), ()) for n, predict in said.items()}
                writer.write(index, seen if nobody else frame, {} if nobody else advice)
        score = value(score_run(read_run(tmp_path / f"x{ids_by}")), "p", "ade_3s")
        assert score.n == expected


def test_scenes_are_scored_apart(tmp_path: Path) -> None:
    runs = [offset_run(tmp_path / n, m, scene=n) for n, m in (("one", 1.0), ("two", 2.0))]
    found = {
        score.scene: score.value
        for score in score_runs(runs)
        if (score.measure, score.subset) == ("fde_3s", "all")
    }
    assert found == {"one": pytest.approx(1.0), "two": pytest.approx(2.0)}


def test_runs_with_different_predictors_are_not_pooled(tmp_path: Path) -> None:
    traffic = two_cars()
    runs = [
        offset_run(tmp_path / "a", 1.0),
        make_run(tmp_path / "b", traffic, {"exact": traffic.exact}),
    ]
    with pytest.raises(InputError, match=r"\(off\), found exact; score these runs one by one"):
        score_runs(runs)


SETTINGS = {"lines": "inferred", "density": "normal", "risk": "courteous", "duration_s": 60.0}


@pytest.mark.parametrize(
    ("other", "differs"),
    [
        ({"settings": {**SETTINGS, "lines": "route"}}, "lines of {} (inferred), found route"),
        ({"settings": {**SETTINGS, "density": None}}, "density of {} (normal), found None"),
        ({"settings": {**SETTINGS, "risk": "tired"}}, "risk of {} (courteous), found tired"),
        ({"settings": {**SETTINGS, "drive": "a"}}, "drive of {} (None), found a"),
        ({"settings": {**SETTINGS, "react_from_s": 0.0}}, "react_from_s of {} (None), found 0.0"),
        ({"settings": {**SETTINGS, "net": "n.net.xml"}}, "net of {} (None), found n.net.xml"),
        ({"adapt": "none"}, "adapt of {} (mekf), found none"),
        ({"weights_sha256": {"off": "cd" * 32}}, "weights of off of {} (abababababab), found cdcd"),
        ({"weights_sha256": {}}, "weights of off of {} (abababababab), found None"),
    ],
)
def test_runs_made_in_different_ways_are_not_pooled(
    tmp_path: Path, other: dict[str, object], differs: str
) -> None:
    header = {"settings": SETTINGS, "weights_sha256": {"off": "ab" * 32}}
    first = offset_run(tmp_path / "a", 1.0, **header, seed=1)
    second = offset_run(tmp_path / "b", 1.0, **{**header, **other}, seed=2)
    with pytest.raises(InputError) as caught:
        score_runs([first, second])
    said = str(caught.value)
    assert said.startswith(f"{second.path}: expected the {differs.format(first.path)}")
    assert said.endswith("; score these runs one by one") and "\n" not in said
    elsewhere = offset_run(tmp_path / "c", 1.0, **{**header, **other}, scene="other")
    assert {score.scene for score in score_runs([first, elsewhere])} == {"made_up", "other"}


def test_who_drove_counts_where_somebody_was_driven(tmp_path: Path) -> None:
    def made_by(agent: str, drive: str | None, seed: int) -> Run:
        settings = {**SETTINGS, "agent": agent, "drive": drive}
        return offset_run(tmp_path / f"{agent}-{drive}", 1.0, settings=settings, seed=seed)

    with pytest.raises(InputError, match=r"the agent of .* \(calm\), found hasty"):
        score_runs([made_by("calm", "a", 1), made_by("hasty", "a", 2)])
    score_runs([made_by("calm", None, 1), made_by("hasty", None, 2)])


def test_a_run_given_twice_is_refused(tmp_path: Path) -> None:
    runs = {
        name: offset_run(tmp_path / name, 1.0, seed=seed, settings=settings)
        for name, seed, settings in (
            ("one", 1, SETTINGS),
            ("again", 1, SETTINGS),
            ("longer", 1, {**SETTINGS, "duration_s": 120.0}),
            ("other", 2, SETTINGS),
        )
    }
    one = runs["one"]
    for twice in (one, runs["again"]):
        with pytest.raises(InputError) as caught:
            score_runs([one, runs["other"], twice])
        assert str(caught.value).startswith(f"{twice.path}: the same run as {one.path}: scene, see")
    pooled = score_runs([one, runs["other"], runs["longer"]])
    assert value(pooled, "off", "ade_3s").n == 6
    unnamed = offset_run(tmp_path / "unnamed", 1.0)
    with pytest.raises(InputError, match="give each run once"):
        score_runs([unnamed, read_run(unnamed.path)])


# --- what predictors must not do


def test_an_answer_that_is_not_finite_is_no_way_out_of_a_sample(tmp_path: Path) -> None:
    traffic = two_cars()

    def lost(index: int) -> Prediction:
        exact = traffic.exact(index)
        if index == 15:
            exact.xy_m[1, 0, 7, 0] = np.nan
        return exact

    def aimless(index: int) -> Prediction:
        ones = np.ones((2, 1))
        goal_m = np.array([[15.0], [np.inf if index == 10 else 0.0]])
        return replace(traffic.exact(index), goal_weight=ones, goal_mean_m=goal_m, goal_std_m=ones)

    for name, predict, what, frame in (
        ("lost", lost, "positions", 15),
        ("aimless", aimless, "goals", 10),
    ):
        run = make_run(tmp_path / name, traffic, {"fine": traffic.exact, name: predict}, frames=60)
        with pytest.raises(InputError) as caught:
            score_run(run)
        assert str(caught.value) == (
            f"{run.path}: expected finite {what} of predictor '{name}', found others for vehicle "
            f"'v1' at frame {frame}; mend the predictor and make the run again"
        )


def test_routes_make_an_upper_bound_that_is_named_so(tmp_path: Path) -> None:
    traffic = two_cars()
    predictors: dict[str, Predictor] = dict.fromkeys(
        ("hatn", "idm", "constant_velocity"), traffic.exact
    )
    for lines, names in (
        ("inferred", ["hatn", "idm", "constant_velocity"]),
        ("route", ["hatn+route", "idm+route", "constant_velocity"]),
    ):
        run = make_run(tmp_path / lines, traffic, predictors, settings={"lines": lines})
        scores = score_run(run)
        assert list(dict.fromkeys(score.predictor for score in scores)) == names
        text = printed(scores)
        assert ("hatn+route" in text) == (lines == "route")
        assert ("an upper bound" in text) == (lines == "route")
        assert max(len(line.rstrip()) for line in text.splitlines()) <= 100


# --- for people and programs


def test_scores_as_json(tmp_path: Path) -> None:
    run = offset_run(tmp_path / "run", 1.0)
    scores = score_run(run)
    listed = json.loads(scores_json(scores))
    keys = ["measure", "predictor", "scene", "subset", "adapt", "value", "unit", "n", "low", "high"]
    keys += ["std"]
    assert all(list(entry) == keys for entry in listed)
    told = json.loads(scores_json([replace(scores[0], lines="lines: lanes")]))
    assert list(told[0]) == [*keys, "lines"] and told[0]["lines"] == "lines: lanes"
    entry = next(e for e in listed if (e["measure"], e["subset"]) == ("ade_3s", "all"))
    assert entry["value"] == pytest.approx(1.0) and entry["n"] == 2 and entry["adapt"] == "none"
    slot = next(e for e in listed if e["measure"] == "slot_accuracy")
    assert (slot["value"], slot["n"], slot["low"], slot["high"]) == (None, 0, None, None)
    path = write_scores(run.path, scores)
    assert path == run.path / "scores.json" and json.loads(path.read_text()) == listed


def test_adaptation_is_named_where_a_vehicle_was_adapted(tmp_path: Path) -> None:
    traffic = two_cars()

    def adapted(index: int) -> Prediction:
        return replace(traffic.exact(index), adapted=np.array([True, False]))

    run = make_run(tmp_path / "run", traffic, {"hatn": adapted, "plain": traffic.exact})
    assert {(s.predictor, s.adapt) for s in score_run(run)} == {("hatn", "mekf"), ("plain", "none")}


def printed(scores: list[Score], width: int = 100) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(score_table(scores))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


WITHOUT_SLOTS = ("slot", "yield", "single")


def test_the_table_fits_a_hundred_columns_and_says_what_it_shows() -> None:
    def entry(predictor: str, measure: str, subset: str, number: float) -> Score:
        unit = UNITS[measure]
        low, high = 0.95 * number, 1.05 * number
        shown = (measure, predictor, "roundabout8", subset, "none", number, unit, 123456)
        return Score(*shown, low, high, std=0.7 * number)

    scores = [
        entry(predictor, measure, subset, number)
        for predictor, number in (("hatn", 0.5), ("constant_velocity", 1.25))
        for subset in ("all", "moving")
        for measure in UNITS
        if subset == "all" or measure in MOVING_MEASURES
    ]
    scores = [
        replace(s, value=None, n=0, low=None, high=None)
        if s.predictor == "constant_velocity" and s.measure.startswith(WITHOUT_SLOTS)
        else s
        for s in scores
    ]
    text = printed(scores)
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 100
    assert "…" not in text, "nothing is cut off"
    for part in (
        "roundabout8: errors in metres, moving samples (more than 1 m in 3 s)",
        "0.500 x0.40",
        "± 0.350",
        "ADE 0.3 s, mm",
        "500.0 x0.40",
        "[475.0 525.0]",
        "roundabout8: modes and probabilities",
        "[0.475 0.525]",
        "123,456",
        "50.0 %",
        "[47.5 52.5]",
        "masked",
        "bootstrapped over vehicles; x ratio to constant velocity",
    ):
        assert part in text
    slots_part = text[text.index("roundabout8: slots") : text.index("roundabout8: modes")]
    assert "hatn" in slots_part and "\nconstant" not in slots_part, "who has no slots is left out"


def test_a_table_of_nothing_is_printed() -> None:
    assert "95 % interval" in printed([])
