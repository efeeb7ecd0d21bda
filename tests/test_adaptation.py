"""The filter against least squares solved at once, textbook formulas and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from hatn_sim.hatn.adaptation import (
    FilterSettings,
    FilterState,
    begin,
    descend,
    gate_of,
    linearise,
    update,
)

torch.set_num_threads(1)
OPEN = FilterSettings(
    forgetting=0.9, start_variance=2.0, measurement_variance_m2=0.3, relaxation=0.0, gate=1.0
)
VEHICLES, SIZE, PARAMETERS = 4, 3, 6


@pytest.fixture
def stream() -> tuple[Tensor, Tensor, Tensor]:
    """A prior [P], Jacobians [K, B, D, P] and measurements [K, B, D] of 40 steps, float64."""
    random = torch.Generator().manual_seed(5)
    shape = (40, VEHICLES, SIZE, PARAMETERS)
    jacobian = torch.randn(shape, generator=random, dtype=torch.float64)
    true = torch.randn((VEHICLES, PARAMETERS, 1), generator=random, dtype=torch.float64)
    noise = 0.3 * torch.randn(shape[:3], generator=random, dtype=torch.float64)
    prior = torch.linspace(-1.0, 1.0, PARAMETERS, dtype=torch.float64)
    return prior, jacobian, (jacobian @ true)[..., 0] + noise


def follow(
    prior: Tensor, jacobian: Tensor, measured: Tensor, settings: FilterSettings
) -> FilterState:
    """The filter on the linear model f(theta) = H theta."""
    state = begin(prior, measured.shape[1], settings)
    for h, y in zip(jacobian, measured, strict=True):
        innovation = y - (h @ state.theta[..., None])[..., 0]
        state = update(state, prior, innovation, h, settings)
    return state


def test_on_a_linear_model_it_is_least_squares_with_forgetting(
    stream: tuple[Tensor, Tensor, Tensor],
) -> None:
    """All measurements at once, each weighted by lambda to the power of its age."""
    prior, jacobian, measured = stream
    state = follow(prior, jacobian, measured, OPEN)
    steps = len(measured)
    weight = 0.9 ** np.arange(steps - 1, -1, -1) / OPEN.measurement_variance_m2
    for b in range(VEHICLES):
        h = jacobian[:, b].numpy()
        information = np.einsum("k,kdp,kdq->pq", weight, h, h)
        information += 0.9 ** (steps - 1) / OPEN.start_variance * np.eye(PARAMETERS)
        right = np.einsum("k,kdp,kd->p", weight, h, measured[:, b].numpy())
        right += 0.9 ** (steps - 1) / OPEN.start_variance * prior.numpy()
        np.testing.assert_allclose(
            state.theta[b].numpy(), np.linalg.solve(information, right), atol=1e-9
        )
        np.testing.assert_allclose(
            state.covariance[b].numpy(), np.linalg.inv(information) / 0.9, atol=1e-9
        )


def test_process_noise_enters_as_the_paper_writes_it(stream: tuple[Tensor, Tensor, Tensor]) -> None:
    prior, jacobian, measured = stream
    settings = replace(OPEN, forgetting=0.95, process_variance=0.01)
    state = follow(prior, jacobian, measured, settings)
    theta, p = prior.numpy(), settings.start_variance * np.eye(PARAMETERS)
    for h, y in zip(jacobian[:, 1].numpy(), measured[:, 1].numpy(), strict=True):
        s = h @ p @ h.T + settings.measurement_variance_m2 * np.eye(SIZE)
        k = p @ h.T @ np.linalg.inv(s)
        theta = theta + k @ (y - h @ theta)
        p = (p - k @ h @ p + settings.process_variance * np.eye(PARAMETERS)) / 0.95
    np.testing.assert_allclose(state.theta[1].numpy(), theta, atol=1e-9)
    np.testing.assert_allclose(state.covariance[1].numpy(), p, atol=1e-9)


def test_no_innovation_changes_nothing_in_theta(stream: tuple[Tensor, Tensor, Tensor]) -> None:
    prior, jacobian, measured = stream
    state = follow(prior, jacobian[:5], measured[:5], OPEN)
    after = update(state, prior, torch.zeros(VEHICLES, SIZE).double(), jacobian[6], OPEN)
    assert after.misses.tolist() == [0] * VEHICLES
    assert torch.equal(after.theta, state.theta)
    # Certainty grows by a measurement all the same.
    variance = [s.covariance.diagonal(dim1=1, dim2=2).sum() for s in (after, state)]
    assert float(variance[0]) < float(variance[1])


def test_vehicles_are_filtered_as_if_alone_and_in_any_order(
    stream: tuple[Tensor, Tensor, Tensor],
) -> None:
    prior, jacobian, measured = stream
    together = follow(prior, jacobian, measured, OPEN)
    order = torch.tensor([2, 0, 3, 1])
    turned = follow(prior, jacobian[:, order], measured[:, order], OPEN)
    torch.testing.assert_close(turned.theta, together.theta[order], rtol=0, atol=1e-12)
    for b in range(VEHICLES):
        alone = follow(prior, jacobian[:, b : b + 1], measured[:, b : b + 1], OPEN)
        torch.testing.assert_close(alone.theta[0], together.theta[b], rtol=0, atol=1e-12)
        torch.testing.assert_close(alone.covariance[0], together.covariance[b], rtol=0, atol=1e-12)


@pytest.mark.parametrize("far", [50.0, float("nan"), float("inf")])
def test_an_outlier_teaches_its_vehicle_nothing_and_no_other_is_touched(
    stream: tuple[Tensor, Tensor, Tensor], far: float
) -> None:
    prior, jacobian, measured = stream
    state = follow(prior, jacobian[:5], measured[:5], OPEN)
    innovation = torch.full((VEHICLES, SIZE), 0.05, dtype=torch.float64)
    innovation[2, 1] = far
    after = update(state, prior, innovation, jacobian[6], replace(OPEN, gate=0.999))
    assert after.misses.tolist() == [0, 0, 1, 0]
    assert torch.equal(after.theta[2], state.theta[2])
    # It is as uncertain as one that was not seen for a step.
    torch.testing.assert_close(after.covariance[2], state.covariance[2] / 0.9)
    assert not torch.equal(after.theta[1], state.theta[1])


def test_beyond_the_gate_an_innovation_counts_as_one_at_the_gate(
    stream: tuple[Tensor, Tensor, Tensor],
) -> None:
    prior, jacobian, _ = stream
    settings = replace(OPEN, gate=0.95, reject=3.0)
    state = begin(prior, VEHICLES, settings)
    p0 = settings.start_variance
    way = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    for b in range(VEHICLES):
        h = jacobian[0, b]
        s = p0 * h @ h.T + settings.measurement_variance_m2 * torch.eye(SIZE, dtype=torch.float64)
        gate = (gate_of(SIZE, 0.95) / (way @ torch.linalg.solve(s, way))).sqrt()
        after = [
            update(state, prior, (times * gate * way).expand(VEHICLES, -1), jacobian[0], settings)
            for times in (1.0, 2.9, 3.1)
        ]
        moved = p0 * h.T @ torch.linalg.solve(s, gate * way)
        torch.testing.assert_close(after[0].theta[b], prior + moved, rtol=0, atol=1e-9)
        torch.testing.assert_close(after[1].theta[b], prior + moved, rtol=0, atol=1e-9)
        assert torch.equal(after[2].theta[b], prior)
        assert after[2].misses[b] == 1


def test_the_gate_is_the_quantile_of_tables() -> None:
    assert gate_of(2, 0.95) == pytest.approx(5.991, abs=1e-3)
    assert gate_of(6, 0.999) == pytest.approx(22.458, abs=1e-3)
    assert gate_of(6, 1.0) == float("inf")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_nothing_that_is_observed_drives_it_off(
    stream: tuple[Tensor, Tensor, Tensor], dtype: torch.dtype
) -> None:
    """Absurd measurements, no gate, and a Jacobian that sees some directions only, for long."""
    prior, jacobian, _ = (tensor.to(dtype) for tensor in stream)
    jacobian = jacobian[:1].expand(400, -1, -1, -1).clone()
    jacobian[:, 0] = 0.0
    random = torch.Generator().manual_seed(1)
    measured = 1e6 * torch.randn((400, VEHICLES, SIZE), generator=random).to(dtype)
    settings = replace(OPEN, forgetting=0.9, relaxation=0.2, max_change=1.5)
    state = follow(prior, jacobian, measured, settings)
    assert bool(torch.isfinite(state.theta).all())
    assert float((state.theta - prior).norm(dim=1).max()) <= 1.5 + 1e-5
    variances = torch.linalg.eigvalsh(state.covariance)
    assert float(variances.min()) > 0.0
    bound = OPEN.start_variance * 0.2 / (1.0 - 0.8 / 0.9)
    assert float(variances.max()) == pytest.approx(bound, rel=1e-3)


def test_a_vehicle_that_is_lost_is_begun_anew(stream: tuple[Tensor, Tensor, Tensor]) -> None:
    prior, jacobian, measured = stream
    settings = replace(OPEN, gate=0.999, patience=3)
    state = follow(prior, jacobian[:8], measured[:8], OPEN)
    learnt = state.theta[1].clone()
    far = torch.full((VEHICLES, SIZE), 1e3, dtype=torch.float64)
    for _ in range(3):
        state = update(state, prior, far, jacobian[9], settings)
        assert torch.equal(state.theta[1], learnt)
    assert state.misses.tolist() == [3] * VEHICLES
    state = update(state, prior, far, jacobian[9], settings)
    new = begin(prior, VEHICLES, settings)
    assert torch.equal(state.theta, new.theta)
    assert torch.equal(state.covariance, new.covariance)
    assert torch.equal(state.misses, new.misses)


def test_large_layers_keep_variances_only(stream: tuple[Tensor, Tensor, Tensor]) -> None:
    """From the same P the first step is that of the joint filter, whose covariances it drops."""
    prior, jacobian, measured = stream
    joint = begin(prior, VEHICLES, OPEN)
    innovation = measured[0] - (jacobian[0] @ prior)
    whole = update(joint, prior, innovation, jacobian[0], OPEN)
    part = update(without_covariances(joint), prior, innovation, jacobian[0], OPEN)
    expected = without_covariances(whole)
    torch.testing.assert_close(part.theta, expected.theta, rtol=0, atol=1e-12)
    torch.testing.assert_close(part.covariance, expected.covariance, rtol=0, atol=1e-12)
    assert begin(torch.zeros(601), 3, OPEN).covariance.shape == (3, 601)
    assert begin(torch.zeros(600), 3, OPEN).covariance.shape == (3, 600, 600)


def without_covariances(state: FilterState) -> FilterState:
    return replace(state, covariance=state.covariance.diagonal(dim1=1, dim2=2))


def curved(theta: Tensor, x: Tensor) -> Tensor:
    """A small network [B, D] whose last layer [2, 5] is theta [B, 10], rolled out three steps."""
    layer = theta.view(-1, 2, 5)
    y, out = torch.zeros_like(x[:, :2]), []
    for k in range(3):
        hidden = torch.tanh(x + k * 0.3 + y.sum(1, keepdim=True))
        y = y + torch.tanh((layer @ hidden[..., None])[..., 0])
        out.append(y)
    return torch.cat(out, 1)


def test_the_jacobian_is_that_of_finite_differences() -> None:
    random = torch.Generator().manual_seed(2)
    theta = torch.randn((3, 10), generator=random, dtype=torch.float64)
    x = torch.randn((3, 5), generator=random, dtype=torch.float64)
    value, jacobian = linearise(lambda p: curved(p, x), theta)
    torch.testing.assert_close(value, curved(theta, x))
    for p in range(10):
        step = torch.zeros(10, dtype=torch.float64)
        step[p] = 1e-6
        slope = (curved(theta + step, x) - curved(theta - step, x)) / 2e-6
        torch.testing.assert_close(jacobian[..., p], slope, rtol=0, atol=1e-8)


def test_descent_steps_along_the_gradient() -> None:
    state = begin(torch.zeros(2), 1, OPEN)
    jacobian = torch.tensor([[[1.0, 2.0], [0.0, 3.0]]])
    after = descend(
        state,
        torch.zeros(2),
        torch.tensor([[0.5, -1.0]]),
        jacobian,
        0.1,
        OPEN,
        torch.tensor([True]),
    )
    torch.testing.assert_close(after.theta, torch.tensor([[0.05, -0.2]]))


def drivers_of_their_own(re_predict: bool, joint: bool) -> float:
    """Error after adaptation over error before, of 16 drivers whose last layers differ.

    A stream of inputs; every step the newest three are measured, and the filter's gain is high.
    """
    random = torch.Generator().manual_seed(3)
    prior = 0.3 * torch.randn(10, generator=random, dtype=torch.float64)
    own = prior + 0.3 * torch.randn((16, 10), generator=random, dtype=torch.float64)
    settings = FilterSettings(0.98, 1.0, 0.0, 1e-4, relaxation=0.0, gate=1.0, max_change=5.0)
    state = begin(prior, 16, settings)
    if not joint:
        state = without_covariances(state)
    issued: list[tuple[Tensor, Tensor]] = []
    before: list[Tensor] = []
    after: list[Tensor] = []
    for _ in range(60):
        x = torch.randn((16, 5), generator=random, dtype=torch.float64)
        measured = curved(own, x)
        issued.append((x, curved(state.theta, x)))
        before.append((curved(prior.expand(16, -1), x) - measured).abs())
        after.append((issued[-1][1] - measured).abs())
        if len(issued) > 3:
            x, old = issued[-4]
            now, jacobian = linearise(lambda p, x=x: curved(p, x), state.theta)
            innovation = curved(own, x) - (now if re_predict else old)
            state = update(state, prior, innovation, jacobian, settings)
    return float(torch.stack(after[30:]).mean() / torch.stack(before[30:]).mean())


def test_todays_parameters_predict_again_what_was_seen_and_one_covariance_is_joint() -> None:
    """METHOD section 4's toy: an old prediction's innovation corrects the same error twice."""
    right = drivers_of_their_own(re_predict=True, joint=True)
    assert right < 0.25
    assert drivers_of_their_own(re_predict=False, joint=True) > 2 * right
    assert drivers_of_their_own(re_predict=True, joint=False) > 2 * right
