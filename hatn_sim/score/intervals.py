"""Confidence intervals by a bootstrap clustered over vehicles, recordings or runs.

Samples of one vehicle half a second apart are anything but independent, so whole vehicles (or
whole runs) are drawn again, with all their samples (Field and Welsh, 2007, cluster bootstrap).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hatn_sim.datatypes import FloatArray, IntArray

RESAMPLES = 1000
LEVEL = 0.95
BOUNDS = ((1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0)
"""Quantiles of the resamples, where the interval ends."""
SEED = 0
MIN_RUNS = 5
"""From this many pooled runs, recordings or cases on, these are the clusters, below it vehicles."""

Statistic = Callable[[FloatArray], FloatArray]
"""Sums over samples [..., D] -> the measure [...]; NaN where it is not defined."""


def cluster_sums(values: FloatArray, cluster: IntArray) -> FloatArray:
    """Sums of [S, D] over the samples of each cluster: [G, D]; `cluster` [S] is any labelling."""
    labels, index = np.unique(cluster, return_inverse=True)
    sums = np.zeros((len(labels), values.shape[1]))
    np.add.at(sums, index, values)
    return sums


def interval(sums: FloatArray, statistic: Statistic) -> tuple[float, float] | None:
    """The 95 % percentile interval of a statistic of sums, from 1,000 resamples of the clusters.

    Args:
        sums: [G, D] of each cluster.
        statistic: of the sums over all clusters.

    Returns:
        (low, high), or None where fewer than two clusters leave nothing to draw from.
    """
    if len(sums) < 2:
        return None
    values = statistic(_resampled(sums))
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    low, high = np.quantile(values, BOUNDS)
    return float(low), float(high)


def share_interval(sums: FloatArray) -> tuple[float, float] | None:
    """That of a share, from [G, 2] hits and samples of each cluster.

    Where all n samples are alike a bootstrap draws nothing else, however few they are; the interval
    is then that of Clopper and Pearson (1934), which ends at 2.5 % to the power of 1 / n.
    """
    hits, count = sums.sum(axis=0).tolist()
    if 0.0 < hits < count or not count:
        return interval(sums, ratio)
    apart = float(BOUNDS[0] ** (1.0 / count))
    return (apart, 1.0) if hits else (0.0, 1.0 - apart)


def mean_intervals(sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The intervals (low [D], high [D]) of the means of D values, as `interval` has each of them.

    `sums` [G, D + 1] are those of the values in each cluster, and behind them their number. NaN
    where fewer than two clusters leave nothing to draw from.
    """
    if len(sums) < 2:
        nothing = np.full(sums.shape[1] - 1, np.nan)
        return nothing, nothing
    drawn = _resampled(sums)
    drawn = drawn[drawn[:, -1] > 0]
    low, high = np.quantile(drawn[:, :-1] / drawn[:, -1:], BOUNDS, axis=0)
    return low, high


def _resampled(sums: FloatArray) -> FloatArray:
    """[RESAMPLES, D] the sums over as many clusters, drawn from these [G, D] with replacement."""
    clusters = len(sums)
    rng = np.random.default_rng(SEED)
    # Drawing G clusters with replacement is drawing how often each occurs. A hundred resamples
    # at a time keep memory small.
    drawn = [
        rng.multinomial(clusters, np.full(clusters, 1.0 / clusters), size=100) @ sums
        for _ in range(RESAMPLES // 100)
    ]
    return np.concatenate(drawn)


def ratio(sums: FloatArray) -> FloatArray:
    """Column 0 over column 1: a mean, where these are the sum of values and their number."""
    defined = sums[..., 1] > 0
    return np.where(defined, sums[..., 0] / np.where(defined, sums[..., 1], 1.0), np.nan)


def macro_f1(sums: FloatArray) -> FloatArray:
    """Mean F1 of yield and pass from counts (hits, labels, answers) of yield, then of pass.

    F1 = 2 hits / (labels + answers). Not defined while a class is neither true nor answered.
    """
    hits, labels, answers = (sums[..., [k, k + 3]] for k in range(3))
    counts = np.stack([2.0 * hits, labels + answers], axis=-1)
    mean: FloatArray = ratio(counts).mean(axis=-1)
    return mean


def expected_calibration_error(sums: FloatArray) -> FloatArray:
    """ECE from (number of samples, then confidence minus correctness summed within each bin)."""
    gap = np.abs(sums[..., 1:]).sum(axis=-1)
    return ratio(np.stack([gap, sums[..., 0]], axis=-1))
