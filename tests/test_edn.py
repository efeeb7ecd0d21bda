"""The encoder-decoder network: motion by closed forms, every switch, parameters of one's own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch
from torch import Tensor

from hatn_sim.hatn import edn_plain
from hatn_sim.hatn.edn import EncoderDecoderNetwork, VehicleBatch, edn_loss
from hatn_sim.hatn.edn_program import frozen_edn
from hatn_sim.hatn.edn_settings import PAPER, EdnSettings, Signal
from hatn_sim.hatn.inputs import LINE_AT_M, to_map_frame, to_vehicle_frame
from hatn_sim.hatn.kinematics import gap_ahead_m, path_along, positions, present_motion
from hatn_sim.learn.augment import (
    mirror_vehicles,
    scale_vehicles,
    shake_vehicles,
    shift_vehicles,
    turn_vehicles,
)
from hatn_sim.learn.dataset import project_on_polylines

SETTINGS = (
    EdnSettings(width=16),
    replace(PAPER, width=16),
    replace(PAPER, width=16, coordinates="cartesian", aligned=False, incremental=False),
    replace(PAPER, width=16, speed_out=True, yaw_out=True, attention=True, goal="hidden"),
)

IN_COLUMNS = (
    EdnSettings(width=16, goal="none", goal_steps=1, clock="none"),
    EdnSettings(width=16, goal="input", goal_steps=1, clock="none"),
    EdnSettings(width=16, goal="transform", clock="input"),
)


def on_a_circle(
    radius_m: float, speed_mps: float, acceleration_mps2: float = 0.0
) -> tuple[VehicleBatch, Tensor]:
    """A vehicle on a circle to the left that is its line as well, and where it then is [1, F, 2].

    Its heading is the direction of motion; speeds are those at the instant.
    """
    time_s = np.arange(-10, 31) * 0.1
    way_m = speed_mps * time_s + 0.5 * acceleration_mps2 * time_s**2

    def at(arc_m: np.ndarray) -> np.ndarray:
        angle = arc_m / radius_m
        return np.stack((radius_m * np.sin(angle), radius_m * (1.0 - np.cos(angle))), axis=-1)

    xy, yaw = at(way_m), way_m / radius_m
    speed = speed_mps + acceleration_mps2 * time_s
    past = slice(0, 11)
    still = np.zeros(11)
    history = np.stack(
        [
            *(way_m[past], still, speed[past], still, still, still + 1.0),
            *(xy[past, 0], xy[past, 1], yaw[past], speed[past]),
        ],
        axis=-1,
    )
    batch = VehicleBatch(
        torch.from_numpy(history.astype(np.float32))[None],
        torch.from_numpy(at(LINE_AT_M).astype(np.float32))[None],
        torch.zeros(1, 5),
    )
    return batch, torch.from_numpy(xy[11:].astype(np.float32))[None]


def random_batch(vehicles: int, seed: int = 0) -> VehicleBatch:
    random = torch.Generator().manual_seed(seed)
    history = 0.1 * torch.randn((vehicles, 11, 10), generator=random)
    speed = 12.0 * torch.rand((vehicles, 1), generator=random)
    way = speed * 0.1 * torch.arange(-10, 1)
    history[..., 0], history[..., 6] = way, way
    history[..., 2], history[..., 9] = speed, speed
    history[..., 5] = 1.0
    history[:, -1, 6:9] = 0.0
    bend = 0.02 * torch.randn((vehicles, 1), generator=random)
    at = torch.from_numpy(LINE_AT_M.astype(np.float32))
    line = torch.stack((at.expand(vehicles, -1), bend * at**2 / 2.0), -1)
    return VehicleBatch(history, line, 10.0 * torch.randn((vehicles, 5), generator=random))


def silent(settings: EdnSettings) -> EncoderDecoderNetwork:
    """A network that emits nothing: what is left is physics."""
    model = EncoderDecoderNetwork(settings).eval()
    torch.nn.init.zeros_(model.dense3.weight)
    torch.nn.init.zeros_(model.dense3.bias)
    return model


def goals(settings: EdnSettings, vehicles: int, seed: int = 0) -> Tensor:
    random = torch.Generator().manual_seed(seed)
    return 5.0 * torch.rand((vehicles, settings.goal_steps), generator=random).cumsum(-1)


@pytest.mark.parametrize("radius_m", [1e6, 30.0, 8.0])
def test_a_silent_decoder_drives_on_in_a_circle(radius_m: float) -> None:
    batch, future = on_a_circle(radius_m, 6.0)
    with torch.no_grad():
        found = silent(EdnSettings(width=8))(batch, torch.zeros(1, 6))
    # Chords instead of arcs: 0.6 m a step.
    allowed_m = 0.02 if radius_m > 20.0 else 0.06
    assert float((found - future).norm(dim=-1).max()) < allowed_m
    assert float((found - future)[0, :3].norm(dim=-1).max()) < 0.005


def test_a_silent_decoder_keeps_the_acceleration() -> None:
    """s(t) = v t + a t^2 / 2 from samples of positions and of instantaneous speeds."""
    batch, future = on_a_circle(1e6, 5.0, 1.5)
    with torch.no_grad():
        found = silent(EdnSettings(width=8))(batch, torch.zeros(1, 6))
    assert float((found - future).norm(dim=-1).max()) < 0.05
    assert float((found - future)[0, :3].norm(dim=-1).max()) < 0.002


def test_who_brakes_comes_to_a_halt_and_stays() -> None:
    batch, _ = on_a_circle(1e6, 3.0, -2.0)
    with torch.no_grad():
        found = silent(EdnSettings(width=8))(batch, torch.zeros(1, 6))[0]
    step_m = found.diff(dim=0).norm(dim=-1)
    assert float(step_m[-10:].max()) == 0.0
    assert float(found[-1, 0]) == pytest.approx(3.0**2 / (2.0 * 2.0), abs=0.1)


def test_the_emitted_motion_is_bounded_whatever_the_network_says() -> None:
    torch.manual_seed(0)
    model = EncoderDecoderNetwork(EdnSettings(width=8)).eval()
    torch.nn.init.normal_(model.dense3.weight, std=50.0)
    batch = random_batch(200)
    # Straight on until now, and so is the line: what bends the way is the network alone.
    batch.history[..., 7:9] = 0.0
    batch = replace(batch, line=batch.line * torch.tensor([1.0, 0.0]))
    with torch.no_grad():
        found = model(batch, goals(model.settings, 200))
    now = present_motion(batch.history)
    step_m = torch.cat((torch.zeros(200, 1, 2), found), 1).diff(dim=1).norm(dim=-1)
    change = step_m.diff(dim=1) / 0.01
    # Swerves lengthen a step besides.
    assert float(change.max()) < 11.0 and float(change.min()) > -14.0
    assert torch.isfinite(found).all() and (now.increment_m >= 0).all()


def test_the_path_begins_as_now_and_ends_on_the_parallel() -> None:
    """A vehicle that heads 0.2 rad off a straight line."""
    line = torch.tensor(np.stack((LINE_AT_M, 0 * LINE_AT_M), -1), dtype=torch.float32)[None]
    course, curvature, blend = torch.tensor([0.2]), torch.tensor([0.0]), torch.tensor([12.0])
    path = path_along(line, course, curvature, blend)
    at = torch.linspace(0.0, 40.0, 401)[None]
    found = positions(path, at, torch.zeros_like(at))[0]
    first = found[1] - found[0]
    assert float(torch.atan2(first[1], first[0])) == pytest.approx(0.2, abs=1e-3)
    assert float(found[at[0] > 12.0, 1].abs().max()) < 1e-4
    turn = torch.atan2(*found.diff(dim=0).flip(-1).unbind(-1)).diff() / 0.1
    assert float(turn.abs().max()) < 0.2, "no kink"
    aside = positions(path, at, torch.full_like(at, 0.5))[0]
    torch.testing.assert_close(aside[:, 1] - found[:, 1], torch.full((401,), 0.5))


def test_a_vehicle_that_stands_looks_along_its_heading() -> None:
    batch, _ = on_a_circle(1e6, 0.0)
    now = present_motion(batch.history)
    assert [float(v) for v in (now.increment_m, now.course_rad, now.curvature_per_m)] == [0, 0, 0]


def test_who_has_just_come_into_view_drives_on_at_its_speed() -> None:
    """One frame was seen: those before it hold its pose, as if the vehicle had stood."""
    batch, _ = on_a_circle(1e6, 12.0)
    history = batch.history[:, -1:].expand(-1, 11, -1).clone()
    history[:, :-1, 5] = 0.0
    with torch.no_grad():
        found = silent(EdnSettings(width=8))(replace(batch, history=history), torch.zeros(1, 6))[0]
    expected = torch.stack((1.2 * torch.arange(1.0, 31.0), torch.zeros(30)), -1)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-2)


@pytest.mark.parametrize("speed_mps", [-4.0, -6.0])
def test_who_reverses_stands_along_its_nose(speed_mps: float) -> None:
    """The wheels stay turned: forwards the way bends as it did backwards."""
    batch, _ = on_a_circle(8.0, speed_mps)
    now = present_motion(batch.history)
    assert float(now.increment_m) == 0.0
    assert float(now.course_rad) == pytest.approx(0.0, abs=1e-3)
    assert float(now.curvature_per_m) == pytest.approx(1.0 / 8.0, rel=0.01)


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(one, marks=pytest.mark.slow) if one in (SETTINGS[2], IN_COLUMNS[1]) else one
        for one in (*SETTINGS, *IN_COLUMNS)
    ],
)
def test_the_frozen_decoder_is_the_decoder(settings: EdnSettings) -> None:
    """Also where it brakes to a halt and steers up to every limit; for any number of vehicles."""
    torch.manual_seed(0)
    model = EncoderDecoderNetwork(settings).eval()
    if settings.decoder == "kinematic":
        torch.nn.init.normal_(model.dense3.weight, std=2.0)
        torch.nn.init.normal_(model.start.weight, std=2.0)
    program, own_program = frozen_edn(model), frozen_edn(model, own_last_layer=True)
    for vehicles in (1, 7):
        batch, goal_m = random_batch(vehicles), goals(settings, vehicles)
        with torch.inference_mode():
            expected = model(batch, goal_m)
            found = program(batch.history, batch.line, batch.at, goal_m)
            torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
            weight = model.dense3.weight.expand(vehicles, -1, -1).contiguous()
            bias = model.dense3.bias.expand(vehicles, -1).contiguous()
            found = own_program(batch.history, batch.line, batch.at, goal_m, weight, bias)
            torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize(
    "layer",
    [
        *("encoder.weight_ih_l0", "encoder.weight_hh_l0", "decoder.weight_ih", "decoder.weight_hh"),
        *("dense1.weight", "dense2.weight", "dense3.weight", "dense3.bias"),
    ],
)
def test_parameters_of_ones_own_change_oneself_only(settings: EdnSettings, layer: str) -> None:
    torch.manual_seed(0)
    model = EncoderDecoderNetwork(settings).eval()
    batch, goal_m = random_batch(5), goals(settings, 5)
    shared = dict(model.named_parameters())[layer].detach()
    own = shared.expand(5, *shared.shape).clone()
    with torch.no_grad():
        expected = model(batch, goal_m)
        torch.testing.assert_close(
            model(batch, goal_m, own={layer: own}), expected, atol=2e-4, rtol=1e-4
        )
        own[2] += 0.3
        apart = (model(batch, goal_m, own={layer: own}) - expected).norm(dim=-1).amax(-1)
    assert float(apart[2]) > 1e-3
    assert float(apart[[0, 1, 3, 4]].max()) < 1e-3


SWITCHES = [
    {"coordinates": coordinates, "goal": goal, "clock": clock, "aligned": aligned}
    for coordinates in ("frenet", "cartesian")
    for aligned in (False, True)
    for goal, clock in [
        *((goal, "none") for goal in get_args(Signal)),
        *(("input", clock) for clock in get_args(Signal)),
    ]
]


@pytest.mark.parametrize("switches", SWITCHES)
def test_every_way_to_tell_the_goal_is_learnt_from(switches: dict[str, object]) -> None:
    """A gradient reaches every parameter, and the goal matters if and only if it is told."""
    torch.manual_seed(0)
    settings = replace(PAPER, width=8, **switches)  # type: ignore[arg-type]
    model = EncoderDecoderNetwork(settings)
    batch, goal_m = random_batch(6), goals(settings, 6)
    out = model(batch, goal_m)
    out.square().mean().backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None and bool(parameter.grad.abs().sum() > 0), name
    changed = not torch.allclose(out, model(batch, goal_m + 5.0))
    assert changed == (settings.goal != "none" or settings.clock == "transform")


@pytest.mark.parametrize("coordinates", ["frenet", "cartesian"])
@pytest.mark.parametrize("aligned", [False, True])
def test_the_truth_in_any_coordinates_is_the_truth_in_the_map(
    coordinates: str, aligned: bool
) -> None:
    batch, future = on_a_circle(15.0, 6.0)
    at = torch.tensor([[100.0, -50.0, 2.0, 33.0, 0.4]])
    s, d, tangent = project_on_polylines(
        batch.line.double().numpy(), LINE_AT_M, future.double().numpy()
    )
    frenet = torch.tensor(np.stack((s, d), -1), dtype=torch.float32)
    motion = torch.tensor(np.stack((0 * s + 6.0, tangent, 0 * s), -1), dtype=torch.float32)
    settings = replace(
        PAPER, coordinates=coordinates, aligned=aligned, speed_out=True, yaw_out=True
    )
    truth = edn_plain.targets(settings, at, frenet, future, motion)
    found = edn_plain.to_vehicle_frame(settings, batch.line, at, truth)
    torch.testing.assert_close(found, future, atol=2e-4, rtol=0.0)
    if coordinates == "cartesian":
        assert truth[0, 0, -1] == pytest.approx(
            2.0 + math.atan2(future[0, 0, 1], future[0, 0, 0]), abs=0.03
        )


def test_a_taught_decoder_reads_the_truth_of_the_step_before() -> None:
    torch.manual_seed(0)
    model = EncoderDecoderNetwork(replace(PAPER, width=8)).eval()
    batch, goal_m = random_batch(3), goals(PAPER, 3)
    truth = torch.randn(3, 30, 2).cumsum(1)
    other = truth.clone()
    other[:, 10] += 1.0
    with torch.no_grad():
        one, two = (model.native(batch, goal_m, teacher=t) for t in (truth, other))
    increments = [torch.diff(said, dim=1) for said in (one, two)]
    same = (increments[0] == increments[1]).all(-1).all(0)
    assert same[:10].all() and not same[10]


def test_the_path_loss_is_the_mean_distance() -> None:
    predicted = torch.zeros(1, 3, 2)
    future = torch.tensor([[[3.0, 4.0], [100.0, 0.0], [0.0, 2.0]]])
    mask, weight = torch.tensor([[1.0, 0.0, 1.0]]), torch.tensor([1.0, 1.0, 3.0])
    assert float(edn_loss(predicted, future, mask, weight)) == pytest.approx((5 + 6) / 4, rel=1e-5)


def test_frames_of_vehicles_and_back() -> None:
    random = np.random.default_rng(0)
    xy, origin = random.normal(size=(4, 7, 2)) * 30, random.normal(size=(4, 2)) * 100
    yaw = random.uniform(-3, 3, 4)
    own = to_vehicle_frame(xy, origin, yaw)
    np.testing.assert_allclose(to_map_frame(own, origin, yaw), xy, atol=1e-9)
    ahead = origin + 5.0 * np.stack((np.cos(yaw), np.sin(yaw)), -1)
    np.testing.assert_allclose(
        to_vehicle_frame(ahead[:, None], origin, yaw)[:, 0], [[5.0, 0.0]] * 4, atol=1e-9
    )


def test_projection_on_a_bend_by_hand() -> None:
    line = np.array([[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]]])
    points = np.array([[[-2.0, 1.0], [4.0, 0.5], [9.5, 6.0], [11.0, 14.0]]])
    s, d, yaw = project_on_polylines(line, np.array([0.0, 10.0, 20.0]), points)
    np.testing.assert_allclose(s, [[-2.0, 4.0, 16.0, 24.0]])
    np.testing.assert_allclose(d, [[1.0, 0.5, 0.5, -1.0]])
    np.testing.assert_allclose(yaw, [[0.0, 0.0, np.pi / 2, np.pi / 2]])


def test_who_heads_aslant_drives_the_same_way_in_the_map() -> None:
    """Turned in its own frame by -e, a vehicle that heads by e more to the left is where it was."""
    batch, future = on_a_circle(20.0, 6.0)
    aslant = torch.tensor([0.15])
    turned, then = turn_vehicles(batch, future, aslant)
    for before, after in (
        (future, then),
        (batch.line, turned.line),
        (batch.history[..., 6:8], turned.history[..., 6:8]),
    ):
        back = to_map_frame(after.double().numpy(), np.zeros((1, 2)), aslant.double().numpy())
        np.testing.assert_allclose(back, before.numpy(), atol=1e-5)
    torch.testing.assert_close(turned.history[..., 4], batch.history[..., 4] + 0.15)
    torch.testing.assert_close(turned.history[..., 8], batch.history[..., 8])
    # What is known of the motion does not hang on where the vehicle heads.
    model = silent(EdnSettings(width=8))
    with torch.no_grad():
        torch.testing.assert_close(
            turn_vehicles(batch, model(batch, torch.zeros(1, 6)), aslant)[1],
            model(turned, torch.zeros(1, 6)),
            atol=1e-3,
            rtol=0.0,
        )


def test_speeds_along_and_across_the_line_turn_with_the_heading_by_hand() -> None:
    """At 5 m/s with a heading of (4, 3) / 5, turned by as much again, and back to the line."""
    batch = random_batch(2)
    heading = math.atan2(3.0, 4.0)
    batch.history[..., 2], batch.history[..., 3], batch.history[..., 4] = 4.0, 3.0, heading
    turned, _ = turn_vehicles(batch, torch.zeros(2, 30, 2), torch.tensor([heading, -heading]))
    along, across, phi = turned.history[..., 2:5].unbind(-1)
    for row, by_hand in enumerate(((1.4, 4.8), (5.0, 0.0))):
        torch.testing.assert_close(along[row], torch.full_like(along[row], by_hand[0]))
        torch.testing.assert_close(across[row], torch.full_like(across[row], by_hand[1]))
    # Perception takes them from the heading: v cos phi and v sin phi.
    torch.testing.assert_close(along, 5.0 * phi.cos())
    torch.testing.assert_close(across, 5.0 * phi.sin(), atol=1e-6, rtol=1e-5)


def test_who_keeps_beside_the_line_is_read_beside_it_alone() -> None:
    batch, _ = on_a_circle(20.0, 6.0)
    beside = shift_vehicles(batch, torch.tensor([0.7]))
    changed = (beside.history != batch.history).any(0).any(0)
    assert changed.nonzero().flatten().tolist() == [1]
    torch.testing.assert_close(beside.history[..., 1], batch.history[..., 1] + 0.7)
    assert beside.line is batch.line


def test_a_heading_measured_badly_is_that_of_now_still() -> None:
    batch = random_batch(3000)
    shaken = shake_vehicles(batch, torch.full((3000,), 0.02))
    error = shaken.history - batch.history
    assert (error[..., :8] == 0).all() and (error[..., 9:] == 0).all()
    assert (error[:, -1, 8] == 0).all()
    assert float(error[:, :-1, 8].std()) == pytest.approx(0.02, rel=0.03)


@pytest.mark.parametrize("speed_mps", [4.0, 9.0, 15.0])
def test_curvature_and_its_trend_on_a_clothoid(speed_mps: float) -> None:
    """A heading of k s + c s^2 / 2: the curvature at s is k + c s."""
    batch, _ = on_a_circle(1e6, speed_mps)
    s = batch.history[..., 0]
    bend, change = 0.02, 0.003
    batch.history[..., 8] = bend * s + change * s**2 / 2.0
    now = present_motion(batch.history)
    step = 0.1 * speed_mps
    assert float(now.curvature_per_m) == pytest.approx(bend - 2.0 * step * change, abs=1e-5)
    assert float(now.curving_per_m) == pytest.approx(2.0 * step * change, abs=1e-5)


def test_the_line_beside_the_arc_by_hand() -> None:
    """A vehicle that turns left at 1/20 m beside a straight line leaves it to its right."""
    line = torch.tensor(np.stack((LINE_AT_M, 0 * LINE_AT_M), -1), dtype=torch.float32)[None]
    path = path_along(line, torch.zeros(1), torch.tensor([0.05]), torch.tensor([50.0]))
    at = torch.tensor([[2.0, 6.0, 10.0]])
    expected = -20.0 * (1.0 - torch.cos(at / 20.0))
    torch.testing.assert_close(gap_ahead_m(path, at), expected, atol=1e-3, rtol=0.0)


def test_a_larger_place_and_a_mirrored_one_are_driven_alike() -> None:
    """A silent decoder knows nothing of scale and side: its answers scale and mirror."""
    batch, future = on_a_circle(20.0, 6.0)
    model, goal_m = silent(EdnSettings(width=8)), torch.zeros(1, 6)
    double, _, told = scale_vehicles(batch, future, goal_m + 3.0, torch.tensor([2.0]))
    assert told.tolist() == [[6.0] * 6]
    mirrored, flipped = mirror_vehicles(batch, future, torch.tensor([True]))
    with torch.no_grad():
        found = model(batch, goal_m)
        torch.testing.assert_close(model(mirrored, goal_m)[..., 1], -found[..., 1])
        assert float((model(double, goal_m) - 2.0 * found).norm(dim=-1).max()) < 0.05
    torch.testing.assert_close(flipped[..., 1], -future[..., 1])
