"""Samples -> tensors, a batch at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import torch
from torch import nn

from hatn_sim.datatypes import IntArray
from hatn_sim.hatn.sgn import GraphBatch
from hatn_sim.learn.dataset import Samples

JUDGED_AT_ONCE = 2048
Batch = TypeVar("Batch")


def batches(
    count: int, size: int = JUDGED_AT_ONCE, random: np.random.Generator | None = None
) -> Iterator[IntArray]:
    """Rows 0 ... count - 1 in parts of `size`, in order or in that of `random`."""
    order = np.arange(count) if random is None else random.permutation(count)
    for start in range(0, count, size):
        yield order[start : start + size]


def on(device: torch.device, batch: Batch) -> Batch:
    """The same batch, a dataclass of tensors, on another device."""
    return type(batch)(**{name: value.to(device) for name, value in vars(batch).items()})


def device_of(model: nn.Module) -> torch.device:
    """Where a network is."""
    return next(model.parameters()).device


def graph_batch(samples: Samples, rows: IntArray) -> GraphBatch:
    """Rows of the samples as tensors."""
    return GraphBatch(
        x=torch.from_numpy(samples.x[rows]),
        context=torch.from_numpy(samples.context[rows]),
        node_mask=torch.from_numpy(samples.node_mask[rows]),
        focus_mask=torch.from_numpy(samples.focus_mask[rows]),
        history_mask=torch.from_numpy(samples.history_mask[rows]),
    )
