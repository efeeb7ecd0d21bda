"""Adaptation of vehicles that come, go and change lines, against a loop over one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from hatn_sim.datatypes import HISTORY_FRAMES, HORIZON_FRAMES, FloatArray
from hatn_sim.hatn.adaptation import begin, linearise, update
from hatn_sim.hatn.adaptation_layer import (
    LAST,
    LAYERS,
    Layer,
    lineariser_of,
    own_parameters,
    positions_with,
    prior_of,
    sensitivity_m2,
)
from hatn_sim.hatn.adaptation_memory import (
    BAND_M,
    BAND_MPS2,
    AdaptationSettings,
    AdaptationState,
    Adapter,
    Moment,
    adapter_of,
    correction_m,
    faded,
    first,
    follow,
    learn,
    rows_of,
)
from hatn_sim.hatn.edn import EncoderDecoderNetwork, VehicleBatch
from hatn_sim.hatn.edn_settings import PAPER, EdnSettings
from hatn_sim.hatn.inputs import LINE_AT_M, to_vehicle_frame

torch.set_num_threads(1)
NOBODY: frozenset[str] = frozenset()
FRAMES = 26
SETTINGS = AdaptationSettings(steps=3)


def network_of(settings: EdnSettings = PAPER) -> EncoderDecoderNetwork:
    torch.manual_seed(4)
    return EncoderDecoderNetwork(replace(settings, width=16)).eval()


def drives() -> FloatArray:
    """x, y, yaw [V, K, 3] in the map: four vehicles that speed up, brake, stand, and curve."""
    time_s = 0.1 * np.arange(HISTORY_FRAMES - 1 + FRAMES)
    way_m = np.stack(
        (
            4.0 * time_s + 0.5 * time_s**2,
            10.0 * time_s - 0.6 * time_s**2,
            0.0 * time_s,
            7.0 * time_s + 0.3 * np.sin(2.0 * time_s),
        )
    )
    yaw = np.array([0.3, -2.0, 1.0, 0.0])[:, None] + 0.03 * way_m * np.array([0, 0, 0, 1])[:, None]
    step = np.diff(way_m, axis=1, prepend=way_m[:, :1])
    xy = np.cumsum(step[..., None] * np.stack((np.cos(yaw), np.sin(yaw)), -1), axis=1)
    start = np.array([[0.0, 0.0], [500.0, -80.0], [30.0, 4.0], [1e3, 1e3]])
    return np.concatenate((xy + start[:, None], yaw[..., None]), axis=-1)


def moment_at(frame: int, poses: FloatArray, names: str = "abcd") -> Moment:
    """All vehicles on straight lines ahead of them."""
    window = poses[:, frame : frame + HISTORY_FRAMES]
    now = window[:, -1]
    local = to_vehicle_frame(window[..., :2], now[:, :2], now[:, 2])
    speed = np.linalg.norm(np.diff(window[..., :2], axis=1, prepend=window[:, :1, :2]), axis=-1)
    speed[:, 0] = speed[:, 1]
    none = np.zeros_like(speed)
    turned = window[..., 2] - now[:, 2:3]
    columns = (
        *(local[..., 0], local[..., 1], 10.0 * speed, none, turned, none + 1.0),
        *(local[..., 0], local[..., 1], turned, 10.0 * speed),
    )
    count = len(poses)
    line = np.stack((LINE_AT_M, np.zeros_like(LINE_AT_M)), -1).astype(np.float32)
    batch = VehicleBatch(
        torch.from_numpy(np.stack(columns, -1).astype(np.float32)),
        torch.from_numpy(line).expand(count, -1, -1).clone(),
        torch.zeros(count, 5),
    )
    return Moment(
        ids=tuple(names[:count]),
        line=np.arange(count),
        whole=np.ones(count, dtype=np.bool_),
        batch=batch,
        goal_m=torch.from_numpy(30.0 * speed[:, -1:].astype(np.float32)),
        xy_m=now[:, :2],
        yaw_rad=now[:, 2],
    )


def only(moment: Moment, rows: Sequence[int]) -> Moment:
    """These vehicles of a moment, in this order."""
    index = np.array(rows, dtype=np.int64)
    return Moment(
        tuple(moment.ids[row] for row in rows),
        moment.line[index],
        moment.whole[index],
        rows_of(moment.batch, index),
        moment.goal_m[index],
        moment.xy_m[index],
        moment.yaw_rad[index],
    )


def follow_all(adapter: Adapter, moments: Sequence[Moment]) -> AdaptationState:
    state = first(adapter, moments[0])
    for moment in moments[1:]:
        state = follow(adapter, state, moment, NOBODY)
    return state


@pytest.fixture(scope="module")
def moments() -> list[Moment]:
    poses = drives()
    return [moment_at(frame, poses) for frame in range(FRAMES)]


@pytest.mark.parametrize("settings", [PAPER, EdnSettings()])
@pytest.mark.parametrize("layer", list(LAYERS))
def test_a_layer_of_ones_own_is_the_trained_one_until_it_is_changed(
    moments: list[Moment], settings: EdnSettings, layer: Layer
) -> None:
    network = network_of(replace(settings, goal_steps=1))
    batch, goal_m = moments[5].batch, moments[5].goal_m
    prior = prior_of(network, layer)
    with torch.no_grad():
        for name, tensor in own_parameters(network, layer, prior[None]).items():
            assert torch.equal(tensor[0], network.get_parameter(name))
        theta = prior.repeat(4, 1)
        trained = network(batch, goal_m)
        same = positions_with(network, layer, theta, batch, goal_m, HORIZON_FRAMES)
        torch.testing.assert_close(same, trained, rtol=0, atol=1e-4)
        theta[1] += 0.05
        other = positions_with(network, layer, theta, batch, goal_m, HORIZON_FRAMES)
    moved = (other - same).norm(dim=-1).amax(1)
    assert float(moved[1]) > 1e-3
    assert float(moved[[0, 2, 3]].max()) == 0.0


@pytest.mark.parametrize("settings", [PAPER, EdnSettings()])
@pytest.mark.parametrize("layer", list(LAYERS))
def test_the_jacobian_of_every_layer_is_that_of_finite_differences(
    moments: list[Moment], settings: EdnSettings, layer: Layer
) -> None:
    network = network_of(replace(settings, goal_steps=1)).double()
    source = moments[5].batch
    batch = VehicleBatch(source.history.double(), source.line.double(), source.at.double())
    goal_m = moments[5].goal_m.double()

    def predict(theta: Tensor) -> Tensor:
        return positions_with(network, layer, theta, batch, goal_m, 3).flatten(1)

    theta = prior_of(network, layer).repeat(4, 1)
    expected, jacobian = linearise(predict, theta)
    network.requires_grad_(False)
    said, by_pushes = lineariser_of(network, layer, 3, as_program=False)(theta, batch, goal_m)
    torch.testing.assert_close(said, expected, rtol=0, atol=1e-9)
    torch.testing.assert_close(by_pushes, jacobian, rtol=1e-7, atol=1e-9)
    random = torch.Generator().manual_seed(1)
    for _ in range(3):
        way = torch.randn(theta.shape, generator=random, dtype=torch.float64)
        with torch.no_grad():
            slope = (predict(theta + 1e-6 * way) - predict(theta - 1e-6 * way)) / 2e-6
        expected = (jacobian @ way[..., None])[..., 0]
        torch.testing.assert_close(expected, slope, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    "settings",
    [
        PAPER,
        EdnSettings(),
        EdnSettings(attention=True, goal="transform", clock="output"),
        EdnSettings(goal="output", clock="transform"),
        EdnSettings(decoder="plain", goal="hidden", clock="hidden", speed_out=True, yaw_out=True),
        EdnSettings(decoder="plain", coordinates="cartesian", incremental=False, aligned=False),
    ],
)
@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("as_program", [False, True])
def test_the_last_layers_jacobian_by_pushes_is_the_one_by_parameters(
    moments: list[Moment], settings: EdnSettings, steps: int, as_program: bool
) -> None:
    network = network_of(replace(settings, goal_steps=1)).requires_grad_(False)
    batch, goal_m = moments[5].batch, moments[5].goal_m
    random = torch.Generator().manual_seed(2)
    theta = prior_of(network, LAST).repeat(4, 1)
    theta = theta + 0.05 * torch.randn(theta.shape, generator=random)
    slow = linearise(
        lambda theta: positions_with(network, LAST, theta, batch, goal_m, steps).flatten(1),
        theta,
    )
    fast = lineariser_of(network, LAST, steps, as_program)(theta, batch, goal_m)
    for ours, theirs in zip(fast, slow, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


def test_what_was_said_before_is_not_asked_again(moments: list[Moment]) -> None:
    adapter = adapter_of(network_of(), SETTINGS)
    state = follow_all(adapter, moments[:20])
    with torch.no_grad():
        trained_m = adapter.network(state.moment.batch, state.moment.goal_m).double().numpy()
    row, moved_m = correction_m(adapter, state)
    again, same_m = correction_m(adapter, state, trained_m)
    assert again.tolist() == row.tolist()
    np.testing.assert_allclose(same_m, moved_m, atol=1e-4)


@pytest.mark.parametrize("steps", [1, 3, 10])
def test_the_past_is_predicted_again_from_what_was_read_then(
    moments: list[Moment], steps: int
) -> None:
    """A loop over one vehicle at a time that keeps everything it has read."""
    adapter = adapter_of(network_of(), replace(SETTINGS, steps=steps, start_std_m=0.5))
    state = follow_all(adapter, moments)
    for v in range(4):
        alone = begin(adapter.prior, 1, adapter.filter)
        for k in range(steps, FRAMES):
            then = only(moments[k - steps], [v])
            xy = np.stack([moments[j].xy_m[v] for j in range(k - steps + 1, k + 1)])
            away = xy - then.xy_m[0]
            cos, sin = np.cos(then.yaw_rad[0]), np.sin(then.yaw_rad[0])
            driven = np.stack((away @ [cos, sin], away @ [-sin, cos]), -1).astype(np.float32)
            predicted, jacobian = linearise(
                lambda theta, then=then: positions_with(
                    adapter.network, "dense3", theta, then.batch, then.goal_m, steps
                ).flatten(1),
                alone.theta,
            )
            innovation = torch.from_numpy(driven).flatten()[None] - predicted
            alone = update(alone, adapter.prior, innovation, jacobian, adapter.filter)
        torch.testing.assert_close(state.filter.theta[v], alone.theta[0], rtol=0, atol=2e-4)
        assert not torch.equal(alone.theta[0], adapter.prior)


def test_it_learns_how_a_vehicle_drives(moments: list[Moment]) -> None:
    """The network is untrained: what is right of the next 0.3 s was learnt from the vehicles."""
    adapter = adapter_of(network_of(), replace(SETTINGS, start_std_m=0.5))
    state = follow_all(adapter, moments[:-3])
    moment = moments[FRAMES - 4]
    xy = np.stack([m.xy_m for m in moments[-3:]], axis=1)
    truth = torch.from_numpy(to_vehicle_frame(xy, moment.xy_m, moment.yaw_rad)).float()
    with torch.no_grad():
        trained = adapter.network(moment.batch, moment.goal_m, 3)
        adapted = positions_with(
            adapter.network, "dense3", state.filter.theta, moment.batch, moment.goal_m, 3
        )
    before, after = ((said - truth).norm(dim=-1).mean() for said in (trained, adapted))
    assert float(after) < 0.5 * float(before)


def test_vehicles_are_told_apart_by_their_ids(moments: list[Moment]) -> None:
    """In any order, beside others that come and go, they learn what they would alone."""
    adapter = adapter_of(network_of(), SETTINGS)
    mixed = [
        only(moment, [(2, 0, 1), (1, 2, 0, 3), (0, 1, 2)][k % 3])
        for k, moment in enumerate(moments)
    ]
    state = follow_all(adapter, mixed)
    alone = follow_all(adapter, [only(moment, [1]) for moment in moments])
    row = state.moment.ids.index("b")
    torch.testing.assert_close(state.filter.theta[row], alone.filter.theta[0], rtol=0, atol=1e-5)
    # "d" is never seen in three frames in a row: nothing is learnt of it.
    last = follow(adapter, state, moments[-1], NOBODY)
    assert torch.equal(last.filter.theta[last.moment.ids.index("d")], adapter.prior)


def test_another_line_or_a_gap_begins_anew(moments: list[Moment]) -> None:
    adapter = adapter_of(network_of(), SETTINGS)
    state = follow_all(adapter, moments[:20])
    assert correction_m(adapter, state)[0].tolist() == [0, 1, 2, 3]
    line = moments[20].line.copy()
    line[1] = 77
    whole = moments[20].whole.copy()
    whole[3] = False
    after = follow(adapter, state, replace(moments[20], line=line, whole=whole), NOBODY)
    assert correction_m(adapter, after)[0].tolist() == [0, 2]
    assert after.frames.tolist() == [3, 1, 3, 0]


def test_a_vehicle_without_evidence_keeps_its_trained_prediction(moments: list[Moment]) -> None:
    adapter = adapter_of(network_of(), SETTINGS)
    state = follow_all(adapter, moments[:20])
    doubted = replace(state, evidence=state.evidence * torch.tensor([-1.0, 1.0]))
    assert np.abs(correction_m(adapter, state)[1]).max() > 1e-3
    assert not len(correction_m(adapter, doubted)[0])


def test_the_advised_are_never_adapted(moments: list[Moment]) -> None:
    adapter = adapter_of(network_of(), SETTINGS)
    state = first(adapter, moments[0])
    for moment in moments[1:20]:
        state = follow(adapter, state, moment, frozenset({"c"}))
    assert correction_m(adapter, state)[0].tolist() == [0, 1, 3]
    assert torch.equal(state.filter.theta[2], adapter.prior)


@pytest.mark.parametrize("method", ["mekf", "rls", "sgd"])
@pytest.mark.parametrize("settings", [PAPER, EdnSettings()])
def test_no_prediction_diverges_whatever_is_observed(settings: EdnSettings, method: str) -> None:
    """Vehicles that jump over the map: corrections are finite, within the band, and fade."""
    poses = drives()
    random = np.random.default_rng(0)
    poses[:, :, :2] += random.normal(0.0, 50.0, poses[:, :, :2].shape)
    poses[2, 25:] = 1e7
    adapter = adapter_of(
        network_of(replace(settings, goal_steps=1)),
        replace(SETTINGS, method=method, rate=10.0),  # type: ignore[arg-type]
    )
    state = first(adapter, moment_at(0, poses))
    ahead_s = 0.1 * np.arange(1, HORIZON_FRAMES + 1)
    for frame in range(1, FRAMES):
        state = follow(adapter, state, moment_at(frame, poses), NOBODY)
        _, moved_m = correction_m(adapter, state)
        length_m = np.linalg.norm(moved_m, axis=-1)
        assert np.isfinite(length_m).all()
        assert (length_m <= BAND_M + 0.5 * BAND_MPS2 * ahead_s**2 + 1e-4).all()


def test_corrections_fade_with_the_time_ahead() -> None:
    adapter = adapter_of(network_of(), replace(SETTINGS, fade_s=1.0))
    said = faded(adapter, torch.full((1, HORIZON_FRAMES, 2), 0.1))
    assert float(said[0, 0, 0]) == pytest.approx(0.1 * np.exp(-0.1))
    assert float(said[0, 29, 1]) == pytest.approx(0.1 * np.exp(-3.0))
    far = faded(adapter, torch.tensor([[[3e3, 4e3], [float("nan"), 1.0]]]))
    limit = BAND_M + 0.5 * BAND_MPS2 * 0.1**2
    torch.testing.assert_close(far[0, 0], torch.tensor([0.6, 0.8]) * limit)
    assert float(far[0, 1].abs().max()) == 0.0


@pytest.mark.parametrize("layer", ["dense3", "decoder_hidden"])
def test_settings_in_metres_mean_the_same_for_any_layer(layer: Layer) -> None:
    """Parameters drawn from the first covariance move a steady vehicle as far as is said."""
    network = network_of()
    settings = replace(SETTINGS, layer=layer, start_std_m=0.01)
    adapter = adapter_of(network, settings)
    assert adapter.filter.start_variance * sensitivity_m2(network, layer, 3) == pytest.approx(1e-4)
    poses = np.zeros((400, HISTORY_FRAMES, 3))
    poses[..., 0] = 0.8 * np.arange(HISTORY_FRAMES)
    steady = moment_at(0, poses[:1])
    batch = VehicleBatch(
        *(t.expand(400, -1, -1) for t in (steady.batch.history, steady.batch.line)),
        torch.zeros(400, 5),
    )
    random = torch.Generator().manual_seed(6)
    noise = torch.randn((400, len(adapter.prior)), generator=random)
    theta = adapter.prior + noise * adapter.filter.start_variance**0.5
    with torch.no_grad():
        goal_m = steady.goal_m.expand(400, -1)
        said = positions_with(network, layer, theta, batch, goal_m, 3)
        mean = positions_with(network, layer, adapter.prior[None], steady.batch, steady.goal_m, 3)
    assert float((said - mean).square().mean().sqrt()) == pytest.approx(0.01, rel=0.15)


def test_corrections_count_as_far_as_they_were_right_lately(moments: list[Moment]) -> None:
    """By hand, a quarter being nothing: 3 m of 4; none; nothing seen yet; all and more."""
    adapter = adapter_of(network_of(), SETTINGS)
    state = first(adapter, moments[0])
    evidence = torch.tensor([[3.0, 4.0], [-1.0, 4.0], [0.0, 0.0], [9.0, 4.0]])
    expected = torch.tensor([(3.0 - 0.25 * 4.0) / 0.75 / 4.001, 0.0, 0.0, 1.0])
    torch.testing.assert_close(
        replace(state, evidence=evidence).trust(), expected, rtol=1e-5, atol=0
    )


def test_evidence_is_of_what_was_believed_before_it_was_seen(moments: list[Moment]) -> None:
    """Positions that are the parameters themselves: f(theta) = theta, driven d, then a, now b.

    The forecast of then was moved by a where the trained network missed d: a d / |a| of |a|.
    """
    adapter = adapter_of(network_of(), replace(SETTINGS, steps=1))
    adapter = replace(
        adapter,
        prior=torch.zeros(2),
        linearise=lambda theta, batch, goal_m: (theta, torch.eye(2).expand(len(theta), 2, 2)),
    )
    then = torch.tensor([[0.3, 0.4], [0.3, 0.4], [0.0, 0.0]])
    driven = torch.tensor([[0.6, 0.8], [0.4, -0.3], [1.0, 0.0]])
    believed = replace(begin(adapter.prior, 3, adapter.filter), theta=torch.full((3, 2), 0.1))
    batch, goal_m = rows_of(moments[0].batch, np.arange(3)), moments[0].goal_m[:3]
    seen = torch.tensor([True, True, True])
    _, evidence = learn(adapter, believed, batch, goal_m, driven[:, None], seen, then)
    torch.testing.assert_close(evidence, torch.tensor([[1.0, 0.5], [0.0, 0.5], [0.0, 0.0]]))
