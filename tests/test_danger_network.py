"""The network of danger: by hand, its file, and what it learns from runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_alert import moment

from hatn_sim.assist.danger import HATN, NO_PREDICTION
from hatn_sim.assist.danger_network import (
    DangerNetwork,
    danger_network,
    write_danger_networks,
)
from hatn_sim.assist.moment import Moment
from hatn_sim.assist.signs import SIGNS, signs_of
from hatn_sim.datatypes import SafetyEvent
from hatn_sim.errors import InputError
from hatn_sim.learn.danger import EARLY_WEIGHT, NEAR_WEIGHT, examples, fit_danger
from hatn_sim.score.advised import Advised
from hatn_sim.score.assessed import AssessedRun, read_assessed, write_assessed
from hatn_sim.score.sign_traces import SignRecorder

TOLD = SIGNS.index("meet, at most")


def network(out_bias: float = -1.0) -> DangerNetwork:
    """Two units: the one sees twice a sign, the other nothing."""
    hidden = np.zeros((len(SIGNS), 2))
    hidden[TOLD, 0] = 2.0
    return DangerNetwork(
        np.full(len(SIGNS), 0.5),
        np.full(len(SIGNS), 0.25),
        hidden,
        np.array([0.1, 0.3]),
        np.array([3.0, 1.0]),
        out_bias,
    )


def test_a_chance_by_hand() -> None:
    signs = np.full((2, len(SIGNS)), 0.5)
    signs[1, TOLD] = 0.6
    logits = [3.0 * np.tanh(0.1 + 2.0 * k * 0.4) + np.tanh(0.3) - 1.0 for k in (0, 1)]
    np.testing.assert_allclose(network().danger(signs), 1.0 / (1.0 + np.exp(-np.array(logits))))
    assert network(-50.0).danger(signs).tolist() == [0.0, 0.0]  # below what is told


def test_the_file_says_the_same(tmp_path: Path) -> None:
    path = tmp_path / "danger.json"
    write_danger_networks(path, {HATN: network()}, {"seeds": [1]})
    signs = np.random.default_rng(0).random((5, len(SIGNS)))
    read = danger_network(str(path), HATN)
    np.testing.assert_allclose(read.danger(signs), network().danger(signs), rtol=1e-4)
    assert json.loads(path.read_text())["card"] == {"seeds": [1]}


@pytest.mark.parametrize("rule", [HATN, NO_PREDICTION])
def test_what_ships_fits_the_signs(rule: str) -> None:
    chance = danger_network("", rule).danger(np.zeros((3, len(SIGNS))))
    assert ((chance >= 0.0) & (chance <= 1.0)).all()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda told: told.update(format=99), "another version"),
        (lambda told: told["signs"].pop(), "its signs are others"),
        (lambda told: told["rules"].pop(HATN), "damage"),
        (lambda told: told["rules"][HATN]["out"].pop(), "expected"),
        (lambda told: told["rules"][HATN]["out"].__setitem__(0, float("nan")), "expected"),
        (lambda told: told["rules"][HATN].update(out_bias=float("nan")), "finite out_bias"),
        (lambda told: told["rules"][HATN]["scale"].__setitem__(0, 0.0), "scales above 0"),
    ],
)
def test_a_damaged_file_is_told_of(tmp_path: Path, change: object, told: str) -> None:
    path = tmp_path / "danger.json"
    write_danger_networks(path, {HATN: network()}, {})
    values = json.loads(path.read_text())
    change(values)  # type: ignore[operator]
    path.write_text(json.dumps(values))
    with pytest.raises(InputError, match=told):
        danger_network(str(path), HATN)


def test_a_missing_file_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        danger_network(str(tmp_path / "none.json"), HATN)


# ---------------------------------------------------------------------------------------------
# Fitting

_MOMENT: Moment = moment((20.0, 9.0, 0.0), (20.0, 9.0, 0.0))


def run_of(
    times_s: np.ndarray, told: np.ndarray, events: tuple[SafetyEvent, ...], seed: int = 0
) -> AssessedRun:
    """The pair a and b at some times, with a value of one sign."""
    recorder = SignRecorder()
    seen = signs_of(_MOMENT)
    for time_s, value in zip(times_s, told, strict=True):
        signs = np.zeros((1, len(SIGNS)))
        signs[0, TOLD] = value
        recorder.add(float(time_s), ("a", "b"), replace(seen, of=signs))
    nothing = np.zeros(0)
    return AssessedRun(
        scene="scene",
        risk="courteous",
        seed=seed,
        window_s=(0.0, 1e6),
        vehicle_hours=1.0,
        events=events,
        traces={},
        advised=Advised(0, 0, 0, 0, 0, nothing, nothing.astype(bool), nothing.astype(bool)),
        signs={HATN: recorder.trace()},
    )


def test_examples_by_hand() -> None:
    times_s = np.array([1.0, 5.5, 8.0, 10.5, 12.0, 30.0, 36.0, 50.0])
    events = (
        SafetyEvent("T2", "a", "b", 10.0, ""),
        SafetyEvent("brief", "a", "b", 38.0, ""),
        SafetyEvent("T2", "a", "c", 50.5, ""),  # another pair's
    )
    signs, dangerous, weight = examples([run_of(times_s, 0.1 * times_s, events)], HATN)
    kept = [1.0, 5.5, 8.0, 30.0, 36.0, 50.0]  # 10.5 s and 12 s come after the event
    np.testing.assert_allclose(signs[:, TOLD], 0.1 * np.array(kept), rtol=1e-3)
    assert dangerous.tolist() == [False, True, True, False, False, False]
    # Before what is not severe, and whatever came before that, says little.
    near = NEAR_WEIGHT
    assert weight.tolist() == [1.0, EARLY_WEIGHT, 1.0, 1.0, near, 1.0]


@pytest.mark.slow
def test_chances_that_are_learned_are_those_of_the_traffic() -> None:
    """Where the sign is 1, one in five moments goes before an event; elsewhere none does."""
    rng = np.random.default_rng(3)
    runs = []
    for seed in range(4):
        times_s = 20.0 * np.arange(500)
        told = (rng.random(500) < 0.25).astype(np.float64)
        meets = (told == 1.0) & (rng.random(500) < 0.2)
        events = tuple(SafetyEvent("T2", "a", "b", float(t) + 2.0, "") for t in times_s[meets])
        runs.append(run_of(times_s, told, events, seed))
    fitted = fit_danger(runs, HATN)
    assert fitted is not None
    signs = np.zeros((2, len(SIGNS)))
    signs[1, TOLD] = 1.0
    low, high = fitted.danger(signs)
    share = np.mean([len(run.events) for run in runs]) / (0.25 * 500)
    assert high == pytest.approx(share, abs=0.05)
    assert low < 0.02
    again = fit_danger(runs, HATN)
    assert again is not None
    np.testing.assert_array_equal(again.danger(signs), [low, high])


def test_without_events_nothing_is_learned() -> None:
    assert fit_danger([run_of(np.arange(9.0), np.zeros(9), ())], HATN) is None
    assert fit_danger([], HATN) is None


def test_of_a_pair_that_is_there_twice_the_worse_is_told() -> None:
    """One follows the other, and both are at a conflict: as alerts have it, whichever is first."""
    seen, recorder = signs_of(_MOMENT), SignRecorder()
    twice = seen.pairs.of(np.array([0, 0]))
    for time_s, told in enumerate(([0.9, 0.1], [0.2, 0.8])):
        signs = np.zeros((2, len(SIGNS)))
        signs[:, TOLD] = told
        recorder.add(float(time_s), ("a", "b"), replace(seen, pairs=twice, of=signs))
    trace = recorder.trace()
    assert len(trace.pairs.danger) == 4  # all are examples
    found = trace.dangers(network())
    signs = np.zeros((2, len(SIGNS)))
    signs[:, TOLD] = [0.9, 0.8]
    np.testing.assert_allclose(found.danger, network().danger(signs), rtol=1e-2)
    assert found.time_s.tolist() == [0.0, 1.0]


def test_signs_are_kept_in_the_file_of_a_run(tmp_path: Path) -> None:
    run = run_of(np.arange(9.0), 0.1 * np.arange(9.0), ())
    write_assessed(tmp_path / "run.npz", run)
    again = read_assessed(tmp_path / "run.npz").signs[HATN]
    one, other = run.signs[HATN].dangers(network()), again.dangers(network())
    np.testing.assert_array_equal(one.danger, other.danger)
    assert (one.ids, one.time_s.tolist()) == (other.ids, other.time_s.tolist())
    assert len(one.danger) == 9
