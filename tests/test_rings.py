"""Nobody who is told to yield waits for himself: rings of two and more are broken at one place."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hatn_sim.assist.rings import weakest_of_rings

TABLES = st.integers(0, 2**32 - 1)


def rings(lets_go: dict[int, int]) -> list[list[int]]:
    """Those who come back to themselves, one by one."""
    found: list[list[int]] = []
    for start in lets_go:
        way = [start]
        while way[-1] in lets_go and lets_go[way[-1]] not in way:
            way.append(lets_go[way[-1]])
        if lets_go.get(way[-1]) == start and start == min(way):
            found.append(way)
    return found


@settings(max_examples=300, deadline=None)
@given(TABLES)
def test_each_ring_is_broken_once_at_its_weakest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 14))
    ego = rng.permutation(20)[:count]
    other = np.array([rng.choice(np.setdiff1d(np.arange(20), one)) for one in ego], dtype=np.int64)
    other = np.where(rng.random(count) < 0.6, np.roll(ego, 1) if count > 1 else other, other)
    yields = rng.random(count) < 0.8
    strength = rng.integers(0, 4, count).astype(float)
    told = {int(a): int(b) for a, b in zip(ego[yields], other[yields], strict=True)}
    expected = set[int]()
    for ring in rings(told):
        in_order = [int(a) for a in ego if int(a) in ring]
        of = {int(a): float(s) for a, s in zip(ego, strength, strict=True)}
        expected.add(min(in_order, key=lambda one: of[one]))
    weakest = weakest_of_rings(yields, ego, other, strength)
    assert set(ego[weakest].tolist()) == expected
    left = {a: b for a, b in told.items() if a not in expected}
    assert not rings(left)


def test_two_who_yield_to_each_other() -> None:
    ego, other = np.array([4, 7, 2]), np.array([7, 4, 4])
    everybody = np.ones(3, dtype=np.bool_)
    for strength, expected in (([0.9, 0.8, 0.0], [1]), ([0.8, 0.9, 0.0], [0]), ([1, 1, 1], [0])):
        found = weakest_of_rings(everybody, ego, other, np.array(strength, dtype=float))
        assert np.flatnonzero(found).tolist() == expected
