"""MEKF_lambda, the modified extended Kalman filter with forgetting (the paper's section 6).

The parameters theta of one layer are estimated for every vehicle by itself, all vehicles in one
batch: innovation e = y - f(theta), Jacobian H = df/dtheta at the same theta,

    S = H P H' + R,  K = P H' S^-1,  theta <- theta + K e,  P <- (P - K H P + Q) / lambda.

The paper prints P_t on both sides of the last line; the right one is P_(t-1) (METHOD section 4).
With Q = 0 and a linear f this is recursive least squares with forgetting, exactly. Forgetting
without news would blow P up, so P is drawn back to where it began (stabilised forgetting, Kulhavy
and Zarrop 1993): P <- (1 - r) P + r P_0. Letters in the shapes: B vehicles, D measurements of a
vehicle, P parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import torch
from scipy.special import gammaincinv
from torch import Tensor

MAX_JOINT: Final = 600
"""With more parameters than this, only the variances are kept: P grows with the square."""


@dataclass(frozen=True)
class FilterSettings:
    """What the filter assumes; variances are those of a single parameter or measurement."""

    forgetting: float = 0.9
    """lambda."""
    start_variance: float = 1e-3
    """P_0 is this times the identity."""
    process_variance: float = 0.0
    """Q is this times the identity."""
    measurement_variance_m2: float = 1e-2
    """R is this times the identity."""
    relaxation: float = 0.2
    """r, the share of P_0 in P after a step. No variance exceeds r / (1 - (1 - r) / lambda) times
    the first one, if r > 1 - lambda."""
    gate: float = 0.9999
    """Innovations that the filter holds for less probable than one minus this are taken for smaller
    ones, at the gate: a network that is far off needs more than one step (Huber's influence)."""
    reject: float = 10.0
    """Innovations this many times as large as those at the gate are outliers and teach nothing."""
    patience: int = 10
    """After so many outliers in a row the vehicle is lost, and is begun anew."""
    max_change: float = float("inf")
    """How far theta may move from where it began, as a Euclidean norm."""


@dataclass(frozen=True, eq=False)
class FilterState:
    """What is believed of the parameters of every vehicle."""

    theta: Tensor  # [B, P]
    covariance: Tensor  # [B, P, P] joint, or [B, P]: variances only
    misses: Tensor  # [B] outliers in a row

    def rows(self, index: Tensor) -> FilterState:
        """The vehicles `index` [B'] alone."""
        return FilterState(self.theta[index], self.covariance[index], self.misses[index])


def begin(prior: Tensor, count: int, settings: FilterSettings) -> FilterState:
    """`count` vehicles that nothing is known of yet, with parameters `prior` [P]."""
    size = len(prior)
    variance = torch.full_like(prior, settings.start_variance)
    # Drawn back to P_0 whole, P is diagonal for ever.
    joint = size <= MAX_JOINT and settings.relaxation < 1.0
    covariance = torch.diag(variance) if joint else variance
    return FilterState(
        prior.repeat(count, 1),
        covariance.repeat(count, *[1] * covariance.dim()),
        torch.zeros(count, dtype=torch.int64),
    )


def linearise(predict: Callable[[Tensor], Tensor], theta: Tensor) -> tuple[Tensor, Tensor]:
    """f(theta) [B, D] and its Jacobian [B, D, P] at `theta` [B, P].

    Vehicles do not touch each other in `predict`, so the gradient of a sum over vehicles holds
    that of each; those of the D measurements are taken in one batched pass back.
    """
    with torch.enable_grad():
        theta = theta.detach().requires_grad_()
        out = predict(theta)
        each = torch.eye(out.shape[1], dtype=out.dtype)[:, None].expand(-1, *out.shape)
        (jacobian,) = torch.autograd.grad(out, theta, each, is_grads_batched=True)
    return out.detach(), jacobian.transpose(0, 1)


def update(
    state: FilterState,
    prior: Tensor,
    innovation: Tensor,
    jacobian: Tensor,
    settings: FilterSettings,
    seen: Tensor | None = None,
) -> FilterState:
    """One step of the filter.

    `prior` [P] is where theta began, `innovation` [B, D], `jacobian` [B, D, P]. An innovation
    that is an outlier or not finite teaches nothing, and many in a row begin the vehicle anew.
    Vehicles that are not `seen` [B] stay as they are.
    """
    size = innovation.shape[1]
    joint = state.covariance.dim() == 3
    # H P, and S = H P H' + R.
    hp = jacobian @ state.covariance if joint else jacobian * state.covariance[:, None]
    noise = settings.measurement_variance_m2 * torch.eye(size, dtype=hp.dtype)
    factor, failed = torch.linalg.cholesky_ex(hp @ jacobian.mT + noise)
    white = torch.linalg.solve_triangular(factor, innovation[..., None], upper=False)
    surprise = white.square().sum((1, 2))  # e' S^-1 e
    gate = gate_of(size, settings.gate)
    fits = (surprise <= settings.reject**2 * gate) & (failed == 0)
    white = white * (gate / surprise).clamp(max=1.0).sqrt()[:, None, None]
    fits_row = fits[:, None, None]
    # With S = L L', K e = (H P)' L^-T L^-1 e, and K H P = (L^-1 H P)' (L^-1 H P): symmetric.
    gain = torch.linalg.solve_triangular(factor.mT, torch.where(fits_row, white, 0.0), upper=True)
    theta = state.theta + (torch.where(fits_row, hp, 0.0).mT @ gain)[..., 0]
    theta = _within(theta, prior, settings.max_change)
    kept = (1.0 - settings.relaxation) / settings.forgetting
    added = settings.relaxation * settings.start_variance + kept * settings.process_variance
    if not kept:
        covariance = torch.full_like(state.covariance, added)  # diagonal, see `begin`
    else:
        reduced = torch.linalg.solve_triangular(factor, hp, upper=False)
        reduced = torch.where(fits_row, reduced, 0.0)
        if joint:
            covariance = torch.baddbmm(
                state.covariance, reduced.mT, reduced, beta=kept, alpha=-kept
            )
            covariance.diagonal(dim1=1, dim2=2).add_(added)
        else:
            covariance = kept * (state.covariance - reduced.square().sum(1)) + added
    misses = torch.where(fits, 0, state.misses + 1)
    if seen is not None:
        unseen = (~seen).nonzero()[:, 0]
        for new, old in ((theta, state.theta), (covariance, state.covariance)):
            new[unseen] = old[unseen]
        misses = torch.where(seen, misses, state.misses)
    after = FilterState(theta, covariance, misses)
    return restart(after, misses > settings.patience, prior, settings)


def restart(
    state: FilterState, lost: Tensor, prior: Tensor, settings: FilterSettings
) -> FilterState:
    """The vehicles `lost` [B] begun anew, the others as they are."""
    rows = lost.nonzero()[:, 0]
    if not len(rows):
        return state
    new = begin(prior, 1, settings)
    return FilterState(
        state.theta.index_put((rows,), new.theta[0]),
        state.covariance.index_put((rows,), new.covariance[0]),
        state.misses.index_put((rows,), new.misses[0]),
    )


def descend(
    state: FilterState,
    prior: Tensor,
    innovation: Tensor,
    jacobian: Tensor,
    rate: float,
    settings: FilterSettings,
    seen: Tensor,
) -> FilterState:
    """One step of stochastic gradient descent on |e|^2 / 2, for comparison: theta + rate H' e."""
    step = rate * (jacobian.mT @ innovation[..., None])[..., 0]
    step = torch.where(torch.isfinite(step) & seen[:, None], step, 0.0)
    return replace(state, theta=_within(state.theta + step, prior, settings.max_change))


def gate_of(size: int, probability: float) -> float:
    """The chi-squared quantile of `size` degrees of freedom."""
    return 2.0 * float(gammaincinv(size / 2.0, probability))


def _within(theta: Tensor, prior: Tensor, radius: float) -> Tensor:
    """`theta` [B, P], or the nearest to it that is no further than `radius` from `prior` [P]."""
    change = theta - prior
    length = torch.linalg.vector_norm(change, dim=1, keepdim=True)
    return torch.where(length <= radius, theta, prior + change * (radius / length))
