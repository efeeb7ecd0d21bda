"""Nobody waits for ever: of those told to yield round in a ring, one is not told so.

Letters: R who may be told to yield, N vehicles.
"""

from __future__ import annotations

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray


def weakest_of_rings(
    yields: BoolArray, ego: IntArray, other: IntArray, strength: FloatArray
) -> BoolArray:
    """Whose yield [R] had better go, so that no two yield to each other, and no more in a ring.

    `yields` [R] are told to; each `ego` [R], at most once, to one `other` [R]. Of each ring it is
    the one of the least `strength` [R], of equals the first.
    """
    some = np.flatnonzero(yields)
    weakest = np.zeros(len(yields), dtype=np.bool_)
    if len(some) < 2:
        return weakest
    nobody = int(max(ego[some].max(), other[some].max())) + 1
    lets_go = np.full(nobody + 1, nobody)
    lets_go[ego[some]] = other[some]
    rank = np.full(nobody + 1, nobody + 1)
    rank[ego[some[np.argsort(strength[some], kind="stable")]]] = np.arange(len(some))
    # By doubling: where each comes after 2^k steps, and the least rank on the way there.
    after, least = lets_go, rank.copy()
    for _ in range(len(some).bit_length()):
        least = np.minimum(least, least[after])
        after = after[after]
    in_ring = np.zeros(nobody + 1, dtype=np.bool_)
    in_ring[after] = True  # after so many steps, whoever yields in no ring has come to nobody
    in_ring[nobody] = False
    weakest[some] = in_ring[ego[some]] & (least[ego[some]] == rank[ego[some]])
    return weakest
